//! Faces drawn onto a background against recordings of the same sentences: lips, jaw, seams.
//!
//!     cargo xtask faces MODEL.safetensors BACKGROUND VIDEO...
//!
//! Each VIDEO's sound is heard by the model and drawn onto BACKGROUND, another recording of the same person; landmarks of the drawn film are compared with those of the
//! VIDEO itself, in the face's own coordinates (shares of the distance between the eyes).
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use lipstream::engine::{Engine, Kind, RunSettings};
use lipstream::mouth::MouthSpace;
use lipstream::render::face::{FaceScene, FaceSettings, Footage, JawBy, LiveFace, Wanted, Whose};
use lipstream::render::refine::Choice;
use lipstream::render::{self, Scene as _, energy};
use lipstream::tensors::Tensors;
use lipstream_make::evaluate::metrics::Score;
use lipstream_make::evaluate::pictures::seam;
use lipstream_make::vision::{self, LandmarkFinder, Landmarks};
use lipstream_media::sink::Soundtrack;
use lipstream_media::sound;
use lipstream_media::video::{self, Frames};
use ndarray::{Array2, ArrayView3};

/// Drawn pictures whose seams are looked at: every so manieth.
const SEAMS: usize = 10;

pub(crate) fn run(words: &[String]) -> Result<()> {
    let words: Vec<PathBuf> = words.iter().map(PathBuf::from).collect();
    let [model, background, videos @ ..] = words.as_slice() else {
        bail!("write MODEL.safetensors BACKGROUND VIDEO...");
    };
    let space = MouthSpace::load(&Tensors::read(model)?)?;
    let engine = Engine::open(model, Kind::Fixed)?;
    let mut footage = vision::footage(background, vision::LONGEST_S, &())?;
    let usual = FaceSettings::default();
    let ways = [
        ("as it is by default", usual),
        ("lower face still", FaceSettings { jaw: None, ..usual }),
        (
            "lower face by the sound",
            FaceSettings {
                jaw: Some(JawBy::Energy),
                ..usual
            },
        ),
        (
            "eigenmouths alone",
            FaceSettings {
                detail: None,
                ..usual
            },
        ),
        (
            "nearest candidate",
            FaceSettings {
                detail: Some(Choice::FrameWise),
                ..usual
            },
        ),
        (
            "mouths by opening",
            FaceSettings {
                whose: Some(Whose::Opened),
                ..usual
            },
        ),
    ];
    let mut face = LiveFace::new(
        vision::footage(background, vision::LONGEST_S, &())?,
        space.clone(),
        &usual,
    )?;
    let mut live = Seen::default();
    let mut all: Vec<Seen> = ways.iter().map(|_| Seen::default()).collect();
    for video in videos {
        let clip = Clip::read(video, &engine)?;
        for ((_, settings), seen) in ways.iter().zip(&mut all) {
            seen.add(&clip, &mut footage, &space, settings)?;
        }
        live.add_live(&clip, &mut face)?;
    }
    println!("{}\n", joins(&mut footage, &space)?);
    println!(
        "| drawn | lips off | gap: correlation, off | width: correlation | jaw: correlation, off | seam, drawn : background |\n|---|---|---|---|---|---|"
    );
    for ((name, _), seen) in ways.iter().zip(&all) {
        println!("| {name} | {}", seen.told());
    }
    println!("| as it is live | {}", live.told());
    Ok(())
}

/// How a background that goes on changes from picture to picture, over its joins and elsewhere: mean difference in levels.
fn joins(footage: &mut Footage, space: &MouthSpace) -> Result<String> {
    let tracks = Array2::zeros((1, space.size()));
    let wanted = Wanted {
        tracks: tracks.view(),
        energy: None,
    };
    let fps = footage.rate_hz.round() as u32;
    let settings = FaceSettings {
        fps,
        ..FaceSettings::default()
    };
    let pictures = footage.places.len();
    let mut scene = FaceScene::new(footage, space, &wanted, &settings)?;
    let (mut ordinary, mut over) = (Vec::new(), Vec::new());
    let mut before: Option<Vec<u8>> = None;
    let dissolves = |scene: &FaceScene, n: usize| {
        let moment = scene.course().at((n as f64 + 0.5) / f64::from(fps));
        moment.next.is_some()
    };
    for n in 0..2 * pictures {
        let (rgb, _) = scene.undrawn(n)?;
        if let Some(before) = &before {
            let sum: u64 = rgb
                .iter()
                .zip(before)
                .map(|(a, b)| u64::from(a.abs_diff(*b)))
                .sum();
            let change = sum as f64 / rgb.len() as f64;
            match dissolves(&scene, n) || dissolves(&scene, n - 1) {
                true => over.push(change),
                false => ordinary.push(change),
            }
        }
        before = Some(rgb);
    }
    ordinary.sort_by(f64::total_cmp);
    over.sort_by(f64::total_cmp);
    let at = |of: &[f64], share: f64| {
        of.get((share * of.len() as f64) as usize)
            .or(of.last())
            .copied()
            .unwrap_or(0.0)
    };
    Ok(format!(
        "{pictures} pictures, loop {:?}; change from picture to picture, levels: median {:.2}, 95 % {:.2}, most {:.2}; over joins: median {:.2}, most {:.2}",
        scene.course().around(),
        at(&ordinary, 0.5),
        at(&ordinary, 0.95),
        at(&ordinary, 1.0),
        at(&over, 0.5),
        at(&over, 1.0)
    ))
}

/// A sentence: what the model says of it, and how its speaker's face moved.
struct Clip {
    tracks: Array2<f32>,
    energy: Vec<f32>,
    truth: Vec<Option<Landmarks>>,
    fps: u32,
}

impl Clip {
    fn read(path: &Path, engine: &Engine) -> Result<Self> {
        let frames = video::decode(path)?;
        let samples = sound::decode(&video::decode_sound(path)?)?.samples;
        let said = engine.convert(&samples, &RunSettings::default())?.parameters;
        let fps = frames.rate_hz.round() as u32;
        let tracks = render::at_pictures(said.view(), fps, Some(samples.len()))?;
        Ok(Self {
            energy: energy(&Soundtrack::Samples(&samples), fps, tracks.nrows())?,
            tracks,
            truth: LandmarkFinder::new()?.in_clip(&frames)?,
            fps,
        })
    }
}

/// Sums over clips, of one way of drawing.
#[derive(Default)]
struct Seen {
    lips: f64,
    points: f64,
    /// Pairs of drawn and recorded: gap, width, jaw.
    pairs: [Vec<(f32, f32)>; 3],
    /// Squares of colour steps at the seams: drawn, background.
    steps: (f64, f64),
}

impl Seen {
    fn add(
        &mut self,
        clip: &Clip,
        footage: &mut Footage,
        space: &MouthSpace,
        settings: &FaceSettings,
    ) -> Result<()> {
        let wanted = Wanted {
            tracks: clip.tracks.view(),
            energy: Some(&clip.energy),
        };
        let settings = FaceSettings {
            fps: clip.fps,
            ..*settings
        };
        let mut scene = FaceScene::new(footage, space, &wanted, &settings)?;
        let (width, height) = scene.size();
        let mut rgb = Vec::new();
        for (n, row) in clip.tracks.outer_iter().enumerate() {
            let drawn = scene.draw(row)?;
            if n % SEAMS == 0 {
                let (plain, map) = scene.undrawn(n)?;
                let Some(back) = map.inverse() else { continue };
                let view = |of| ArrayView3::from_shape((height, width, 3), of);
                let inside = |x: usize, y: usize| {
                    let (u, v) = back.apply(x as f32, y as f32);
                    // In the middle of the soft edge, where half is drawn and half recorded.
                    scene.opacity(u, v) > 0.5
                };
                let (a, b) = seam(view(&drawn)?, view(&plain)?, inside);
                self.steps = (self.steps.0 + a * a, self.steps.1 + b * b);
            }
            rgb.extend(drawn);
        }
        self.compare_film(clip, (width, height), rgb)
    }

    /// The same where no picture is known before it is drawn.
    fn add_live(&mut self, clip: &Clip, face: &mut LiveFace) -> Result<()> {
        let mut rgb = Vec::new();
        for (n, row) in clip.tracks.outer_iter().enumerate() {
            rgb.extend(face.draw((n as f64 + 0.5) / f64::from(clip.fps), row)?);
        }
        self.compare_film(clip, face.size(), rgb)
    }

    fn compare_film(&mut self, clip: &Clip, (width, height): (usize, usize), rgb: Vec<u8>) -> Result<()> {
        let frames = Frames {
            width,
            height,
            rate_hz: clip.fps as f32,
            rgb,
        };
        for pair in LandmarkFinder::new()?.in_clip(&frames)?.iter().zip(&clip.truth) {
            if let (Some(drawn), Some(recorded)) = pair {
                self.compare(drawn, recorded);
            }
        }
        Ok(())
    }

    fn compare(&mut self, drawn: &Landmarks, recorded: &Landmarks) {
        for (a, b) in drawn.lips_in_face().iter().zip(recorded.lips_in_face()) {
            self.lips += f64::from((a.0 - b.0).hypot(a.1 - b.1));
            self.points += 1.0;
        }
        let (a, b) = (drawn.opening(), recorded.opening());
        let values = [(a.0, b.0), (a.1, b.1), (drawn.jaw(), recorded.jaw())];
        self.pairs
            .iter_mut()
            .zip(values)
            .for_each(|(all, pair)| all.push(pair));
    }

    fn told(&self) -> String {
        let correlation = |pairs: &[(f32, f32)]| {
            let column =
                |of: fn(&(f32, f32)) -> f32| Array2::from_shape_fn((pairs.len(), 1), |(t, _)| of(&pairs[t]));
            Score::of(&column(|p| p.1), &column(|p| p.0)).acc()
        };
        let off = |pairs: &[(f32, f32)]| {
            let n = (pairs.len() as f64).max(1.0);
            pairs.iter().map(|(a, b)| f64::from((a - b).abs())).sum::<f64>() / n
        };
        let [gap, width, jaw] = &self.pairs;
        format!(
            "{:.2} % | {:.3}, {:.2} % | {:.3} | {:.3}, {:.2} % | {} |",
            100.0 * self.lips / self.points.max(1.0),
            correlation(gap),
            100.0 * off(gap),
            correlation(width),
            correlation(jaw),
            100.0 * off(jaw),
            // Nobody has looked for seams live: they are the film's.
            match self.steps.1 > 0.0 {
                true => format!("{:.2}", (self.steps.0 / self.steps.1).sqrt()),
                false => "–".to_owned(),
            }
        )
    }
}
