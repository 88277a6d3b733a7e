//! From feature folders to a model (DESIGN section 4): joint EM on audio and video, the audio densities retrained on
//! many speakers, recombination, and how the model is followed and what it says, chosen on validation clips.
mod audio;
mod bigram;
pub mod data;
mod em;
pub(crate) mod maps;
pub mod progress;
pub mod shards;
pub mod state;
pub mod sums;

use anyhow::{Context as _, Result, bail};
use ndarray::Array1;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_pcg::Pcg64;

use self::progress::Progress;
use self::state::State;
use crate::features::{FeatureFolder, Split};
use crate::hmm::Hmm;
use crate::hmm::em::Utterance;
use crate::hmm::system::System;
use crate::model::Model;
use crate::mouth::MouthSpace;
use crate::phones::Phone;
use crate::tensors::Tensors;

/// Choices of a training run.
#[derive(Clone, Debug)]
pub struct Settings {
    pub system: System,
    /// Most components per audio state (or joint state), a power of two.
    pub audio_mixtures: usize,
    /// Most components per visual state, a power of two.
    pub visual_mixtures: usize,
    /// EM passes between splits, and after the last one.
    pub iterations: usize,
    /// Taps of the context in hops; the last one is the look-ahead.
    pub taps: Vec<i32>,
    /// Numbers that are left of the stacked statics.
    pub context: usize,
    /// Frames that the occupancies wait, beyond ΔΔ's look-ahead.
    pub lag: usize,
    /// Acoustic scales that the validation clips choose from.
    pub acoustic_scales: Vec<f32>,
    /// Ridge penalties of the residual maps, in frames, that the validation clips choose from.
    pub penalties: Vec<f64>,
    /// So many training clips with video, drawn by the seed; all where `None`.
    pub clips: Option<usize>,
    /// 0: components split along all dimensions alike; else the directions are drawn.
    pub seed: u64,
    /// Where an interrupted run is taken up from; by default nothing is kept.
    pub progress: Progress,
    /// The first stage as shards have done it, in place of joint EM.
    pub state: Option<State>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            system: System::LOCAL_LINEAR,
            audio_mixtures: 4,
            visual_mixtures: 2,
            iterations: 4,
            taps: (-30..=8).step_by(2).collect(),
            context: 48,
            lag: 4,
            acoustic_scales: vec![0.05, 0.1, 0.2, 0.4],
            penalties: vec![100.0, 300.0, 1000.0],
            clips: None,
            seed: 0,
            progress: Progress::default(),
            state: None,
        }
    }
}

/// Where training says what it does.
pub type Say<'a> = &'a dyn Fn(&str);

/// Trains on the audio-visual clips of `folder` and the sound of every folder in `audio_only`.
pub fn train(
    folder: &FeatureFolder,
    audio_only: &[FeatureFolder],
    settings: &Settings,
    say: Say,
) -> Result<Model> {
    if folder.manifest.visual_size == 0 {
        bail!(
            "{} has no video: a mouth cannot be learnt from sound alone",
            folder.root.display()
        );
    }
    for count in [settings.audio_mixtures, settings.visual_mixtures] {
        if !count.is_power_of_two() {
            bail!("mixtures grow by splitting: {count} components are not a power of two");
        }
    }
    let folders: Vec<&FeatureFolder> = std::iter::once(folder).chain(audio_only).collect();
    let phones = data::phones_said(folders.iter().flat_map(|f| f.split(Split::Train)));
    let index = |phone: Phone| phones.iter().position(|p| *p == phone);
    let mut train = load(folder, Split::Train, &index, say)?;
    draw(&mut train, settings);
    let validation = load(folder, Split::Val, &index, say)?;
    if train.is_empty() {
        bail!("{} has no training clip that can be used", folder.root.display());
    }
    let heard: Vec<Vec<Utterance>> = audio_only
        .iter()
        .map(|f| load(f, Split::Train, &index, say))
        .collect::<Result<_>>()?;

    let system = settings.system;
    say(&format!(
        "{}: {}\n{} phones; joint EM on {} clips",
        system.name,
        system.describe(),
        phones.len(),
        train.len()
    ));
    let mut coupled = match &settings.state {
        Some(state) if state.system == system => em::from_state(state, &train, &phones)?,
        Some(state) => bail!("the state is of {}, not of {}", state.system.name, system.name),
        None => em::coupled(&train, &validation, &phones, system, settings, say)?,
    };
    let seen = audio::seen(&train, phones.len());
    coupled.parameters.transition = audio::pool_unseen(&coupled.parameters, &seen);
    audio::look_of_viseme(&mut coupled, &seen);
    say("audio densities on all speakers");
    let audio = audio::retrain(&coupled, &seen, system.density, &train, &heard, settings, say)?;
    let (initial, bigram) = bigram::bigram(phones.len(), &coupled.aligned, &heard);

    let parameters = coupled.parameters;
    let visual = parameters.visual.context("joint EM left no visual densities")?;
    let hmm = Hmm {
        topology: system.topology,
        density: system.density,
        phones: &phones,
        audio: &audio,
        visual: &visual,
        transition: &parameters.transition,
        initial: &initial,
        bigram: &bigram,
    };
    say("how it is followed, and what it says");
    let judges = if validation.is_empty() {
        &train
    } else {
        &validation
    };
    let (following, context, maps) = maps::maps(&hmm, &train, judges, settings, say)?;
    let conversion = maps::conversion(&hmm, judges, settings, say)?;
    let mouth = match folder.mouth_path() {
        path if path.exists() => Some(MouthSpace::load(&Tensors::read(&path)?)?),
        _ => None,
    };
    let provenance = format!(
        "{}: {}; {} clips of {} with video, {} clips with sound only; {} audio and {} visual components",
        system.name,
        system.describe(),
        train.len(),
        corpus_name(folder),
        heard.iter().map(Vec::len).sum::<usize>(),
        audio.mean.dim().1,
        visual.mean.dim().1
    );
    Ok(Model {
        system,
        phones: phones.clone(),
        start_mean: Array1::from(folder.manifest.start_mean.clone()),
        audio,
        visual,
        transition: parameters.transition,
        bigram,
        initial: Array1::from(initial),
        context,
        maps,
        following,
        conversion,
        mouth,
        provenance,
    })
}

/// Keeps as many clips as the settings ask for, in their order.
fn draw(train: &mut Vec<Utterance>, settings: &Settings) {
    let Some(clips) = settings.clips.filter(|n| *n < train.len()) else {
        return;
    };
    let mut order: Vec<usize> = (0..train.len()).collect();
    order.shuffle(&mut Pcg64::seed_from_u64(settings.seed));
    let mut kept = vec![false; train.len()];
    order[..clips].iter().for_each(|&n| kept[n] = true);
    let mut kept = kept.into_iter();
    train.retain(|_| kept.next().unwrap_or(false));
}

pub(crate) fn corpus_name(folder: &FeatureFolder) -> String {
    let path = std::path::Path::new(&folder.manifest.corpus);
    path.file_name().map_or_else(
        || folder.manifest.corpus.clone(),
        |n| n.to_string_lossy().into_owned(),
    )
}

fn load(
    folder: &FeatureFolder,
    split: Split,
    index: &(dyn Fn(Phone) -> Option<usize> + Sync),
    say: Say,
) -> Result<Vec<Utterance>> {
    let (utterances, refused) = data::load(folder, split, index);
    for line in &refused {
        say(&format!("left out: {line}"));
    }
    if !refused.is_empty() {
        say(&format!(
            "{} clips left out, {} used",
            refused.len(),
            utterances.len()
        ));
    }
    Ok(utterances)
}
