//! The first stage (X&L section 3.4): joint EM on sound and video.
use std::time::Instant;

use ndarray::{Array3, s};

use super::TrainSettings;
use super::bigram::{self, Said};
use super::data::{Clips, Observed, stacked};
use super::grow::grow;
use super::state::State;
use crate::em::density::Floors;
use crate::em::source::{Source, in_order};
use crate::em::{self, Aligner, Parameters};
use crate::error::{Error, Result, bail};
use lipstream::hmm::joint::N_EMITTING;
use lipstream::hmm::mixtures::Mixtures;
use lipstream::hmm::system::{Density, System};
use lipstream::hmm::topology::Topology;
use lipstream::phones::Phone;
use lipstream::progress::Progress;

/// What the first stage leaves.
pub(super) struct Coupled {
    /// Transitions, and densities of the sound and of the mouth. Components of a joint density stand side by side in
    /// both.
    pub(super) parameters: Parameters,
    pub(super) aligned: Aligned,
}

/// Floors of the densities that EM re-estimates. What has none is held; with the sound the transitions are held too.
pub(super) struct Learnt {
    pub(super) audio: Option<Floors>,
    pub(super) visual: Option<Floors>,
}

/// What the forced alignment of the training clips is asked for later.
pub(super) struct Aligned {
    /// Whether a path fits, clip by clip.
    pub(super) fits: Vec<bool>,
    /// Frames in each visual state.
    pub(super) visual_frames: Vec<f64>,
    /// What was said.
    pub(super) said: Said,
    /// Where an HMM of the sound alone starts.
    pub(super) sound: em::Start,
}

/// Trains `system`'s HMM on clips with video.
pub(super) fn coupled(
    train: &Clips,
    validation: &Clips,
    phones: &[Phone],
    system: System,
    settings: &TrainSettings,
    progress: &dyn Progress,
) -> Result<Coupled> {
    let observed = observed(system);
    let (train_on, judge_on) = (train.observed(observed), validation.observed(observed));
    let (mut start, audio, visual) = em::start(&train_on, system.topology, phones)?;
    if settings.viterbi_start {
        for _ in 0..settings.iterations.max(1) {
            let sums = em::expect_by_best_path(&start, &train_on)?;
            em::maximise(&mut start, &sums, &audio, visual.as_ref());
            progress.say(&format!("  by the best path: {:.4} a frame", sums.per_frame()));
        }
    }
    let learnt = Learnt {
        audio: Some(audio),
        visual,
    };
    let parameters = grow(start, &learnt, &train_on, &judge_on, settings, progress)?;
    finish(parameters, train, observed)
}

/// The first stage for a model of which a part is held: grown from `start`, streams apart.
pub(super) fn adapted(
    start: Parameters,
    learnt: &Learnt,
    train: &Clips,
    validation: &Clips,
    settings: &TrainSettings,
    progress: &dyn Progress,
) -> Result<Coupled> {
    let observed = Observed::Apart;
    let (train_on, judge_on) = (train.observed(observed), validation.observed(observed));
    let parameters = grow(start, learnt, &train_on, &judge_on, settings, progress)?;
    finish(parameters, train, observed)
}

/// What `system`'s densities see.
pub(super) fn observed(system: System) -> Observed {
    match system.density {
        Density::Streams => Observed::Apart,
        Density::Joint => Observed::Stacked,
    }
}

/// The first stage as `lipstream train accumulate` and `merge` have done it.
pub(super) fn from_state(state: &State, train: &Clips, phones: &[Phone]) -> Result<Coupled> {
    let parameters = state.parameters.clone();
    if parameters.phones != phones {
        bail!(
            Choice,
            "the state is over {} phones, the clips say {}: start it with the same folders",
            parameters.phones.len(),
            phones.len()
        );
    }
    let observed = observed(state.system);
    let have = (
        parameters.audio.mean.dim().2,
        parameters.visual.as_ref().map(|v| v.mean.dim().2),
    );
    let clips = train.observed(observed);
    let first = clips.get(0)?;
    if have != (first.audio.ncols(), first.visual.as_ref().map(|v| v.ncols())) {
        bail!(
            Choice,
            "the state is of other features: start it with the same folders"
        );
    }
    finish(parameters, train, observed)
}

/// Aligns the clips, and parts joint densities into those of the sound and those of the mouth.
fn finish(mut parameters: Parameters, train: &Clips, observed: Observed) -> Result<Coupled> {
    let audio_size = train.get(0)?.audio.ncols();
    let aligned = align(&parameters, train, observed, audio_size)?;
    if observed == Observed::Stacked {
        part(&mut parameters, audio_size);
    }
    Ok(Coupled { parameters, aligned })
}

fn align(parameters: &Parameters, train: &Clips, observed: Observed, audio_size: usize) -> Result<Aligned> {
    let n_visual = parameters.topology.n_visual_states(parameters.phones.len());
    let mut aligned = Aligned {
        fits: Vec::new(),
        visual_frames: vec![0.0; n_visual],
        said: Said::none(parameters.phones.len()),
        sound: em::Start::new(Topology::PH_HMM, &parameters.phones, (audio_size, 0)),
    };
    let aligner = Aligner::new(parameters);
    let work = |n: usize| {
        let mut utterance = train.get(n)?.into_owned();
        let path = match observed {
            Observed::Stacked => aligner.path(&stacked(utterance.clone())?),
            Observed::Apart | Observed::Sound => aligner.path(&utterance),
        };
        utterance.visual = None;
        Ok((utterance, path))
    };
    in_order(train.len(), work, |(heard, path)| {
        aligned.fits.push(path.is_some());
        let Some(path) = path else { return Ok(()) };
        path.iter().for_each(|&(_, v)| aligned.visual_frames[v] += 1.0);
        aligned.said.add(&bigram::said_on(&path));
        aligned.sound.add(&heard, &labels(&path));
        Ok(())
    })?;
    Ok(aligned)
}

/// Phone and state of every frame of a path.
pub(super) fn labels(path: &em::Path) -> Vec<(usize, usize)> {
    path.iter()
        .map(|&(a, _)| (a / N_EMITTING, a % N_EMITTING))
        .collect()
}

/// Parts joint densities into those of the sound, the first `audio_size` numbers, and those of the mouth.
fn part(parameters: &mut Parameters, audio_size: usize) {
    let both = &parameters.audio;
    let end = both.mean.dim().2;
    let part = |from, to| {
        let part = |of: &Array3<f32>| of.slice(s![.., .., from..to]).to_owned();
        Mixtures {
            mean: part(&both.mean),
            variance: part(&both.variance),
            log_weight: both.log_weight.clone(),
        }
    };
    let (audio, visual) = (part(0, audio_size), part(audio_size, end));
    parameters.audio = audio;
    parameters.visual = Some(visual);
}

/// A stage of EM passes; returns the sums of the last one. What an interrupted run has kept is taken up.
pub(super) fn passes(
    parameters: &mut Parameters,
    clips: &Clips,
    learnt: &Learnt,
    settings: &TrainSettings,
    progress: &dyn Progress,
) -> Result<em::Sums> {
    let n = settings.iterations.max(1);
    let stage = settings.resume.stage();
    let (mut done, mut last) = (0, None);
    if let Some((pass, kept, sums)) = stage.load(n, parameters) {
        progress.say(&format!("  {pass} of {n} passes were made before"));
        *parameters = kept;
        (done, last) = (pass, Some(sums));
    }
    for pass in done + 1..=n {
        let begun = Instant::now();
        let sums = em::expect(parameters, clips)?;
        if sums.frames == 0 {
            bail!(Data, "no utterance fits its transcript: check the labels");
        }
        if !sums.failed.is_empty() {
            progress.say(&format!(
                "no path through {} utterances: {}",
                sums.failed.len(),
                sums.failed.join(" ")
            ));
        }
        match &learnt.audio {
            Some(audio) => {
                if pass == 1 {
                    em::warnings(parameters, &sums, audio)
                        .iter()
                        .for_each(|line| progress.say(line));
                }
                em::maximise(parameters, &sums, audio, learnt.visual.as_ref());
            }
            None => em::maximise_visual(parameters, &sums, learnt.visual.as_ref()),
        }
        stage.save(pass, parameters, &sums)?;
        progress.say(&format!(
            "  K = {}: log likelihood {:.4} a frame ({:.1} s)",
            match (&learnt.audio, &parameters.visual) {
                (None, Some(visual)) => visual.mean.dim().1,
                _ => parameters.audio.mean.dim().1,
            },
            sums.per_frame(),
            begun.elapsed().as_secs_f32()
        ));
        last = Some(sums);
    }
    last.ok_or_else(|| Error::Choice("at least one pass was made".into()))
}
