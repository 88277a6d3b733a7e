//! How drawn mouths compare with recorded ones: eigenmouths alone, and with the fine detail of the paper's candidates.
//!
//!     cargo xtask pictures FOLDER MODEL.safetensors [val|test] [CHANGE...]
//!
//! FOLDER is what the model was trained on; in place of the model, the folder's mouth.safetensors says what its eigenmouths alone lose. Every clip is drawn on its own mean mouth, from its true weights and from those that the model hears, 25 pictures a second. CHANGE: charges
//! for a change of candidate that are tried.
use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};
use lipstream::engine::{Engine, FloatModel, Kind, RunSettings};
use lipstream::lips::Lips;
use lipstream::mouth::MouthSpace;
use lipstream::render;
use lipstream::render::refine::{Candidates, Choice};
use lipstream::tensors::Tensors;
use lipstream_make::details::{Seen, candidates};
use lipstream_make::evaluate::closure::learn_lips;
use lipstream_make::evaluate::pictures::PictureScore;
use lipstream_make::features::{Clip, FeatureFolder, Split};
use lipstream_media::sound;
use ndarray::{Array2, Array4, ArrayView1, ArrayView2, Axis};

pub(crate) fn run(words: &[String]) -> Result<()> {
    let [folder, model, rest @ ..] = words else {
        bail!("write FOLDER MODEL.safetensors [val|test] [CHANGE...]");
    };
    let split = Split::named(rest.first().map_or("val", String::as_str))?;
    let changes: Vec<f32> = rest
        .iter()
        .skip(1)
        .map(|word| word.parse())
        .collect::<Result<_, _>>()?;
    let folder = FeatureFolder::open(&PathBuf::from(folder))?;
    let model = PathBuf::from(model);
    let space = MouthSpace::load(&Tensors::read(&model)?)?;
    // The mouth.safetensors of a folder hears nothing: only true weights are drawn.
    let engine = match FloatModel::of_tensors(&Tensors::read(&model)?) {
        Ok(_) => Some(Engine::open(&model, Kind::Fixed)?),
        Err(_) => None,
    };
    let all = candidates(&folder, &space, &())?;
    let first = folder.split(split).find(|clip| clip.video_frames > 0);
    let lips = learn_lips(
        &folder,
        &first.context("no clip of this split has video")?.speaker,
    )?;
    let mut ways: Vec<(String, Option<Choice>)> = vec![
        ("eigenmouths".to_owned(), None),
        ("nearest candidate".to_owned(), Some(Choice::FrameWise)),
    ];
    let charges = if changes.is_empty() {
        vec![None]
    } else {
        changes.into_iter().map(Some).collect()
    };
    for charge in charges {
        let choice = charge.map_or(Choice::default(), |change| Choice::OverTime { change });
        ways.push((format!("{choice:?}"), Some(choice)));
    }
    let mut rows: Vec<[Way; 2]> = ways.iter().map(|_| Default::default()).collect();
    for clip in folder.split(split).filter(|clip| clip.video_frames > 0) {
        let seen = Seen::read(&folder, clip, &space)?;
        let recorded = &seen.differences + &seen.mean;
        let mut of_clip = vec![seen.weights.clone()];
        if let Some(engine) = &engine {
            of_clip.push(heard(engine, &folder, clip)?);
        }
        for (column, tracks) in of_clip.iter().enumerate() {
            let tracks = tracks.view();
            for ((_, choice), row) in ways.iter().zip(&mut rows) {
                let drawn = drawn(&space, &seen, &all, tracks, *choice);
                row[column].add(drawn.view(), recorded.view(), &space, &lips);
            }
        }
    }
    println!(
        "| weights | drawn with | PSNR | SSIM | sharpness | jerk | gap off, pixels | closed: precision | recall |\n|---|---|---|---|---|---|---|---|---|"
    );
    let columns = if engine.is_some() { 2 } else { 1 };
    for (column, weights) in ["true", "heard"].into_iter().enumerate().take(columns) {
        for ((name, _), row) in ways.iter().zip(&rows) {
            println!("| {weights} | {name} | {}", row[column].told());
        }
    }
    Ok(())
}

/// One way of drawing.
#[derive(Default)]
struct Way {
    score: PictureScore,
    gap_off: f64,
    gaps: f64,
    /// Pictures closed in both, drawn closed, recorded closed.
    closed: [f64; 3],
}

impl Way {
    fn add(&mut self, drawn: ArrayView2<f32>, recorded: ArrayView2<f32>, space: &MouthSpace, lips: &Lips) {
        self.score.add(drawn, recorded, (space.width, space.height));
        let gaps = |of: ArrayView2<f32>| -> Vec<f32> {
            let images = Array4::from_shape_fn((of.nrows(), space.height, space.width, 3), |(n, y, x, c)| {
                of[(n, 3 * (y * space.width + x) + c)].round().clamp(0.0, 255.0) as u8
            });
            lips.gaps(images.view()).unwrap_or_default()
        };
        for (a, b) in gaps(drawn).into_iter().zip(gaps(recorded)) {
            self.gap_off += f64::from((a - b).abs());
            self.gaps += 1.0;
            let [a, b] = [a, b].map(|gap| f64::from(u8::from(gap < lips.closed_below())));
            self.closed = [self.closed[0] + a * b, self.closed[1] + a, self.closed[2] + b];
        }
    }

    fn told(&self) -> String {
        let [both, drawn, recorded] = self.closed;
        format!(
            "{:.2} dB | {:.4} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} |",
            self.score.psnr_db(),
            self.score.ssim(),
            self.score.sharpness(),
            self.score.jerk(),
            self.gap_off / self.gaps.max(1.0),
            both / drawn.max(1.0),
            both / recorded.max(1.0)
        )
    }
}

/// Pictures `[n, P]` on the clip's mean mouth.
fn drawn(
    space: &MouthSpace,
    seen: &Seen,
    all: &Candidates,
    tracks: ArrayView2<f32>,
    choice: Option<Choice>,
) -> Array2<f32> {
    let mut out = tracks.dot(&space.basis) + &seen.mean;
    if let Some(choice) = choice {
        let way = all.choose(tracks, choice);
        for (n, mut row) in out.outer_iter_mut().enumerate() {
            row += &ArrayView1::from(&all.shown(&way, n, choice));
        }
    }
    out
}

/// What the model hears, at the pictures' times, `[pictures, D]`.
fn heard(engine: &Engine, folder: &FeatureFolder, clip: &Clip) -> Result<Array2<f32>> {
    let sound = sound::read(&folder.wav_path(&clip.id))?.samples;
    let said = engine.convert(&sound, &RunSettings::default())?.parameters;
    let fps = clip.video_hz.round() as u32;
    let mut rows = render::at_pictures(said.view(), fps, Some(sound.len()))?;
    // Weights are told from the clip's mean mouth.
    if let Some(mean) = rows.mean_axis(Axis(0)) {
        rows -= &mean;
    }
    Ok(rows)
}
