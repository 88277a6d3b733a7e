//! What is measured of every candidate, as numbers: the report before anybody has formatted it.
use std::collections::HashSet;

use anyhow::{Result, bail, ensure};
use rayon::prelude::*;
use serde::Serialize;

use super::bootstrap::{Difference, Draws, Interval, Resampled};
use super::candidate::{Candidate, Heard, Prediction};
use super::metrics::Score;
use super::{Truth, truths};
use crate::audio;
use crate::features::{FeatureFolder, Split};

/// What is measured, and how.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Resamples of the intervals and tests.
    pub resamples: usize,
    pub seed: u64,
    /// Candidate that the others are compared with; `None`: `ph-vi-chmm`, or the first whose name begins so.
    pub reference: Option<String>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            resamples: 1000,
            seed: 1,
            reference: None,
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
}

/// Differences from the reference on the same clips.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Against {
    pub amse: Difference,
    pub acc: Difference,
}

/// Measures every candidate on the clips of `split` that have video. `progress` hears what is being done.
pub fn measure(
    folder: &FeatureFolder,
    split: Split,
    candidates: &[Candidate],
    settings: &Settings,
    progress: &dyn Fn(&str),
) -> Result<Report> {
    let mut names = HashSet::new();
    for candidate in candidates {
        ensure!(
            names.insert(&candidate.name),
            "two systems are called {:?}",
            candidate.name
        );
    }
    let truths = truths(folder, split)?;
    if truths.is_empty() {
        bail!("{} has no clip with video in this split", folder.root.display());
    }
    let heard: Vec<Heard> = truths
        .par_iter()
        .map(|truth| {
            Ok(Heard {
                id: &truth.clip.id,
                samples: audio::read(&folder.wav_path(&truth.clip.id))?.samples,
                observations: truth.audio.clone(),
            })
        })
        .collect::<Result<_>>()?;
    let draws = Draws::new(truths.len(), settings.resamples, settings.seed);
    let reference = reference(candidates, settings)?;
    let mut resampled = Vec::new();
    for candidate in candidates {
        progress(&candidate.name);
        let said = predictions(candidate, &heard, &truths)?;
        let scores = truths.iter().zip(&said);
        let scores = scores.map(|(truth, said)| Score::of(&truth.visual, &said.parameters));
        resampled.push(Resampled::new(scores.collect(), &draws));
    }
    let systems = candidates
        .iter()
        .zip(&resampled)
        .enumerate()
        .map(|(n, (candidate, scores))| System {
            name: candidate.name.clone(),
            look_ahead_ms: candidate.look_ahead_ms,
            amse: scores.interval(Score::amse),
            mean_distance: scores.interval(Score::mean_distance),
            acc: scores.interval(Score::acc),
            acc_of_first_5: scores.interval(|s| s.acc_of_first(5)),
            correlations: scores.whole.correlations(),
            against_reference: reference.filter(|&r| r != n).map(|r| Against {
                amse: scores.against(&resampled[r], &draws, Score::amse),
                acc: scores.against(&resampled[r], &draws, Score::acc),
            }),
        })
        .collect();
    Ok(Report {
        folder: folder
            .root
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned(),
        split,
        clips: truths.len(),
        frames: truths.iter().map(|t| t.visual.nrows()).sum(),
        parameters: folder.manifest.visual_size,
        resamples: settings.resamples,
        seed: settings.seed,
        reference: reference.map(|r| candidates[r].name.clone()),
        systems,
    })
}

/// Place of the candidate that the others are compared with.
fn reference(candidates: &[Candidate], settings: &Settings) -> Result<Option<usize>> {
    let called = |name: &str| candidates.iter().position(|c| c.name == name);
    match &settings.reference {
        Some(name) => match called(name) {
            Some(place) => Ok(Some(place)),
            None => bail!("no system is called {name:?}, with which the others are to be compared"),
        },
        None => Ok(called("ph-vi-chmm").or_else(|| {
            candidates
                .iter()
                .position(|c| c.name.starts_with("ph-vi-chmm") && c.listed)
        })),
    }
}

/// What a candidate says about every clip.
fn predictions(candidate: &Candidate, heard: &[Heard], truths: &[Truth]) -> Result<Vec<Prediction>> {
    heard
        .par_iter()
        .zip(truths)
        .map(|(heard, truth)| candidate.say(heard, truth.visual.dim()))
        .collect()
}
