//! Measuring systems on a feature folder: candidates in, a report out.
pub mod bootstrap;
pub mod candidate;
pub mod changes;
mod clip_means;
pub mod closure;
pub mod cold;
pub mod common_space;
pub mod exchange;
pub mod figures;
pub mod held_out;
pub mod hierarchical;
pub mod look_ahead;
mod measure;
pub mod metrics;
pub mod models;
pub mod pictures;
pub mod plot;
pub mod readability;
pub mod report;
pub mod ridge;
mod spoken;
pub mod strangers;
pub mod systems;
pub mod tables;
pub mod voices;
mod write;

use ndarray::Array2;
use rayon::prelude::*;

use crate::error::Result;
use crate::features::{Clip, FeatureFolder, Split};
use crate::train::data;
pub use candidate::{Candidate, Heard, Iteration, Prediction};
pub use measure::measure;
pub use report::{EvaluateSettings, NoiseSettings, Report};
pub use write::{Destination, Heading, html, json, markdown};

/// A clip with its mouth at the audio's rate.
pub struct Truth<'a> {
    /// The clip's entry in the manifest.
    pub clip: &'a Clip,
    /// Audio observations, `[frames, 39]` at 100 Hz.
    pub audio: Array2<f32>,
    /// The true mouth parameters, `[frames, D]` at 100 Hz.
    pub visual: Array2<f32>,
}

/// Clips of a split that have video.
pub fn truths(folder: &FeatureFolder, split: Split) -> Result<Vec<Truth<'_>>> {
    let clips: Vec<&Clip> = folder.split(split).filter(|c| c.video_frames > 0).collect();
    clips
        .into_par_iter()
        .map(|clip| {
            let visual = data::to_audio_rate(folder.visual(clip)?.view(), clip.video_hz, clip.audio_frames);
            Ok(Truth {
                clip,
                audio: folder.audio(clip)?,
                visual,
            })
        })
        .collect()
}
