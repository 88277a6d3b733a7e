//! What a clip's mouths are on average, which `prepare` takes off the truth: scores are told with it as well.
//!
//! No sound tells in what pose a clip was recorded, so that models are trained without it. But a mouth without it has less to be
//! predicted than the pictures show; with it, a system says the speaker's average over his training clips beside its own motion.
use std::collections::HashMap;

use ndarray::Array1;
use rayon::prelude::*;

use super::Truth;
use crate::error::{Error, Result, bail};
use crate::features::{Clip, FeatureFolder, Split, read_mouths};
use lipstream::mouth::MouthSpace;
use lipstream::tensors::Tensors;

/// Training clips of a speaker that his average is taken over, at most.
const CLIPS: usize = 120;

/// Of one measured clip.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ClipMean {
    /// What was taken off its own mouths, `[D]`.
    pub(super) own: Array1<f32>,
    /// What was taken off the speaker's training clips on average, `[D]`.
    pub(super) speakers: Array1<f32>,
}

/// Of every measured clip. The error says why they are not known; that none was taken off is one, too.
pub(super) fn learn(folder: &FeatureFolder, truths: &[Truth]) -> Result<Vec<ClipMean>> {
    let path = folder.mouth_path();
    let space = MouthSpace::load(&Tensors::read(&path).map_err(Error::other)?).map_err(Error::other)?;
    let of = |clip: &Clip| -> Result<Array1<f32>> {
        let images = read_mouths(&folder.mouths_path(&clip.id))?;
        let images = images.as_standard_layout();
        let pixels = images.as_slice().expect("an array in standard layout is a slice");
        let whole = space.project_clip(pixels, false).map_err(Error::other)?;
        let kept = folder.visual(clip)?;
        if whole.dim() != kept.dim() || whole.is_empty() {
            bail!(
                Data,
                "clip {}: mouth images and parameters differ in number",
                clip.id
            );
        }
        Ok(&whole.row(0) - &kept.row(0))
    };
    let own: Vec<Array1<f32>> = truths
        .par_iter()
        .map(|truth| of(truth.clip))
        .collect::<Result<_>>()?;
    // One level of brightness is no more than rounding.
    if own.iter().flatten().all(|v| v.abs() < 1.0) {
        bail!(Data, "no clip has had its mean taken off");
    }
    let mut speakers: HashMap<&str, Array1<f32>> = HashMap::new();
    for truth in truths {
        let speaker = truth.clip.speaker.as_str();
        if speakers.contains_key(speaker) {
            continue;
        }
        let filmed: Vec<&Clip> = folder
            .split(Split::Train)
            .filter(|c| c.video_frames > 0)
            .collect();
        let his: Vec<&Clip> = filmed.iter().copied().filter(|c| c.speaker == speaker).collect();
        // Of a speaker without training clips nothing is known but what mouths are like.
        let clips = if his.is_empty() { filmed } else { his };
        let step = clips.len().div_ceil(CLIPS).max(1);
        let means: Vec<Array1<f32>> = clips
            .par_iter()
            .step_by(step)
            .map(|clip| of(clip))
            .collect::<Result<_>>()?;
        let sum = means
            .iter()
            .fold(Array1::zeros(space.size()), |sum, mean| sum + mean);
        speakers.insert(speaker, sum / means.len().max(1) as f32);
    }
    let means = truths.iter().zip(own).map(|(truth, own)| ClipMean {
        own,
        speakers: speakers[truth.clip.speaker.as_str()].clone(),
    });
    Ok(means.collect())
}
