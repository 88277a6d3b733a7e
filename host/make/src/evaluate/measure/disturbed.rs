//! Candidates in noise, and in streams that begin in mid-clip.
use ndarray::{Array2, s};
use rayon::prelude::*;

use super::Bench;
use crate::error::{Error, Result, ensure};
use crate::evaluate::bootstrap::{Draws, Resampled};
use crate::evaluate::candidate::{Candidate, Heard};
use crate::evaluate::cold;
use crate::evaluate::metrics::Score;
use crate::evaluate::report::{ColdStarts, NoiseCondition, NoiseRow};
use crate::features::Split;
use crate::noise;
use lipstream_media::sound;

impl Bench<'_> {
    pub(super) fn noise(&self, candidates: &[Candidate]) -> Result<Vec<NoiseCondition>> {
        let Some(settings) = &self.settings.noise else {
            return Ok(Vec::new());
        };
        let listeners: Vec<&Candidate> = candidates
            .iter()
            .filter(|c| c.hears && c.listed)
            .filter(|c| settings.systems.is_empty() || settings.systems.contains(&c.name))
            .collect();
        let folder = settings.babble.as_ref().unwrap_or(self.folder);
        ensure!(
            folder.split(Split::Train).next().is_some(),
            Data,
            "{} has no training clip that could babble",
            folder.root.display()
        );
        let voices: Vec<(String, Vec<i16>)> = folder
            .split(Split::Train)
            .map(|clip| {
                Ok((
                    clip.id.clone(),
                    sound::read(&folder.wav_path(&clip.id))
                        .map_err(Error::other)?
                        .samples,
                ))
            })
            .collect::<Result<_>>()?;
        let mut out = Vec::new();
        for kind in [noise::Kind::White, noise::Kind::Babble] {
            let beside: Vec<Vec<f64>> = self
                .heard
                .par_iter()
                .map(|heard| {
                    let mut rng = noise::generator(self.settings.seed, heard.id, kind.name());
                    match kind {
                        noise::Kind::White => noise::white(&mut rng, heard.samples.len()),
                        noise::Kind::Babble => {
                            let others = voices.iter().filter(|(id, _)| id != heard.id);
                            let others: Vec<&[i16]> = others.map(|(_, samples)| samples.as_slice()).collect();
                            noise::babble(&mut rng, &others, heard.samples.len())
                        }
                    }
                })
                .collect();
            for &snr_db in &settings.snrs_db {
                self.progress
                    .say(&format!("measuring: {} noise, {snr_db} dB", kind.name()));
                let noisy: Vec<Heard> = self
                    .heard
                    .par_iter()
                    .zip(&beside)
                    .map(|(heard, noise)| self.hear(heard.id, noise::add(&heard.samples, noise, snr_db)))
                    .collect();
                let rows = listeners.iter().map(|candidate| {
                    let scores = noisy
                        .par_iter()
                        .zip(self.truths)
                        .map(|(heard, truth)| {
                            let said = candidate.say(heard, truth.visual.dim())?;
                            Ok(Score::of(&truth.visual, &said.parameters))
                        })
                        .collect::<Result<_>>()?;
                    let scores = Resampled::new(scores, &self.draws);
                    Ok(NoiseRow {
                        name: candidate.name.clone(),
                        amse: scores.interval(Score::amse),
                        acc: scores.interval(Score::acc),
                    })
                });
                out.push(NoiseCondition {
                    kind,
                    snr_db,
                    systems: rows.collect::<Result<_>>()?,
                });
            }
        }
        Ok(out)
    }

    pub(super) fn cold_starts(&self, candidates: &[Candidate]) -> Result<Option<ColdStarts>> {
        if !self.settings.cold_starts {
            return Ok(None);
        }
        let seed = self.settings.seed;
        let hear = |id, samples| self.hear(id, samples);
        let starts = cold::starts(self.folder, self.truths, self.heard, seed, hear)?;
        if starts.is_empty() {
            return Ok(None);
        }
        let draws = Draws::new(starts.len(), self.settings.resamples, seed);
        let mut systems = Vec::new();
        for candidate in candidates.iter().filter(|c| c.hears && c.listed) {
            self.progress
                .say(&format!("measuring: {}, cold starts", candidate.name));
            let said: Vec<cold::Said> = starts
                .par_iter()
                .map(|start| start.say(candidate))
                .collect::<Result<_>>()?;
            let score = |which: fn(&cold::Said) -> &Array2<f32>, frames: usize| {
                let clips = starts.iter().zip(&said).map(|(start, said)| {
                    let (truth, said) = (&start.truth, which(said));
                    let head = |a: &Array2<f32>| a.slice(s![..frames.min(a.nrows()), ..]).to_owned();
                    Score::of(&head(truth), &head(said))
                });
                Resampled::new(clips.collect(), &draws)
            };
            let (cold, warm) = (score(|s| &s.cold, usize::MAX), score(|s| &s.warm, usize::MAX));
            systems.push(cold::Row {
                name: candidate.name.clone(),
                amse: cold.interval(Score::amse),
                acc: cold.interval(Score::acc),
                warm_amse: warm.interval(Score::amse),
                warm_acc: warm.interval(Score::acc),
                amse_difference: cold.against(&warm, &draws, Score::amse),
                acc_difference: cold.against(&warm, &draws, Score::acc),
                first_half_second_amse: score(|s| &s.cold, cold::FIRST).whole.amse(),
                first_half_second_warm_amse: score(|s| &s.warm, cold::FIRST).whole.amse(),
            });
        }
        Ok(Some(ColdStarts {
            clips: starts.len(),
            frames: starts.iter().map(|s| s.truth.nrows()).sum(),
            systems,
        }))
    }
}
