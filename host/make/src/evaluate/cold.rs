//! Cold starts: the stream begins in the middle of a clip, with front end and model as new.
//!
//! GRID's clips share one timing (silence, six words, silence), which a model can learn by heart from the beginning of a
//! clip. The start is a random sample; the same frames of the same clip heard from its beginning stand beside it. So that both
//! fall on the same frames, the warm run leaves out the clip's first samples, less than one hop.
use lipstream::time;
use lipstream_core::{HOP_SAMPLES, SAMPLE_RATE_HZ};
use ndarray::{Array2, ArrayView2, s};
use rand::RngExt;
use serde::Serialize;

use super::Truth;
use super::bootstrap::{Difference, Interval};
use super::candidate::{Candidate, Heard};
use crate::error::Result;
use crate::features::FeatureFolder;
use crate::noise::generator;

/// Frames that are left after a start, at least.
pub const LEAST_FRAMES: usize = 160;
/// A start is at least this far into the clip, in samples, where the clip is long enough.
const FROM: usize = SAMPLE_RATE_HZ as usize / 2;
/// Frames of the first half second.
pub const FIRST: usize = 50;

/// What a candidate scored from cold starts on, and on the same frames warm.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// What the candidate is called in the report.
    pub name: String,
    /// Mean squared distance a frame, cold.
    pub amse: Interval,
    /// Mean correlation of the mouth parameters, cold.
    pub acc: Interval,
    /// Mean squared distance a frame, warm.
    pub warm_amse: Interval,
    /// Mean correlation of the mouth parameters, warm.
    pub warm_acc: Interval,
    /// Cold less warm.
    pub amse_difference: Difference,
    /// Cold less warm.
    pub acc_difference: Difference,
    /// Of the first half second after the start.
    pub first_half_second_amse: f64,
    /// Of the same half second, heard from the clip's beginning.
    pub first_half_second_warm_amse: f64,
}

/// One clip and its start.
pub struct Start<'a> {
    /// What is heard from the start on.
    pub cold: Heard<'a>,
    /// What is heard from the clip's beginning on, less the samples that put both on the same frames.
    pub warm: Heard<'a>,
    /// Frames of the warm run before the start.
    pub before: usize,
    /// The mouth from the start on, `[frames, D]`.
    pub truth: Array2<f32>,
}

/// Sample at which the stream of clip `id` starts; `None` for a clip that is too short.
fn start(samples: usize, id: &str, seed: u64) -> Option<usize> {
    let left = time::samples_covered(LEAST_FRAMES);
    let latest = samples.checked_sub(left).filter(|latest| *latest > 0)?;
    Some(generator(seed, id, "cold start").random_range(FROM.min(latest)..=latest))
}

/// The mouth at the frames of a stream that begins at sample `first`: as `train::data::to_audio_rate`, later.
fn mouth_from(visual: ArrayView2<f32>, video_hz: f32, first: usize, frames: usize) -> Array2<f32> {
    let (n, d) = visual.dim();
    Array2::from_shape_fn((frames, d), |(t, i)| {
        let sample = (first + time::frame_sample(t)) as f32;
        let place = (sample / SAMPLE_RATE_HZ as f32 * video_hz - 0.5).clamp(0.0, (n - 1) as f32);
        let before = place.floor() as usize;
        let share = place - before as f32;
        visual[[before, i]] * (1.0 - share) + visual[[(before + 1).min(n - 1), i]] * share
    })
}

/// The starts of all clips that are long enough. `hear` runs the front end.
pub fn starts<'a>(
    folder: &FeatureFolder,
    truths: &'a [Truth],
    heard: &[Heard],
    seed: u64,
    hear: impl Fn(&'a str, Vec<i16>) -> Heard<'a>,
) -> Result<Vec<Start<'a>>> {
    let mut out = Vec::new();
    for (truth, heard) in truths.iter().zip(heard) {
        let Some(at) = start(heard.samples.len(), &truth.clip.id, seed) else {
            continue;
        };
        let cold = hear(&truth.clip.id, heard.samples[at..].to_vec());
        let warm = hear(&truth.clip.id, heard.samples[at % HOP_SAMPLES..].to_vec());
        out.push(Start {
            truth: mouth_from(
                folder.visual(truth.clip)?.view(),
                truth.clip.video_hz,
                at,
                cold.observations.nrows(),
            ),
            before: at / HOP_SAMPLES,
            cold,
            warm,
        });
    }
    Ok(out)
}

/// What a candidate says from a start on, `[frames, D]` both.
pub struct Said {
    /// From a stream that begins at the start.
    pub cold: Array2<f32>,
    /// The same frames from a stream that begins with the clip.
    pub warm: Array2<f32>,
}

impl Start<'_> {
    /// Runs a candidate on both streams. An error when it fails, or says something of the wrong shape.
    pub fn say(&self, candidate: &Candidate) -> Result<Said> {
        let (frames, size) = self.truth.dim();
        let cold = candidate.say(&self.cold, (frames, size))?.parameters;
        let warm = candidate
            .say(&self.warm, (frames + self.before, size))?
            .parameters;
        Ok(Said {
            cold,
            warm: warm.slice(s![self.before.min(warm.nrows()).., ..]).to_owned(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::data;
    use lipstream::reference::frame_count;

    #[test]
    fn enough_is_left_and_clips_differ() {
        let found: Vec<usize> = (0..50)
            .map(|n| start(47_600, &format!("clip{n}"), 1).unwrap())
            .collect();
        for &at in &found {
            assert!((8_000..=47_600).contains(&at) && frame_count(47_600 - at) >= LEAST_FRAMES);
        }
        assert!(found.iter().max() > found.iter().min());
        assert!(found.iter().any(|at| at % HOP_SAMPLES != 0));
        assert_eq!(start(47_600, "clip7", 1), Some(found[7]));
        assert_eq!(start(20_000, "clip", 1), None);
        assert!(start(26_000, "clip", 1).unwrap() <= 160);
    }

    #[test]
    fn the_mouth_from_a_whole_hop_on_is_a_part_of_the_clip() {
        let visual = Array2::from_shape_fn((75, 2), |(t, i)| ((t * (i + 3)) % 11) as f32);
        let whole = data::to_audio_rate(visual.view(), 25.0, 296);
        let part = mouth_from(visual.view(), 25.0, 40 * HOP_SAMPLES, 256);
        for (a, b) in part.iter().zip(whole.slice(s![40.., ..])) {
            assert!((a - b).abs() < 1e-3);
        }
        // Half a hop later is half-way between two frames; 41 and 42 lie between the same two pictures.
        let half = mouth_from(visual.view(), 25.0, 41 * HOP_SAMPLES + HOP_SAMPLES / 2, 1);
        let middle = (whole[[41, 0]] + whole[[42, 0]]) / 2.0;
        assert!((half[[0, 0]] - middle).abs() < 1e-3);
    }
}
