//! The measuring: every candidate on every clip, whole, in noise, and from cold starts.
use std::collections::HashSet;

use lipstream_core::{N_STATIC, SAMPLE_RATE_HZ};
use ndarray::Array2;
use rayon::prelude::*;

use super::bootstrap::{Draws, Resampled};
use super::candidate::{Candidate, Heard};
use super::clip_means::{self, ClipMean};
use super::closure::{self, Closure, Gaps, TrueGap};
use super::common_space::{self, Common};
use super::metrics::Score;
use super::readability::{self, Read, Reader};
use super::report::{Against, Curve, EvaluateSettings, Point, Rates, Report, System};
use super::{Truth, changes, spoken, truths};
use crate::error::{Error, Result, bail, chain, ensure};
use crate::features::{FeatureFolder, PhoneLabel, Split};
use lipstream::progress::Progress;
use lipstream::reference::{self, Normalisation};
use lipstream_media::sound;

mod course;
mod disturbed;

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
    /// Words that the lip reader reads, one entry a clip; empty where there is none.
    read: Vec<Read>,
    /// Turns of the gap in a second of speech.
    turns: Option<f64>,
    changes: Option<changes::Changes>,
    common: Option<Common>,
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
    /// Reads lips; none where the clips' words are not known.
    reader: Option<Reader>,
    /// Judges in the space that all systems have in common; none where it was not asked for.
    common: Option<common_space::Judge>,
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
    progress.say("measuring: a lip reader learns from true mouths");
    let reader = super::truths(folder, Split::Train).and_then(|truths| Reader::learn(&truths));
    let reader = reader.map_err(|error| {
        notes.push(format!("Lip-readability was not measured: {}.", chain(&error)));
    });
    let bench = Bench {
        folder,
        truths: &truths,
        heard: &heard,
        phones: &phones,
        means: means.ok(),
        reader: reader.ok(),
        common: settings
            .landmarks
            .as_ref()
            .map(|landmarks| common_space::Judge::of(folder, &truths, landmarks))
            .transpose()?,
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
    let own_lips = bench.own_lips();
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
        systems: systems(candidates, &whole, reference, own_lips.as_deref(), &bench.draws),
        rates: bench.rates(gaps.as_ref().map(|(_, truths)| &truths[..]))?,
        true_readability: own_lips
            .as_ref()
            .map(|own| readability::judge(own, own, &bench.draws).accuracy),
        true_common: bench
            .common
            .as_ref()
            .map(|judge| judge.common(truths.iter().map(|truth| &truth.visual))),
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
    own_lips: Option<&[Read]>,
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
                readability: own_lips.map(|truths| readability::judge(&own.read, truths, draws)),
                viseme_changes_per_second: own.changes.map(|c| c.visemes_per_second()),
                cue_changes_per_second: own.changes.map(|c| c.cues_per_second()),
                gap_turns_per_second: own.turns,
                common: own.common,
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

    /// What the lip reader reads off the true mouths.
    fn own_lips(&self) -> Option<Vec<Read>> {
        let reader = self.reader.as_ref()?;
        let read = |truth: &Truth| reader.read(&truth.clip.words, &truth.visual);
        Some(self.truths.iter().map(read).collect())
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
            read: Option<Read>,
            changes: Option<changes::Changes>,
            parameters: Array2<f32>,
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
                    read: self
                        .reader
                        .as_ref()
                        .map(|reader| reader.read(&truth.clip.words, &said.parameters)),
                    changes: visemes
                        .map(|v| changes::Changes::of(v.view(), &self.phones[n], self.seconds(n)))
                        .transpose()?,
                    parameters: said.parameters,
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
            read: Vec::new(),
            turns: None,
            changes: None,
            common: self
                .common
                .as_ref()
                .map(|judge| judge.common(said.iter().map(|s| &s.parameters))),
            drawn: drawn
                .iter()
                .map(|&n| said[n].parameters.column(0).to_vec())
                .collect(),
        };
        for clip in said {
            whole.gaps.push(clip.gap);
            whole.read.extend(clip.read);
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
}
