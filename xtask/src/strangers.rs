//! Other talkers through a model of one: how well its lip gap follows the gap of their own mouths.
//!
//!     cargo xtask strangers FOLDER OTHERS MGE.safetensors
//!
//! FOLDER is what the model was trained on; OTHERS holds clips of other talkers with their mouths. Gaps are read off mouth
//! images (theirs) and off mouth parameters (the model's); a correlation asks for no scale. Beside it stand the
//! likelihood-trained parent, and chance: the same gaps against those of the next clip.
use std::path::PathBuf;

use anyhow::{Context as _, Result, bail, ensure};
use lipstream::kinds::likelihood::convert::{Lag, convert};
use lipstream::kinds::recurrent::live;
use lipstream::kinds::recurrent::model::RecurrentModel;
use lipstream_make::evaluate::closure::Gaps;
use lipstream_make::evaluate::metrics::Score;
use lipstream_make::features::{Clip, FeatureFolder};
use ndarray::Array2;

fn correlation(truth: &[f32], said: &[f32]) -> f64 {
    let n = truth.len().min(said.len());
    let column = |values: &[f32]| Array2::from_shape_fn((n, 1), |(t, _)| values[t]);
    Score::of(&column(truth), &column(said)).acc()
}

pub(crate) fn run(words: &[String]) -> Result<()> {
    let words: Vec<PathBuf> = words.iter().map(PathBuf::from).collect();
    let [own, others, model] = words.as_slice() else {
        bail!("write FOLDER OTHERS MGE.safetensors");
    };
    let (own, others) = (FeatureFolder::open(own)?, FeatureFolder::open(others)?);
    let model = RecurrentModel::read(model)?;
    let read_out = Gaps::learn(&own).context("the gap of the model's own talker")?;
    let theirs = Gaps::learn(&others).context("the gaps of the others")?;
    let clips: Vec<&Clip> = others
        .manifest
        .clips
        .iter()
        .filter(|c| c.video_frames > 0)
        .collect();
    ensure!(!clips.is_empty(), "{} holds no video", others.root.display());
    let mut gaps = Vec::new();
    for clip in &clips {
        let audio = others.audio(clip)?;
        let said = live::convert(&model, audio.view()).parameters;
        let lag = Lag::Frames(model.parent.following.lag);
        let (parent, _) = convert(&model.parent, &audio, lag)?;
        gaps.push((
            theirs.truth(&others, clip)?.gap().to_vec(),
            read_out.read_out(said.view()),
            read_out.read_out(parent.view()),
        ));
    }
    println!("| clip | talker | mge | likelihood-trained parent | chance |\n|---|---|---|---|---|");
    let mut sums = [0.0; 3];
    for (n, clip) in clips.iter().enumerate() {
        let (truth, said, parent) = &gaps[n];
        let next = &gaps[(n + 1) % gaps.len()].0;
        let row = [
            correlation(truth, said),
            correlation(truth, parent),
            correlation(next, said),
        ];
        sums.iter_mut()
            .zip(row)
            .for_each(|(s, r)| *s += r / clips.len() as f64);
        println!(
            "| {} | {} | {:.3} | {:.3} | {:.3} |",
            clip.id, clip.speaker, row[0], row[1], row[2]
        );
    }
    println!("| mean | | {:.3} | {:.3} | {:.3} |", sums[0], sums[1], sums[2]);
    Ok(())
}
