//! The first stage (X&L section 3.4): joint EM on sound and video, mixtures grown by splitting while the validation
//! clips grow likelier.
use std::time::Instant;

use anyhow::{Context as _, Result, bail};
use ndarray::{Array2, Array3, Axis, concatenate, s};
use rand::SeedableRng;
use rand_pcg::Pcg64;

use super::{Say, Settings};
use crate::hmm::density::{self, Floors};
use crate::hmm::em::{self, Parameters, Utterance};
use crate::hmm::system::{Density, System};
use crate::model::Mixtures;
use crate::phones::Phone;

/// Frames that a component must have before it is split.
const ENOUGH_TO_SPLIT: f64 = 30.0;

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
    let mut parameters = grow(&stacked, &stack(validation)?, phones, system, settings, say)?;
    let aligned = em::align(&parameters, &stacked);
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
    Ok(Coupled { parameters, aligned })
}

/// [oᵃ; oᵛ] as one observation.
fn stack(utterances: &[Utterance]) -> Result<Vec<Utterance>> {
    utterances
        .iter()
        .map(|u| {
            let visual = u
                .visual
                .as_ref()
                .with_context(|| format!("clip {} has no video", u.id))?;
            let audio: Array2<f32> = concatenate(Axis(1), &[u.audio.view(), visual.view()])?;
            Ok(Utterance {
                audio: audio.as_standard_layout().into_owned(),
                visual: None,
                ..u.clone()
            })
        })
        .collect()
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
            settings.iterations,
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

/// `n` passes of EM; returns the sums of the last one.
pub(super) fn passes(
    parameters: &mut Parameters,
    utterances: &[Utterance],
    audio: &Floors,
    visual: Option<&Floors>,
    n: usize,
    say: Say,
) -> Result<em::Sums> {
    let mut last = None;
    for _ in 0..n.max(1) {
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
        em::maximise(parameters, &sums, audio, visual);
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
