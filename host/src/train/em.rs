//! The first stage (X&L section 3.4): joint EM on sound and video, mixtures grown by splitting while the validation
//! clips grow likelier.
use std::time::Instant;

use anyhow::{Context as _, Result, bail};
use ndarray::{Array2, Array3, Axis, concatenate, s};
use rand::SeedableRng;
use rand_pcg::Pcg64;

use super::state::State;
use super::{Say, Settings};
use crate::hmm::density::{self, Floors};
use crate::hmm::em::{self, Parameters, Utterance};
use crate::hmm::system::{Density, System};
use crate::model::Mixtures;
use crate::phones::Phone;

/// Frames that a component must have before it is split.
pub(super) const ENOUGH_TO_SPLIT: f64 = 30.0;

/// What the first stage leaves.
pub(super) struct Coupled {
    /// Transitions, and densities of the sound and of the mouth. Components of a joint density stand side by side in
    /// both.
    pub(super) parameters: Parameters,
    /// Audio and visual state of every frame of every training utterance, where a path fits.
    pub(super) aligned: Vec<Option<Vec<(usize, usize)>>>,
}

/// Trains `system`'s HMM on utterances with video.
pub(super) fn coupled(
    train: &[Utterance],
    validation: &[Utterance],
    phones: &[Phone],
    system: System,
    settings: &Settings,
    say: Say,
) -> Result<Coupled> {
    if system.density == Density::Streams {
        let parameters = grow(train, validation, phones, system, settings, say)?;
        let aligned = em::align(&parameters, train);
        return Ok(Coupled { parameters, aligned });
    }
    let stacked = stack(train)?;
    let parameters = grow(&stacked, &stack(validation)?, phones, system, settings, say)?;
    Ok(part(parameters, train, &stacked))
}

/// The first stage as `lipstream train accumulate` and `merge` have done it.
pub(super) fn from_state(state: &State, train: &[Utterance], phones: &[Phone]) -> Result<Coupled> {
    let parameters = state.parameters.clone();
    if parameters.phones != phones {
        bail!(
            "the state is over {} phones, the clips say {}: start it with the same folders",
            parameters.phones.len(),
            phones.len()
        );
    }
    let sizes = |u: &Utterance| (u.audio.ncols(), u.visual.as_ref().map(|v| v.ncols()));
    let joint = state.system.density == Density::Joint;
    let have = (
        parameters.audio.mean.dim().2,
        parameters.visual.as_ref().map(|v| v.mean.dim().2),
    );
    if let Some((audio, visual)) = train.first().map(sizes) {
        let want = match joint {
            true => (audio + visual.unwrap_or(0), None),
            false => (audio, visual),
        };
        if have != want {
            bail!("the state is of other features: start it with the same folders");
        }
    }
    if joint {
        return Ok(part(parameters, train, &stack(train)?));
    }
    let aligned = em::align(&parameters, train);
    Ok(Coupled { parameters, aligned })
}

/// Aligns, and parts joint densities into those of the sound and those of the mouth.
fn part(mut parameters: Parameters, train: &[Utterance], stacked: &[Utterance]) -> Coupled {
    let aligned = em::align(&parameters, stacked);
    let audio_size = train.first().map_or(0, |u| u.audio.ncols());
    let both = parameters.audio;
    let part = |of: &Array3<f32>, from, to| of.slice(s![.., .., from..to]).to_owned();
    let end = both.mean.dim().2;
    parameters.audio = Mixtures {
        mean: part(&both.mean, 0, audio_size),
        variance: part(&both.variance, 0, audio_size),
        log_weight: both.log_weight.clone(),
    };
    parameters.visual = Some(Mixtures {
        mean: part(&both.mean, audio_size, end),
        variance: part(&both.variance, audio_size, end),
        log_weight: both.log_weight,
    });
    Coupled { parameters, aligned }
}

/// [oᵃ; oᵛ] as one observation.
fn stack(utterances: &[Utterance]) -> Result<Vec<Utterance>> {
    utterances.iter().map(stacked).collect()
}

pub(super) fn stacked(u: &Utterance) -> Result<Utterance> {
    let visual = u
        .visual
        .as_ref()
        .with_context(|| format!("clip {} has no video", u.id))?;
    let audio: Array2<f32> = concatenate(Axis(1), &[u.audio.view(), visual.view()])?;
    Ok(Utterance {
        id: u.id.clone(),
        audio: audio.as_standard_layout().into_owned(),
        visual: None,
        network: u.network.clone(),
        start: u.start.clone(),
    })
}

/// Grows mixtures by splitting, with EM passes in between; prints the log likelihood of each. The numbers of components
/// are those under which the validation clips are likeliest, at most what the settings allow.
fn grow(
    train: &[Utterance],
    validation: &[Utterance],
    phones: &[Phone],
    system: System,
    settings: &Settings,
    say: Say,
) -> Result<Parameters> {
    let (mut parameters, audio_floors, visual_floors) = em::start(train, system.topology, phones);
    let mut signs = (settings.seed != 0).then(|| Pcg64::seed_from_u64(settings.seed));
    let mut best: Option<(f64, Parameters)> = None;
    loop {
        let sums = passes(
            &mut parameters,
            train,
            &audio_floors,
            visual_floors.as_ref(),
            settings,
            say,
        )?;
        if !validation.is_empty() {
            let unseen = em::expect(&parameters, validation, &|_| ()).per_frame();
            say(&format!("  validation clips: {unseen:.4} a frame"));
            match &best {
                Some((likeliest, before)) if unseen <= *likeliest => return Ok(before.clone()),
                _ => best = Some((unseen, parameters.clone())),
            }
        }
        let audio_more = parameters.audio.mean.dim().1 < settings.audio_mixtures;
        if audio_more {
            parameters.audio =
                density::split(&parameters.audio, &sums.audio, ENOUGH_TO_SPLIT, signs.as_mut());
        }
        let mut visual_more = false;
        if let (Some(visual), Some(sums)) = (&parameters.visual, &sums.visual)
            && visual.mean.dim().1 < settings.visual_mixtures
        {
            visual_more = true;
            parameters.visual = Some(density::split(visual, sums, ENOUGH_TO_SPLIT, signs.as_mut()));
        }
        if !audio_more && !visual_more {
            return Ok(parameters);
        }
    }
}

/// Splits the audio components of an audio HMM once more.
pub(super) fn split_audio(parameters: &mut Parameters, sums: &em::Sums) {
    parameters.audio = density::split(&parameters.audio, &sums.audio, ENOUGH_TO_SPLIT, None);
}

/// A stage of EM passes; returns the sums of the last one. What an interrupted run has kept is taken up.
pub(super) fn passes(
    parameters: &mut Parameters,
    utterances: &[Utterance],
    audio: &Floors,
    visual: Option<&Floors>,
    settings: &Settings,
    say: Say,
) -> Result<em::Sums> {
    let n = settings.iterations.max(1);
    let stage = settings.progress.stage();
    let (mut done, mut last) = (0, None);
    if let Some((pass, kept, sums)) = stage.load(n, parameters) {
        say(&format!("  {pass} of {n} passes were made before"));
        *parameters = kept;
        (done, last) = (pass, Some(sums));
    }
    for pass in done + 1..=n {
        let begun = Instant::now();
        let sums = em::expect(parameters, utterances, &|_| ());
        if sums.frames == 0 {
            bail!("no utterance fits its transcript: check the labels");
        }
        if !sums.failed.is_empty() {
            say(&format!(
                "no path through {} utterances: {}",
                sums.failed.len(),
                sums.failed.join(" ")
            ));
        }
        if pass == 1 {
            em::warnings(parameters, &sums, audio)
                .iter()
                .for_each(|line| say(line));
        }
        em::maximise(parameters, &sums, audio, visual);
        stage.save(pass, parameters, &sums)?;
        say(&format!(
            "  K = {}: log likelihood {:.4} a frame ({:.1} s)",
            parameters.audio.mean.dim().1,
            sums.per_frame(),
            begun.elapsed().as_secs_f32()
        ));
        last = Some(sums);
    }
    last.context("at least one pass was made")
}
