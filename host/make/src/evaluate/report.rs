//! What is measured of every candidate, as numbers: the report before anybody has formatted it.
use serde::Serialize;

use super::bootstrap::{Difference, Interval};
use super::closure::Closure;
use super::cold;
use crate::features::{FeatureFolder, Split};
use crate::noise;

/// What is measured, and how.
#[derive(Clone, Debug)]
pub struct EvaluateSettings {
    /// Resamples of the intervals and tests.
    pub resamples: usize,
    pub seed: u64,
    /// Candidate that the others are compared with; `None`: `ph-vi-chmm`, or the first whose name begins so.
    pub reference: Option<String>,
    pub noise: Option<NoiseSettings>,
    pub cold_starts: bool,
}

/// How noise is added.
#[derive(Clone, Debug)]
pub struct NoiseSettings {
    pub snrs_db: Vec<f64>,
    /// Folder whose clips babble; `None`: the training clips of the folder that is measured.
    pub babble: Option<FeatureFolder>,
    /// Candidates that hear it; empty: all that are listed.
    pub systems: Vec<String>,
}

impl Default for NoiseSettings {
    fn default() -> Self {
        Self {
            snrs_db: vec![20.0, 15.0, 10.0, 5.0, 0.0],
            babble: None,
            systems: Vec::new(),
        }
    }
}

impl Default for EvaluateSettings {
    fn default() -> Self {
        Self {
            resamples: 1000,
            seed: 1,
            reference: None,
            noise: None,
            cold_starts: false,
        }
    }
}

/// Everything that was measured.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Last part of the folder's path.
    pub folder: String,
    pub split: Split,
    pub clips: usize,
    pub frames: usize,
    /// Numbers in a mouth frame.
    pub parameters: usize,
    pub resamples: usize,
    pub seed: u64,
    pub reference: Option<String>,
    pub systems: Vec<System>,
    /// Quality against look-ahead, a curve a family.
    pub look_ahead: Vec<Curve>,
    /// Folder whose voices babble.
    pub babble_of: Option<String>,
    pub noise: Vec<NoiseCondition>,
    pub cold_starts: Option<ColdStarts>,
    pub closure: Option<Closure>,
    /// X&L figure 10, for systems that iterate.
    pub convergence: Vec<Convergence>,
    /// X&L figures 7 and 11: the first parameter of a few clips.
    pub trajectories: Vec<Trajectory>,
    /// What could not be measured, and why.
    pub notes: Vec<String>,
}

/// One candidate on whole clips.
#[derive(Clone, Debug, Serialize)]
pub struct System {
    pub name: String,
    pub look_ahead_ms: Option<u32>,
    pub amse: Interval,
    /// Eq. 20 as printed: the mean distance, not squared.
    pub mean_distance: Interval,
    pub acc: Interval,
    pub acc_of_first_5: Interval,
    /// Of each parameter.
    pub correlations: Vec<f64>,
    /// This system less the reference; `None` for the reference itself.
    pub against_reference: Option<Against>,
    /// In speech, by the labels: how often the likeliest viseme changes, and how often a drawn mouth shape (`cues`) does.
    pub viseme_changes_per_second: Option<f64>,
    pub cue_changes_per_second: Option<f64>,
}

/// Differences from the reference on the same clips.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Against {
    pub amse: Difference,
    pub acc: Difference,
}

/// One family at several look-aheads.
#[derive(Clone, Debug, Serialize)]
pub struct Curve {
    pub family: String,
    pub points: Vec<Point>,
}

#[derive(Clone, Debug, Serialize)]
pub struct Point {
    pub system: String,
    pub look_ahead_ms: Option<u32>,
    pub amse: Interval,
    pub acc: Interval,
}

/// One noise at one ratio.
#[derive(Clone, Debug, Serialize)]
pub struct NoiseCondition {
    pub kind: noise::Kind,
    /// Over speech.
    pub snr_db: f64,
    pub systems: Vec<NoiseRow>,
}

#[derive(Clone, Debug, Serialize)]
pub struct NoiseRow {
    pub name: String,
    pub amse: Interval,
    pub acc: Interval,
}

/// Streams that begin in mid-clip.
#[derive(Clone, Debug, Serialize)]
pub struct ColdStarts {
    /// Clips that are long enough.
    pub clips: usize,
    pub frames: usize,
    pub systems: Vec<cold::Row>,
}

/// How one system's conversion converges.
#[derive(Clone, Debug, Serialize)]
pub struct Convergence {
    pub name: String,
    /// Over all clips, per iteration, as far as every clip got.
    pub acc: Vec<f64>,
    pub amse: Vec<f64>,
    /// Log likelihood a frame, over all clips.
    pub log_likelihood: Vec<f64>,
    /// Steps in which the likelihood of a clip fell by more than rounding.
    pub falls: usize,
    /// Eight clips on their own; only for the reference (or the first system that iterates).
    pub clips: Vec<ClipConvergence>,
}

#[derive(Clone, Debug, Serialize)]
pub struct ClipConvergence {
    pub clip: String,
    pub acc: Vec<f64>,
    /// A frame.
    pub log_likelihood: Vec<f64>,
}

/// The first parameter over a clip, 100 a second.
#[derive(Clone, Debug, Serialize)]
pub struct Trajectory {
    pub clip: String,
    pub words: String,
    pub actual: Vec<f32>,
    /// The reference first, then the old way to hold against it.
    pub predicted: Vec<Predicted>,
}

#[derive(Clone, Debug, Serialize)]
pub struct Predicted {
    pub name: String,
    pub values: Vec<f32>,
}
