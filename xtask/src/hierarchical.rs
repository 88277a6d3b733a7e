//! What a hierarchical model says, in its own numbers, against recorded faces; and what strangers' voices do to it.
//!
//!     cargo xtask hierarchical FEATURES LANDMARKS MODEL.safetensors OUT/ [OTHERS]
//!
//! FEATURES, with its videos where they were prepared, and LANDMARKS are what the model was trained on; its test clips are looked at. OTHERS: a feature folder of other people, prepared with `--lips`. Writes
//! `trajectories.svg` (COS figures 9 and 10: the mouth's first two texture parameters over four clips) and `voices.svg` (figure 11: distributions of the
//! first two speech parameters of the training voice and of the strangers whose lips are followed best and worst), and prints tables.
use std::path::PathBuf;

use anyhow::{Context as _, Result, bail, ensure};
use lipstream::kinds::hierarchical::HierarchicalModel;
use lipstream::kinds::hierarchical::speech::PICTURES_HZ;
use lipstream::kinds::hierarchical::voice::{Adaptation, Voice};
use lipstream_make::evaluate::plot::{self, Line, Look, Panel};
use lipstream_make::features::{FeatureFolder, Split};
use lipstream_make::hierarchical::pictures::{self, Picked, Which, lip_gaps};
use lipstream_make::hierarchical::{Landmarks, truth};
use lipstream_media::{files, sound};
use ndarray::{Array1, Array2, ArrayView1, Axis, concatenate, s};

/// Clips of figures 9 and 10.
const SHOWN: usize = 4;
/// Points of a curve of figure 11.
const BINS: usize = 48;

pub(crate) fn run(words: &[String]) -> Result<()> {
    let [features, landmarks, model, out, others @ ..] = words else {
        bail!("write FEATURES LANDMARKS MODEL.safetensors OUT [OTHERS]");
    };
    let folder = FeatureFolder::open(&PathBuf::from(features))?;
    let landmarks = Landmarks::read(&PathBuf::from(landmarks))?;
    let model = HierarchicalModel::read(&PathBuf::from(model))?;
    let inner: Vec<usize> = landmarks
        .inner_lips()
        .context("no landmarks are named as inner lips")?
        .collect();
    let out = PathBuf::from(out);
    let videos = PathBuf::from(&folder.manifest.corpus);
    let picked = pictures::pick(
        &folder,
        Split::Test,
        &landmarks,
        &videos,
        Which::Clips(usize::MAX),
        &model.hearing,
    )?;
    let heard = |clip: &Picked| model.speech_parameters(&clip.heard);
    let said: Vec<Array2<f32>> = picked
        .iter()
        .map(|clip| model.convert_alone(&heard(clip)))
        .collect();
    let said = concatenate(Axis(0), &said.iter().map(|c| c.view()).collect::<Vec<_>>())?;
    let actual = truth::appearances(&model, &picked, &())?;

    println!("| area | error, of the variance | first texture parameter | second |\n|---|---|---|---|");
    for (index, (name, range)) in model.groups().into_iter().enumerate() {
        let (a, b) = (actual.slice(s![.., range.clone()]), said.slice(s![.., range]));
        let off: f32 = (&a - &b).iter().map(|d| d * d).sum();
        let all: f32 = a.var_axis(Axis(0), 0.0).sum() * a.nrows() as f32;
        let follows = |k: usize| {
            let of = |rows: &Array2<f32>| texture(&model, index, rows).column(k).to_owned();
            correlation(of(&actual).view(), of(&said).view())
        };
        println!(
            "| {name} | {:.3} | {:.3} | {:.3} |",
            off / all,
            follows(0),
            follows(1)
        );
    }
    let root = |rows: &Array2<f32>| lip_gaps(&model.shapes(rows), &inner);
    let gaps = lip_gaps(&pictures::stacked(&picked, |clip| &clip.landmarks)?, &inner);
    for (what, own) in [
        ("what it says", root(&said)),
        ("its own numbers of the recording", root(&actual)),
    ] {
        let off = (&own - &gaps).mapv(|d| d * d).mean().unwrap_or(0.0).sqrt();
        println!(
            "\nlip gap of the composed face, {what}: error {off:.3} px, correlation {:.3}",
            correlation(own.view(), gaps.view())
        );
    }
    std::fs::create_dir_all(&out)?;
    let mouth = model.nodes.len() - 1;
    let shown = pictures::ranges(&picked)
        .get(SHOWN.min(picked.len()) - 1)
        .map_or(0, |range| range.end);
    let panels: Vec<Panel> = (0..2)
        .map(|k| {
            let line = |name: &str, look, rows: &Array2<f32>| {
                let values = texture(&model, mouth, &rows.slice(s![..shown, ..]).to_owned());
                let column = values.column(k);
                let second = |n: usize| n as f64 / f64::from(PICTURES_HZ);
                let points = column.iter().enumerate().map(|(n, v)| (second(n), f64::from(*v)));
                Line::new(name, look, points.collect())
            };
            Panel {
                title: format!("texture parameter {} of the mouth", k + 1),
                x: "seconds".to_owned(),
                y: "level".to_owned(),
                lines: vec![
                    line("recorded", Look::Truth, &actual),
                    line("said", Look::System(0), &said),
                ],
            }
        })
        .collect();
    let figure = plot::panels(
        "Texture parameters that speech says, and recorded ones",
        &panels,
        1,
    )?;
    files::write_bytes(&out.join("trajectories.svg"), figure.as_bytes())?;
    match others {
        [] => Ok(()),
        [others] => strangers(
            &model,
            &folder,
            &FeatureFolder::open(&PathBuf::from(others))?,
            &inner,
            &out,
        ),
        _ => bail!("one folder of other people is enough"),
    }
}

/// Texture parameters b_g of an area, from the numbers of all areas.
fn texture(model: &HierarchicalModel, area: usize, rows: &Array2<f32>) -> Array2<f32> {
    let (_, range) = model.groups().swap_remove(area);
    let appearance = &model.nodes[area].appearance;
    let shape = appearance.shape.modes();
    let both = rows.slice(s![.., range]).dot(&appearance.joint.components) + &appearance.joint.mean;
    both.slice(s![.., shape..]).to_owned()
}

fn correlation(a: ArrayView1<f32>, b: ArrayView1<f32>) -> f32 {
    let (a, b) = (&a - a.mean().unwrap_or(0.0), &b - b.mean().unwrap_or(0.0));
    a.dot(&b) / (a.dot(&a) * b.dot(&b)).sqrt().max(f32::MIN_POSITIVE)
}

/// Speech parameters of a clip's pictures.
fn heard(
    model: &HierarchicalModel,
    folder: &FeatureFolder,
    id: &str,
    pictures: usize,
    rate_hz: f32,
) -> Result<Array2<f32>> {
    let samples = sound::read(&folder.wav_path(id))?.samples;
    let heard = model.hearing.of_pictures(&samples, pictures, rate_hz);
    Ok(model.speech_parameters(&heard))
}

/// How strangers' lips are followed, without adaptation and with each kind, by the whole of their own clip.
fn strangers(
    model: &HierarchicalModel,
    own: &FeatureFolder,
    others: &FeatureFolder,
    inner: &[usize],
    out: &std::path::Path,
) -> Result<()> {
    ensure!(
        others.manifest.lips,
        "{} was not prepared with --lips",
        others.root.display()
    );
    println!("\n| talker | as it is | level | linear |\n|---|---|---|---|");
    let mut rows = Vec::new();
    for clip in others.manifest.clips.iter().filter(|clip| clip.video_frames > 0) {
        let speech = heard(model, others, &clip.id, clip.video_frames, clip.video_hz)?;
        let actual = others.visual(clip)?.column(0).to_owned();
        let follows = |speech: &Array2<f32>| {
            let gaps = lip_gaps(&model.shapes(&model.convert_alone(speech)), inner);
            correlation(gaps.view(), actual.view())
        };
        let adapted =
            |adaptation| follows(&Voice::learn(&model.speech, speech.view(), adaptation).apply(&speech));
        let row = [
            follows(&speech),
            adapted(Adaptation::Level),
            adapted(Adaptation::Linear),
        ];
        println!("| {} | {:.3} | {:.3} | {:.3} |", clip.id, row[0], row[1], row[2]);
        rows.push((row, clip.id.clone(), speech));
    }
    ensure!(
        !rows.is_empty(),
        "{} holds no clip with lips",
        others.root.display()
    );
    let mean = |k: usize| rows.iter().map(|(row, ..)| row[k]).sum::<f32>() / rows.len() as f32;
    println!(
        "| mean of {} | {:.3} | {:.3} | {:.3} |",
        rows.len(),
        mean(0),
        mean(1),
        mean(2)
    );
    rows.sort_by(|a, b| b.0[0].total_cmp(&a.0[0]));
    let mut training = Vec::new();
    for clip in own.split(Split::Test) {
        training.push(heard(model, own, &clip.id, clip.video_frames, clip.video_hz)?);
    }
    let training = concatenate(Axis(0), &training.iter().map(|s| s.view()).collect::<Vec<_>>())?;
    let panels: Vec<Panel> = [&rows[0], &rows[rows.len() - 1]]
        .into_iter()
        .zip(["followed best", "followed worst"])
        .flat_map(|((_, _, speech), what)| {
            let training = &training;
            (0..2).map(move |k| Panel {
                title: format!("speech parameter {}, the stranger who is {what}", k + 1),
                x: "value".to_owned(),
                y: "density".to_owned(),
                lines: vec![
                    Line::new("training voice", Look::Truth, density(training.column(k))),
                    Line::new("stranger", Look::System(0), density(speech.column(k))),
                ],
            })
        })
        .collect();
    let figure = plot::panels(
        "Speech parameters of the training voice and of strangers",
        &panels,
        2,
    )?;
    files::write_bytes(&out.join("voices.svg"), figure.as_bytes())?;
    Ok(())
}

/// Density of values by Gaussian kernels a quarter of their deviation wide.
fn density(values: ArrayView1<f32>) -> Vec<(f64, f64)> {
    let (mean, deviation) = (values.mean().unwrap_or(0.0), values.std(0.0).max(1e-3));
    let width = f64::from(0.25 * deviation);
    let places = Array1::linspace(
        f64::from(mean - 3.5 * deviation),
        f64::from(mean + 3.5 * deviation),
        BINS,
    );
    let at = |x: f64| {
        let sum: f64 = values
            .iter()
            .map(|v| (-0.5 * ((x - f64::from(*v)) / width).powi(2)).exp())
            .sum();
        sum / (values.len() as f64 * width * std::f64::consts::TAU.sqrt())
    };
    places.iter().map(|x| (*x, at(*x))).collect()
}
