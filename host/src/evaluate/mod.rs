//! Measuring models on a feature folder: each system's AMSE and ACC on one split.
pub mod metrics;
pub mod ridge;
mod table;

use anyhow::{Result, bail};
use ndarray::Array2;
use rayon::prelude::*;
use serde::Serialize;

use crate::features::{Clip, FeatureFolder, Split};
use crate::train::data;
use metrics::Score;
pub use table::{json, markdown};

/// What one system scored.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    pub system: String,
    /// Future that the system looks at, in ms between frame centres; `None`: the whole utterance.
    pub look_ahead_ms: Option<u32>,
    pub amse: f64,
    /// Eq. 20 as printed: the mean distance, not squared.
    pub mean_distance: f64,
    pub acc: f64,
    pub acc_of_first_5: f64,
    pub correlations: Vec<f64>,
}

/// A clip with its mouth at the audio's rate.
pub struct Truth<'a> {
    pub clip: &'a Clip,
    pub audio: Array2<f32>,
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

/// Scores `predict` on every clip. A prediction may lack some frames at the end, not more than five.
pub fn score(
    system: &str,
    look_ahead_ms: Option<u32>,
    truths: &[Truth],
    predict: impl Fn(&Truth) -> Result<Array2<f32>> + Sync,
) -> Result<Row> {
    let said: Vec<Array2<f32>> = truths.par_iter().map(&predict).collect::<Result<_>>()?;
    let size = truths.first().map_or(0, |t| t.visual.ncols());
    let mut score = Score::new(size);
    for (truth, said) in truths.iter().zip(&said) {
        if said.ncols() != size || said.nrows().abs_diff(truth.visual.nrows()) > 5 {
            bail!(
                "{system}: clip {} has {:?} mouth parameters, its video has {:?}",
                truth.clip.id,
                said.dim(),
                truth.visual.dim()
            );
        }
        score.add(&truth.visual, said);
    }
    Ok(Row {
        system: system.to_owned(),
        look_ahead_ms,
        amse: score.amse(),
        mean_distance: score.mean_distance(),
        acc: score.acc(),
        acc_of_first_5: score.acc_of_first(5),
        correlations: score.correlations(),
    })
}
