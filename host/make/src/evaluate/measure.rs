//! The measuring: every candidate on every clip, whole, in noise, and from cold starts.
use std::collections::HashSet;

use lipstream_core::{N_STATIC, SAMPLE_RATE_HZ};
use ndarray::{Array2, s};
use rayon::prelude::*;

use super::bootstrap::{Draws, Resampled};
use super::candidate::{Candidate, Heard};
use super::clip_means::{self, ClipMean};
use super::closure::{self, Closure, Gaps, TrueGap};
use super::metrics::Score;
use super::report::{
    Against, ClipConvergence, ColdStarts, Convergence, Curve, EvaluateSettings, NoiseCondition, NoiseRow,
    Point, Predicted, Rates, Report, System, Trajectory,
};
use super::{Truth, changes, cold, spoken, truths};
use crate::error::{Error, Result, bail, chain, ensure};
use crate::features::{Clip, FeatureFolder, PhoneLabel, Split};
use crate::noise;
use lipstream::progress::Progress;
use lipstream::reference::{self, Normalisation};
use lipstream_media::sound;

/// Clips drawn in figure 10 and in figure 11.
const CONVERGENCE_CLIPS: usize = 8;
const TRAJECTORY_CLIPS: usize = 6;

/// What is kept of a candidate's whole clips.
struct Whole {
    scores: Resampled,
    /// One a clip, empty where closure is not measured.
    gaps: Vec<Vec<f32>>,
    /// With the clips' means left in, where they are known.
    with_means: Option<Resampled>,
    /// Turns of the gap in a second of speech.
    turns: Option<f64>,
    changes: Option<changes::Changes>,
    /// First parameter of the clips that are drawn.
    drawn: Vec<Vec<f32>>,
}

/// What all measurements share.
struct Bench<'a> {
    folder: &'a FeatureFolder,
    truths: &'a [Truth<'a>],
    heard: &'a [Heard<'a>],
    /// What is said when, clip by clip.
    phones: &'a [Vec<PhoneLabel>],
    /// Of the clips; none where they are not known.
    means: Option<Vec<ClipMean>>,
    draws: Draws,
    settings: &'a EvaluateSettings,
    start_mean: [f32; N_STATIC],
    progress: &'a dyn Progress,
}

/// Measures every candidate on the clips of `split` that have video. `progress` hears what is being done.
pub fn measure(
    folder: &FeatureFolder,
    split: Split,
    candidates: &[Candidate],
    settings: &EvaluateSettings,
    progress: &dyn Progress,
) -> Result<Report> {
    check_names(candidates, settings)?;
    let truths = truths(folder, split)?;
    if truths.is_empty() {
        bail!(
            Data,
            "{} has no clip with video in this split",
            folder.root.display()
        );
    }
    let heard: Vec<Heard> = truths
        .par_iter()
        .map(|truth| {
            Ok(Heard {
                id: &truth.clip.id,
                samples: sound::read(&folder.wav_path(&truth.clip.id))
                    .map_err(Error::other)?
                    .samples,
                observations: truth.audio.clone(),
            })
        })
        .collect::<Result<_>>()?;
    let mut notes = Vec::new();
    progress.say("measuring: phones and mouth images");
    let phones = spoken::phones(&truths, &heard)?;
    let means = clip_means::learn(folder, &truths).map_err(|error| {
        notes.push(format!("The clips' means are not known: {}.", chain(&error)));
    });
    let bench = Bench {
        folder,
        truths: &truths,
        heard: &heard,
        phones: &phones,
        means: means.ok(),
        draws: Draws::new(truths.len(), settings.resamples, settings.seed),
        settings,
        start_mean: std::array::from_fn(|i| folder.manifest.start_mean[i]),
        progress,
    };
    let gaps = match bench.gaps() {
        Ok(gaps) => Some(gaps),
        Err(error) => {
            notes.push(format!("Closure was not measured: {}.", chain(&error)));
            None
        }
    };
    let reference = reference(candidates, settings)?;
    let drawn = spread(truths.len(), TRAJECTORY_CLIPS);
    let whole: Vec<Whole> = candidates
        .iter()
        .map(|candidate| bench.whole(candidate, gaps.as_ref(), &drawn))
        .collect::<Result<_>>()?;
    for candidate in candidates.iter().filter(|c| !c.hears && c.listed) {
        if settings.noise.is_some() || settings.cold_starts {
            notes.push(format!(
                "{} is there as files: it cannot hear noise or start in mid-clip.",
                candidate.name
            ));
        }
    }
    // Figure 10 draws clips of one system only: the reference, if it iterates.
    let iterates = |n: &usize| candidates[*n].iterations.is_some();
    let detailed = reference
        .filter(iterates)
        .or_else(|| (0..candidates.len()).find(iterates));
    let cold_starts = bench.cold_starts(candidates)?;
    if settings.cold_starts && cold_starts.is_none() {
        notes.push("No clip is long enough for a start in its middle.".to_owned());
    }
    Ok(Report {
        folder: folder.name(),
        split,
        clips: truths.len(),
        frames: truths.iter().map(|t| t.visual.nrows()).sum(),
        parameters: folder.manifest.visual_size,
        resamples: settings.resamples,
        seed: settings.seed,
        reference: reference.map(|r| candidates[r].name.clone()),
        systems: systems(candidates, &whole, reference, &bench.draws),
        rates: bench.rates(gaps.as_ref().map(|(_, truths)| &truths[..]))?,
        look_ahead: curves(candidates, &whole),
        babble_of: settings
            .noise
            .as_ref()
            .map(|n| n.babble.as_ref().unwrap_or(folder).name()),
        noise: bench.noise(candidates)?,
        cold_starts,
        closure: gaps.map(|(gaps, truths)| bench.closure(&gaps, &truths, candidates, &whole)),
        convergence: candidates
            .iter()
            .enumerate()
            .filter_map(|(n, candidate)| bench.convergence(candidate, detailed == Some(n)).transpose())
            .collect::<Result<_>>()?,
        trajectories: bench.trajectories(candidates, &whole, reference, &drawn),
        notes,
    })
}

fn check_names(candidates: &[Candidate], settings: &EvaluateSettings) -> Result<()> {
    let mut names = HashSet::new();
    for candidate in candidates {
        ensure!(
            names.insert(candidate.name.as_str()),
            Choice,
            "two systems are called {:?}",
            candidate.name
        );
    }
    for name in settings.noise.iter().flat_map(|noise| &noise.systems) {
        ensure!(
            names.contains(name.as_str()),
            Choice,
            "no system is called {name:?}, which is to hear noise"
        );
    }
    Ok(())
}

/// Place of the candidate that the others are compared with.
fn reference(candidates: &[Candidate], settings: &EvaluateSettings) -> Result<Option<usize>> {
    let called = |name: &str| candidates.iter().position(|c| c.name == name);
    match &settings.reference {
        Some(name) => match called(name) {
            Some(place) => Ok(Some(place)),
            None => bail!(
                Choice,
                "no system is called {name:?}, with which the others are to be compared"
            ),
        },
        None => Ok(called("ph-vi-chmm").or_else(|| {
            candidates
                .iter()
                .position(|c| c.name.starts_with("ph-vi-chmm") && c.listed)
        })),
    }
}

/// `wanted` places spread evenly over `n`.
fn spread(n: usize, wanted: usize) -> Vec<usize> {
    let wanted = wanted.min(n);
    (0..wanted).map(|k| (2 * k + 1) * n / (2 * wanted)).collect()
}

fn systems(
    candidates: &[Candidate],
    whole: &[Whole],
    reference: Option<usize>,
    draws: &Draws,
) -> Vec<System> {
    let listed = candidates.iter().zip(whole).enumerate();
    listed
        .filter(|(_, (candidate, _))| candidate.listed)
        .map(|(n, (candidate, own))| {
            let scores = &own.scores;
            System {
                name: candidate.name.clone(),
                look_ahead_ms: candidate.look_ahead_ms,
                amse: scores.interval(Score::amse),
                mean_distance: scores.interval(Score::mean_distance),
                acc: scores.interval(Score::acc),
                acc_of_first_5: scores.interval(|s| s.acc_of_first(5)),
                correlations: scores.whole.correlations(),
                with_clip_means: own
                    .with_means
                    .as_ref()
                    .map(|scores| [scores.interval(Score::amse), scores.interval(Score::acc)]),
                against_reference: reference.filter(|&r| r != n).map(|r| Against {
                    amse: scores.against(&whole[r].scores, draws, Score::amse),
                    acc: scores.against(&whole[r].scores, draws, Score::acc),
                }),
                viseme_changes_per_second: own.changes.map(|c| c.visemes_per_second()),
                cue_changes_per_second: own.changes.map(|c| c.cues_per_second()),
                gap_turns_per_second: own.turns,
            }
        })
        .collect()
}

/// Families of at least two, in the order in which they appear; points by look-ahead, the whole clip last.
fn curves(candidates: &[Candidate], whole: &[Whole]) -> Vec<Curve> {
    let mut curves: Vec<Curve> = Vec::new();
    for (candidate, own) in candidates.iter().zip(whole) {
        let Some(family) = &candidate.family else {
            continue;
        };
        let point = Point {
            system: candidate.name.clone(),
            look_ahead_ms: candidate.look_ahead_ms,
            amse: own.scores.interval(Score::amse),
            acc: own.scores.interval(Score::acc),
        };
        match curves.iter_mut().find(|curve| curve.family == *family) {
            Some(curve) => curve.points.push(point),
            None => curves.push(Curve {
                family: family.clone(),
                points: vec![point],
            }),
        }
    }
    curves.retain(|curve| curve.points.len() > 1);
    for curve in &mut curves {
        curve.points.sort_by_key(|p| p.look_ahead_ms.unwrap_or(u32::MAX));
    }
    curves
}

impl<'a> Bench<'a> {
    fn gaps(&self) -> Result<(Gaps, Vec<TrueGap>)> {
        let gaps = Gaps::learn(self.folder)?;
        let truths = self.truths.par_iter().zip(self.phones);
        let truths = truths
            .map(|(truth, phones)| gaps.truth(self.folder, truth.clip, phones))
            .collect::<Result<_>>()?;
        Ok((gaps, truths))
    }

    fn seconds(&self, n: usize) -> f64 {
        self.heard[n].samples.len() as f64 / f64::from(SAMPLE_RATE_HZ)
    }

    /// Turns of the lip gap in a second of speech, clip by clip in `said`; a turn goes as far as what counts as open.
    fn turns(&self, truths: &[TrueGap], said: &[Vec<f32>]) -> f64 {
        let (mut turns, mut seconds) = (0, 0.0);
        for (n, (truth, said)) in truths.iter().zip(said).enumerate() {
            let span = spoken::span(&self.phones[n], self.seconds(n));
            turns += spoken::turns(said, truth.closed_below(), span);
            seconds += (span.1 - span.0).max(0.0);
        }
        turns as f64 / f64::max(seconds, 1e-9)
    }

    fn rates(&self, truths: Option<&[TrueGap]>) -> Result<Rates> {
        let mut labels = changes::Changes::default();
        for (n, (truth, phones)) in self.truths.iter().zip(self.phones).enumerate() {
            let weights = spoken::visemes(phones, truth.visual.nrows());
            labels.add(changes::Changes::of(weights.view(), phones, self.seconds(n))?);
        }
        Ok(Rates {
            label_visemes: labels.visemes_per_second(),
            label_cues: labels.cues_per_second(),
            true_gap_turns: truths.map(|truths| {
                let true_gaps: Vec<Vec<f32>> = truths.iter().map(|t| t.gap().to_vec()).collect();
                self.turns(truths, &true_gaps)
            }),
        })
    }

    /// Features of other samples than the folder's.
    fn hear(&self, id: &'a str, samples: Vec<i16>) -> Heard<'a> {
        let start_mean = self.start_mean;
        Heard {
            id,
            observations: reference::observations(&samples, Normalisation::Causal { start_mean }),
            samples,
        }
    }

    fn whole(
        &self,
        candidate: &Candidate,
        gaps: Option<&(Gaps, Vec<TrueGap>)>,
        drawn: &[usize],
    ) -> Result<Whole> {
        self.progress.say(&format!("measuring: {}", candidate.name));
        struct Said {
            score: Score,
            with_mean: Option<Score>,
            gap: Vec<f32>,
            changes: Option<changes::Changes>,
            first: Vec<f32>,
        }
        let said: Vec<Said> = self
            .heard
            .par_iter()
            .zip(self.truths)
            .enumerate()
            .map(|(n, (heard, truth))| {
                let said = candidate.say(heard, truth.visual.dim())?;
                let visemes = said.visemes.as_ref();
                Ok(Said {
                    score: Score::of(&truth.visual, &said.parameters),
                    with_mean: self.means.as_ref().map(|means| {
                        let mean = &means[n];
                        Score::of(&(&truth.visual + &mean.own), &(&said.parameters + &mean.speakers))
                    }),
                    gap: gaps.map_or(Vec::new(), |(gaps, _)| gaps.read_out(said.parameters.view())),
                    changes: visemes
                        .map(|v| changes::Changes::of(v.view(), &self.phones[n], self.seconds(n)))
                        .transpose()?,
                    first: said.parameters.column(0).to_vec(),
                })
            })
            .collect::<Result<_>>()?;
        let mut whole = Whole {
            scores: Resampled::new(said.iter().map(|s| s.score.clone()).collect(), &self.draws),
            gaps: Vec::new(),
            with_means: said
                .iter()
                .map(|s| s.with_mean.clone())
                .collect::<Option<Vec<_>>>()
                .map(|scores| Resampled::new(scores, &self.draws)),
            turns: None,
            changes: None,
            drawn: drawn.iter().map(|&n| said[n].first.clone()).collect(),
        };
        for clip in said {
            whole.gaps.push(clip.gap);
            if let Some(changes) = clip.changes {
                whole.changes.get_or_insert_default().add(changes);
            }
        }
        whole.turns = gaps.map(|(_, truths)| self.turns(truths, &whole.gaps));
        Ok(whole)
    }

    fn closure(&self, gaps: &Gaps, truths: &[TrueGap], candidates: &[Candidate], whole: &[Whole]) -> Closure {
        let mut closure = closure::summary(truths);
        let own: Vec<Vec<f32>> = self
            .truths
            .iter()
            .map(|t| gaps.read_out(t.visual.view()))
            .collect();
        closure.systems.push(closure::judge(
            "the true mouth's weights",
            truths,
            &own,
            &self.draws,
        ));
        for (candidate, whole) in candidates.iter().zip(whole).filter(|(c, _)| c.listed) {
            closure
                .systems
                .push(closure::judge(&candidate.name, truths, &whole.gaps, &self.draws));
        }
        closure
    }

    fn noise(&self, candidates: &[Candidate]) -> Result<Vec<NoiseCondition>> {
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

    fn cold_starts(&self, candidates: &[Candidate]) -> Result<Option<ColdStarts>> {
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

    /// `None` for a candidate that does not iterate.
    fn convergence(&self, candidate: &Candidate, detailed: bool) -> Result<Option<Convergence>> {
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

    fn trajectories(
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
