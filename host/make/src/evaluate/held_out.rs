//! How well systems say words that they have never seen said ([`folds`](crate::folds)): on the frames of the held-out words alone, the rest of a test clip
//! being heard as ever. Beside it the same frames by systems trained on as many clips of all words, and on all clips.
use ndarray::{Array2, Axis};
use rayon::prelude::*;
use serde::Serialize;

use super::Truth;
use super::bootstrap::{Difference, Draws, Interval, Resampled};
use super::candidate::{Candidate, Heard};
use super::metrics::Score;
use super::truths;
use crate::error::{Error, Result, ensure};
use crate::features::{FeatureFolder, Split};
use crate::folds::{Fold, Folds};
use lipstream::progress::Progress;
use lipstream_media::sound;

/// The systems of one fold, under the names that they have when trained on everything.
pub struct OfFold<'a> {
    /// Trained without the fold's words.
    pub words: Vec<Candidate<'a>>,
    /// Trained on as many clips of all words; systems may lack here.
    pub size: Vec<Candidate<'a>>,
}

/// What is asked of the measuring.
#[derive(Clone, Copy, Debug)]
pub struct HeldOutSettings {
    /// Whose clips are measured on.
    pub split: Split,
    /// Of the intervals and the test.
    pub resamples: usize,
    /// Of the resamples.
    pub seed: u64,
}

/// What was measured.
#[derive(Clone, Debug, Serialize)]
pub struct HeldOut {
    /// Name of the folder.
    pub folder: String,
    /// Whose clips were measured on.
    pub split: Split,
    /// Clips in which a held-out word is said, and the words' frames.
    pub clips: usize,
    /// See `clips`.
    pub frames: usize,
    /// The words of each fold.
    pub folds: Vec<Fold>,
    /// One row a system.
    pub systems: Vec<Row>,
}

/// One system on the frames of held-out words.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The system's name.
    pub name: String,
    /// Of the system trained on everything.
    pub look_ahead_ms: Option<u32>,
    /// Trained on everything.
    pub all: Scores,
    /// Trained on as many clips as the fold without the words has.
    pub size: Option<Scores>,
    /// Trained without the words.
    pub words: Scores,
    /// ACC without the words less ACC on as many clips, or on everything where that is not known.
    pub cost: Difference,
}

/// AMSE and ACC with their intervals.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Scores {
    /// Mean squared distance a frame.
    pub amse: Interval,
    /// X&L eq. 21.
    pub acc: Interval,
}

/// Measures the systems `all`, trained on everything, and those of each fold.
///
/// # Errors
///
/// [`Error::Data`] where no clip of the split says a held-out word with times, [`Error::Choice`] where a system lacks in a fold, and what a system says of a clip that it cannot hear.
pub fn measure(
    folder: &FeatureFolder,
    folds: &Folds,
    all: &[Candidate],
    of_fold: &[OfFold],
    settings: HeldOutSettings,
    progress: &dyn Progress,
) -> Result<HeldOut> {
    let truths = truths(folder, settings.split)?;
    let spoken = |truth: &Truth, fold: &Fold| fold.frames(truth.clip);
    let clips: Vec<Tested> = truths
        .iter()
        .filter_map(|truth| {
            let frames: Vec<Vec<usize>> = folds.folds.iter().map(|f| spoken(truth, f)).collect();
            let says_any = frames.iter().any(|f| !f.is_empty());
            says_any.then_some((truth, frames))
        })
        .map(|(truth, frames)| {
            let samples = sound::read(&folder.wav_path(&truth.clip.id)).map_err(Error::other)?;
            let heard = Heard {
                id: &truth.clip.id,
                samples: samples.samples,
                observations: truth.audio.clone(),
            };
            Ok(Tested {
                heard,
                truth: &truth.visual,
                frames,
            })
        })
        .collect::<Result<_>>()?;
    ensure!(
        !clips.is_empty(),
        Data,
        "{}: no {} clip says a held-out word with times",
        folder.root.display(),
        settings.split.name()
    );
    let draws = Draws::new(clips.len(), settings.resamples, settings.seed);
    let mut systems = Vec::new();
    for candidate in all {
        progress.say(&format!("measuring: {}", candidate.name));
        let named = |others: &'_ [Candidate<'_>]| others.iter().position(|c| c.name == candidate.name);
        let words: Vec<&Candidate> = of_fold
            .iter()
            .enumerate()
            .map(|(n, fold)| {
                let place = named(&fold.words);
                place.map(|place| &fold.words[place]).ok_or_else(|| {
                    Error::Choice(format!(
                        "{} is not there without the words of fold {}",
                        candidate.name,
                        n + 1
                    ))
                })
            })
            .collect::<Result<_>>()?;
        let size: Option<Vec<&Candidate>> = of_fold
            .iter()
            .map(|fold| named(&fold.size).map(|place| &fold.size[place]))
            .collect();
        let everywhere = vec![candidate; folds.folds.len()];
        let score = |of_fold: &[&Candidate]| -> Result<Resampled> {
            let clips = clips.par_iter().map(|clip| clip.score(of_fold));
            Ok(Resampled::new(clips.collect::<Result<_>>()?, &draws))
        };
        let (all, words) = (score(&everywhere)?, score(&words)?);
        let size = size.map(|size| score(&size)).transpose()?;
        systems.push(Row {
            name: candidate.name.clone(),
            look_ahead_ms: candidate.look_ahead_ms,
            cost: words.against(size.as_ref().unwrap_or(&all), &draws, Score::acc),
            all: Scores::of(&all),
            size: size.as_ref().map(Scores::of),
            words: Scores::of(&words),
        });
    }
    let frames = clips.iter().flat_map(|clip| &clip.frames).map(Vec::len);
    Ok(HeldOut {
        folder: folder.name(),
        split: settings.split,
        clips: clips.len(),
        frames: frames.sum(),
        folds: folds.folds.clone(),
        systems,
    })
}

impl Scores {
    fn of(scores: &Resampled) -> Self {
        Self {
            amse: scores.interval(Score::amse),
            acc: scores.interval(Score::acc),
        }
    }
}

/// A clip and its frames of held-out words, fold by fold.
struct Tested<'a> {
    heard: Heard<'a>,
    truth: &'a Array2<f32>,
    frames: Vec<Vec<usize>>,
}

impl Tested<'_> {
    /// The score on the held-out words of all folds, each said by its own system.
    fn score(&self, of_fold: &[&Candidate]) -> Result<Score> {
        let mut score = Score::new(self.truth.ncols());
        for (candidate, frames) in of_fold.iter().zip(&self.frames) {
            if frames.is_empty() {
                continue;
            }
            let said = candidate.say(&self.heard, self.truth.dim())?.parameters;
            let both = said.nrows().min(self.truth.nrows());
            let frames: Vec<usize> = frames.iter().copied().filter(|&t| t < both).collect();
            score.add(
                &self.truth.select(Axis(0), &frames),
                &said.select(Axis(0), &frames),
            );
        }
        Ok(score)
    }
}

impl HeldOut {
    /// The tables.
    pub fn markdown(&self) -> String {
        let mut out = format!(
            "{} {} clips of {}, {} frames of held-out words.\n\n| fold | training clips left | words |\n|---|---|---|\n",
            self.clips,
            self.split.name(),
            self.folder,
            self.frames
        );
        for (n, fold) in self.folds.iter().enumerate() {
            out += &format!("| {} | {} | {} |\n", n + 1, fold.left, fold.words.join(" "));
        }
        out += "\n| system | look-ahead | all clips: AMSE | ACC | as many clips, all words: AMSE | ACC | words held out: AMSE | ACC | cost in ACC | p |\n";
        out += "|---|---|---|---|---|---|---|---|---|---|\n";
        let scores = |scores: &Scores| {
            format!(
                "{:.0} | {:.3} [{:.3}, {:.3}]",
                scores.amse.value, scores.acc.value, scores.acc.low, scores.acc.high
            )
        };
        for row in &self.systems {
            out += &format!(
                "| {} | {} | {} | {} | {} | {:+.3} [{:+.3}, {:+.3}] | {:.4} |\n",
                row.name,
                row.look_ahead_ms
                    .map_or_else(|| "whole clip".to_owned(), |ms| format!("{ms} ms")),
                scores(&row.all),
                row.size.as_ref().map_or_else(|| "– | –".to_owned(), scores),
                scores(&row.words),
                row.cost.difference,
                row.cost.low,
                row.cost.high,
                row.cost.p
            );
        }
        out
    }
}
