//! How a conversion goes, iteration by iteration, and how a parameter goes, frame by frame: what the figures draw.
use rayon::prelude::*;

use super::{Bench, CONVERGENCE_CLIPS, Whole, spread};
use crate::error::Result;
use crate::evaluate::candidate::Candidate;
use crate::evaluate::metrics::Score;
use crate::evaluate::report::{ClipConvergence, Convergence, Predicted, Trajectory};
use crate::features::Clip;

impl Bench<'_> {
    /// `None` for a candidate that does not iterate.
    pub(super) fn convergence(&self, candidate: &Candidate, detailed: bool) -> Result<Option<Convergence>> {
        let Some(iterate) = &candidate.iterations else {
            return Ok(None);
        };
        self.progress
            .say(&format!("measuring: {}, iterations", candidate.name));
        let clips: Vec<(Vec<Score>, Vec<f64>)> = self
            .heard
            .par_iter()
            .zip(self.truths)
            .map(|(heard, truth)| {
                let iterations = iterate(heard)?;
                let mut scores = Vec::new();
                for iteration in &iterations {
                    candidate.check(heard.id, &iteration.parameters, truth.visual.dim())?;
                    scores.push(Score::of(&truth.visual, &iteration.parameters));
                }
                let frames = truth.visual.nrows().max(1) as f64;
                let likelihood = iterations.iter().map(|i| i.log_likelihood / frames).collect();
                Ok((scores, likelihood))
            })
            .collect::<Result<_>>()?;
        let length = clips.iter().map(|(scores, _)| scores.len()).min().unwrap_or(0);
        let pooled: Vec<Score> = (0..length)
            .map(|n| {
                let mut sum = Score::new(self.folder.manifest.visual_size);
                clips.iter().for_each(|(scores, _)| sum.merge(&scores[n]));
                sum
            })
            .collect();
        let frames: f64 = pooled.first().map_or(1.0, |score| score.frames() as f64);
        let likelihood = |n: usize| {
            let sums = clips.iter().map(|(scores, l)| l[n] * scores[n].frames() as f64);
            sums.sum::<f64>() / frames
        };
        let falls = |l: &Vec<f64>| {
            l.windows(2)
                .filter(|w| w[1] < w[0] - 1e-6 * w[0].abs().max(1.0))
                .count()
        };
        Ok(Some(Convergence {
            name: candidate.name.clone(),
            acc: pooled.iter().map(Score::acc).collect(),
            amse: pooled.iter().map(Score::amse).collect(),
            log_likelihood: (0..length).map(likelihood).collect(),
            falls: clips.iter().map(|(_, l)| falls(l)).sum(),
            clips: spread(clips.len(), if detailed { CONVERGENCE_CLIPS } else { 0 })
                .into_iter()
                .map(|n| ClipConvergence {
                    clip: self.heard[n].id.to_owned(),
                    acc: clips[n].0.iter().map(Score::acc).collect(),
                    log_likelihood: clips[n].1.clone(),
                })
                .collect(),
        }))
    }

    pub(super) fn trajectories(
        &self,
        candidates: &[Candidate],
        whole: &[Whole],
        reference: Option<usize>,
        drawn: &[usize],
    ) -> Vec<Trajectory> {
        // X&L hold the single-state Viterbi means against their conversion; without that system, the plain baseline.
        let old = candidates
            .iter()
            .position(|c| c.name == "viterbi")
            .or_else(|| candidates.iter().position(|c| c.name.starts_with("ridge")));
        let mut shown: Vec<usize> = reference.into_iter().chain(old).collect();
        shown.dedup();
        let words = |clip: &Clip| {
            let words: Vec<&str> = clip.words.iter().map(|w| w.text.as_str()).collect();
            words.join(" ")
        };
        drawn
            .iter()
            .enumerate()
            .map(|(place, &n)| Trajectory {
                clip: self.truths[n].clip.id.clone(),
                words: words(self.truths[n].clip),
                actual: self.truths[n].visual.column(0).to_vec(),
                predicted: shown
                    .iter()
                    .map(|&c| Predicted {
                        name: candidates[c].name.clone(),
                        values: whole[c].drawn[place].clone(),
                    })
                    .collect(),
            })
            .collect()
    }
}
