//! What is measured of every candidate, as numbers: the report before anybody has formatted it.
use serde::Serialize;

use super::bootstrap::{Difference, Interval};
use super::closure::Closure;
use super::cold;
use super::common_space::Common;
use super::readability::Readable;
use crate::features::{FeatureFolder, Split};
use crate::hierarchical::Landmarks;
use crate::noise;

/// What is measured, and how.
#[derive(Clone, Debug)]
pub struct EvaluateSettings {
    /// Resamples of the intervals and tests.
    pub resamples: usize,
    /// Seed of the resamples, the noise and the cold starts.
    pub seed: u64,
    /// Candidate that the others are compared with; `None`: `ph-vi-chmm`, or the first whose name begins so.
    pub reference: Option<String>,
    /// Noise to measure in; `None`: no noise is added.
    pub noise: Option<NoiseSettings>,
    /// Whether streams that begin in mid-clip are measured too.
    pub cold_starts: bool,
    /// Landmarks of the clips, for the lip gap and the pictures of all systems; `None`: they are not compared so.
    pub landmarks: Option<Landmarks>,
}

/// How noise is added.
#[derive(Clone, Debug)]
pub struct NoiseSettings {
    /// Signal-to-noise ratios over speech, in dB.
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
            landmarks: None,
        }
    }
}

/// Everything that was measured.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Last part of the folder's path.
    pub folder: String,
    /// Split whose clips were measured.
    pub split: Split,
    /// Number of clips measured.
    pub clips: usize,
    /// Their frames together, at 100 Hz.
    pub frames: usize,
    /// Numbers in a mouth frame.
    pub parameters: usize,
    /// Resamples of the intervals and tests.
    pub resamples: usize,
    /// Seed of everything that is drawn at random.
    pub seed: u64,
    /// Name of the candidate that the others are compared with, if there is one.
    pub reference: Option<String>,
    /// Every listed candidate on whole clips.
    pub systems: Vec<System>,
    /// Quality against look-ahead, a curve a family.
    pub look_ahead: Vec<Curve>,
    /// Folder whose voices babble.
    pub babble_of: Option<String>,
    /// One entry for each noise and ratio; empty where no noise was measured.
    pub noise: Vec<NoiseCondition>,
    /// Streams that begin in mid-clip, where they were measured.
    pub cold_starts: Option<ColdStarts>,
    /// How fast speech itself changes, to hold the systems' changes against.
    pub rates: Rates,
    /// How well the mouths close, where it could be measured.
    pub closure: Option<Closure>,
    /// How many words a lip reader who learnt from true mouths reads off the true mouths of these clips, where it could be measured.
    pub true_readability: Option<Interval>,
    /// The true mouth's weights in the space that all systems have in common, where it was asked for: what reading them costs.
    pub true_common: Option<Common>,
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
    /// Name of the candidate.
    pub name: String,
    /// Future that it looks at, in ms; `None`: the whole utterance.
    pub look_ahead_ms: Option<u32>,
    /// Mean squared distance a frame.
    pub amse: Interval,
    /// Eq. 20 as printed: the mean distance, not squared.
    pub mean_distance: Interval,
    /// Mean correlation of the mouth parameters.
    pub acc: Interval,
    /// Mean correlation of the first five, which carry most of the motion.
    pub acc_of_first_5: Interval,
    /// Of each parameter.
    pub correlations: Vec<f64>,
    /// AMSE and ACC with the clips' means left in; `None` where they are not known.
    pub with_clip_means: Option<[Interval; 2]>,
    /// This system less the reference; `None` for the reference itself.
    pub against_reference: Option<Against>,
    /// How many words the lip reader reads off this system's mouth, where it could be measured.
    pub readability: Option<Readable>,
    /// In speech, by the labels: how often the likeliest viseme changes, and how often a drawn mouth shape (`cues`) does.
    pub viseme_changes_per_second: Option<f64>,
    /// Cues that begin in a second of speech; `None` for a system without visemes.
    pub cue_changes_per_second: Option<f64>,
    /// How often in a second of speech the lip gap turns between opening and closing, where it could be measured.
    pub gap_turns_per_second: Option<f64>,
    /// Lip gap and pictures against landmarks and recording, where it was asked for.
    pub common: Option<Common>,
}

/// Changes in a second of speech.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Rates {
    /// Of the viseme, as the phones' labels (or their alignment) have it.
    pub label_visemes: f64,
    /// Of the shape that `cues` draws, if each label were shown for as long as it lasts.
    pub label_cues: f64,
    /// Turns of the true mouth's lip gap, where it could be measured.
    pub true_gap_turns: Option<f64>,
}

/// Differences from the reference on the same clips.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Against {
    /// Of the mean squared distance; below 0 where the system is better.
    pub amse: Difference,
    /// Of the mean correlation; above 0 where the system is better.
    pub acc: Difference,
}

/// One family at several look-aheads.
#[derive(Clone, Debug, Serialize)]
pub struct Curve {
    /// What the family is called.
    pub family: String,
    /// Its members by rising look-ahead, those that need the whole utterance last.
    pub points: Vec<Point>,
}

/// One member of a family on whole clips.
#[derive(Clone, Debug, Serialize)]
pub struct Point {
    /// Name of the candidate.
    pub system: String,
    /// Future that it looks at, in ms; `None`: the whole utterance.
    pub look_ahead_ms: Option<u32>,
    /// Mean squared distance a frame.
    pub amse: Interval,
    /// Mean correlation of the mouth parameters.
    pub acc: Interval,
}

/// One noise at one ratio.
#[derive(Clone, Debug, Serialize)]
pub struct NoiseCondition {
    /// What is heard beside the speaker.
    pub kind: noise::Kind,
    /// Over speech.
    pub snr_db: f64,
    /// The candidates that hear the noise.
    pub systems: Vec<NoiseRow>,
}

/// One candidate in one noise.
#[derive(Clone, Debug, Serialize)]
pub struct NoiseRow {
    /// Name of the candidate.
    pub name: String,
    /// Mean squared distance a frame.
    pub amse: Interval,
    /// Mean correlation of the mouth parameters.
    pub acc: Interval,
}

/// Streams that begin in mid-clip.
#[derive(Clone, Debug, Serialize)]
pub struct ColdStarts {
    /// Clips that are long enough.
    pub clips: usize,
    /// Frames after the starts, over all clips.
    pub frames: usize,
    /// Every candidate that was measured from cold starts.
    pub systems: Vec<cold::Row>,
}

/// How one system's conversion converges.
#[derive(Clone, Debug, Serialize)]
pub struct Convergence {
    /// Name of the candidate.
    pub name: String,
    /// Over all clips, per iteration, as far as every clip got.
    pub acc: Vec<f64>,
    /// Mean squared distance a frame, over the same clips and iterations.
    pub amse: Vec<f64>,
    /// Log likelihood a frame, over all clips.
    pub log_likelihood: Vec<f64>,
    /// Steps in which the likelihood of a clip fell by more than rounding.
    pub falls: usize,
    /// Eight clips on their own; only for the reference (or the first system that iterates).
    pub clips: Vec<ClipConvergence>,
}

/// How the conversion of one clip converges.
#[derive(Clone, Debug, Serialize)]
pub struct ClipConvergence {
    /// Name of the clip.
    pub clip: String,
    /// Mean correlation of the mouth parameters, per iteration.
    pub acc: Vec<f64>,
    /// A frame.
    pub log_likelihood: Vec<f64>,
}

/// The first parameter over a clip, 100 a second.
#[derive(Clone, Debug, Serialize)]
pub struct Trajectory {
    /// Name of the clip.
    pub clip: String,
    /// The words said in it, with spaces between.
    pub words: String,
    /// The true parameter, one value a frame.
    pub actual: Vec<f32>,
    /// The reference first, then the old way to hold against it.
    pub predicted: Vec<Predicted>,
}

/// One system's first parameter over a clip.
#[derive(Clone, Debug, Serialize)]
pub struct Predicted {
    /// Name of the candidate.
    pub name: String,
    /// The predicted parameter, one value a frame.
    pub values: Vec<f32>,
}
