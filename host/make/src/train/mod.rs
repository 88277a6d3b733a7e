//! From feature folders to a model (`docs/design.md` section 4): joint EM on audio and video, the audio densities retrained on
//! many speakers, recombination, and how the model is followed and what it says, chosen on validation clips.
pub mod adapt;
mod audio;
pub(crate) mod bigram;
pub mod data;
mod em;
mod grow;
pub mod local_linear;
pub(crate) mod maps;
pub mod resume;
pub mod shards;
pub mod state;
pub mod sums;

use ndarray::{Array1, Array2, Array3};

use self::data::{Clips, Observed};
use self::resume::Resume;
use self::state::State;
use crate::em::source::Source;
use crate::error::{Error, Result, bail};
use crate::features::{FeatureFolder, Split};
use lipstream::hmm::Hmm;
use lipstream::hmm::mixtures::Mixtures;
use lipstream::hmm::system::System;
use lipstream::kinds::likelihood::Model;
use lipstream::mouth::MouthSpace;
use lipstream::phones::Phone;
use lipstream::progress::Progress;
use lipstream::tensors::Tensors;

/// Choices of a training run.
#[derive(Clone, Debug)]
pub struct TrainSettings {
    /// Kind of model to train.
    pub system: System,
    /// Most components per audio state (or joint state), a power of two; validation clips may ask for fewer.
    pub audio_mixtures: usize,
    /// Most components per visual state, a power of two; validation clips may ask for fewer.
    pub visual_mixtures: usize,
    /// EM passes between splits, and after the last one.
    pub iterations: usize,
    /// Before them as many passes that count the best path alone (X&L appendix A).
    pub viterbi_start: bool,
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
    pub resume: Resume,
    /// The first stage as shards have done it, in place of joint EM.
    pub state: Option<State>,
}

impl Default for TrainSettings {
    fn default() -> Self {
        Self {
            system: System::LOCAL_LINEAR,
            audio_mixtures: 4,
            visual_mixtures: 2,
            iterations: 4,
            viterbi_start: false,
            taps: (-30..=8).step_by(2).collect(),
            context: 48,
            lag: 4,
            acoustic_scales: vec![0.05, 0.1, 0.2, 0.4],
            penalties: vec![100.0, 300.0, 1000.0],
            clips: None,
            seed: 0,
            resume: Resume::default(),
            state: None,
        }
    }
}

impl TrainSettings {
    /// How `system` is trained where nobody asks otherwise. What the device runs has as many components as it has time for;
    /// the mixtures of the others grow until the validation clips say stop.
    pub fn of(system: System) -> Self {
        const MANY: usize = 64;
        let own = Self::default();
        let (audio_mixtures, visual_mixtures) = match system.is_live() {
            true => (own.audio_mixtures, own.visual_mixtures),
            false => (MANY, MANY),
        };
        Self {
            system,
            audio_mixtures,
            visual_mixtures,
            ..own
        }
    }
}

/// Trains on the audio-visual clips of `folder` and the sound of every folder in `audio_only`.
pub fn train(
    folder: &FeatureFolder,
    audio_only: &[FeatureFolder],
    settings: &TrainSettings,
    progress: &dyn Progress,
) -> Result<Model> {
    let folders: Vec<&FeatureFolder> = std::iter::once(folder).chain(audio_only).collect();
    let phones = data::phones_said(folders.iter().flat_map(|f| f.split(Split::Train)));
    let (train, validation) = with_video(folder, &phones, settings, progress)?;
    let mut heard = Clips::none(&phones).observed(Observed::Sound);
    for folder in audio_only {
        let clips = Clips::new(folder, Split::Train, &phones, progress).observed(Observed::Sound);
        heard.extend(&clips.readable(false, progress));
    }

    let system = settings.system;
    progress.say(&format!(
        "{}: {}\n{} phones; joint EM on {} clips",
        system.name,
        system.describe(),
        phones.len(),
        train.len()
    ));
    let mut coupled = match &settings.state {
        Some(state) if state.system == system => em::from_state(state, &train, &phones)?,
        Some(state) => bail!(
            Choice,
            "the state is of {}, not of {}",
            state.system.name,
            system.name
        ),
        None => em::coupled(&train, &validation, &phones, system, settings, progress)?,
    };
    let seen = audio::seen(&train, phones.len());
    coupled.parameters.transition = audio::pool_unseen(&coupled.parameters, &seen);
    audio::look_of_viseme(&mut coupled, &seen);
    progress.say("audio densities on all speakers");
    let em::Coupled { parameters, aligned } = coupled;
    let (initial, bigram) = bigram::bigram(phones.len(), &aligned.said, &heard);
    let audio = match heard.is_empty() {
        true => parameters.audio,
        false => {
            let speakers = audio::all_speakers(aligned, &train, &heard)?;
            audio::retrain(&parameters, &seen, speakers, settings, progress)?
        }
    };
    let provenance = format!(
        "{}: {}; {} clips of {} with video, {} clips with sound only; {} audio and {} visual components",
        system.name,
        system.describe(),
        train.len(),
        corpus_name(folder),
        heard.len(),
        audio.mean.dim().1,
        parameters.visual.as_ref().map_or(0, |visual| visual.mean.dim().1)
    );
    let coupled = Trained {
        system,
        phones: phones.clone(),
        start_mean: Array1::from(folder.manifest.start_mean.clone()),
        audio,
        visual: parameters.visual,
        transition: parameters.transition,
        initial: Array1::from(initial),
        bigram,
        provenance,
    };
    coupled.completed(folder, (&train, &validation), settings, progress)
}

/// Training clips with video and those that judge, of what `phones` can say.
fn with_video<'a>(
    folder: &'a FeatureFolder,
    phones: &'a [Phone],
    settings: &TrainSettings,
    progress: &dyn Progress,
) -> Result<(Clips<'a>, Clips<'a>)> {
    if folder.manifest.visual_size == 0 {
        bail!(
            Data,
            "{} has no video: a mouth cannot be learnt from sound alone",
            folder.root.display()
        );
    }
    for count in [settings.audio_mixtures, settings.visual_mixtures] {
        if !count.is_power_of_two() {
            bail!(
                Choice,
                "mixtures grow by splitting: {count} components are not a power of two"
            );
        }
    }
    let with_video = |split| Clips::new(folder, split, phones, progress).readable(true, progress);
    let mut train = with_video(Split::Train);
    if let Some(clips) = settings.clips {
        train.draw(clips, settings.seed);
    }
    if train.is_empty() {
        bail!(
            Data,
            "{} has no training clip that can be used",
            folder.root.display()
        );
    }
    Ok((train, with_video(Split::Val)))
}

/// A coupled HMM of which only the last stage is missing: how it is followed, and what it says.
struct Trained {
    system: System,
    phones: Vec<Phone>,
    start_mean: Array1<f32>,
    audio: Mixtures,
    visual: Option<Mixtures>,
    transition: Array3<f32>,
    initial: Array1<f32>,
    bigram: Array2<f32>,
    provenance: String,
}

impl Trained {
    /// Learns the last stage, and takes the mouth of `folder`. The second clips judge, the first ones where there are none.
    fn completed(
        self,
        folder: &FeatureFolder,
        (train, validation): (&Clips, &Clips),
        settings: &TrainSettings,
        progress: &dyn Progress,
    ) -> Result<Model> {
        let visual = self
            .visual
            .ok_or_else(|| Error::Numbers("joint EM left no visual densities".into()))?;
        let hmm = Hmm {
            topology: self.system.topology,
            density: self.system.density,
            phones: &self.phones,
            audio: &self.audio,
            visual: &visual,
            transition: &self.transition,
            initial: self
                .initial
                .as_slice()
                .ok_or_else(|| Error::Numbers("first phones are not in order".into()))?,
            bigram: &self.bigram,
        };
        progress.say("how it is followed, and what it says");
        let judges = match validation.is_empty() {
            true => train,
            false => validation,
        };
        let (following, context, maps) = match self.system.speaks_by_maps() {
            true => maps::maps(&hmm, train, judges, settings, progress)?,
            // Nothing speaks by these maps: nothing is to be chosen for them.
            false => {
                let one = TrainSettings {
                    acoustic_scales: settings.acoustic_scales.iter().take(1).copied().collect(),
                    penalties: settings.penalties.iter().take(1).copied().collect(),
                    ..settings.clone()
                };
                maps::maps(&hmm, train, judges, &one, progress)?
            }
        };
        let conversion = maps::conversion(&hmm, judges, settings, progress)?;
        let posterior_scale = maps::posterior(&hmm, judges, settings, progress)?;
        let mouth = match folder.mouth_path() {
            path if path.exists() => {
                Some(MouthSpace::load(&Tensors::read(&path).map_err(Error::other)?).map_err(Error::other)?)
            }
            _ => None,
        };
        Ok(Model {
            system: self.system,
            phones: self.phones,
            start_mean: self.start_mean,
            audio: self.audio,
            visual,
            transition: self.transition,
            bigram: self.bigram,
            initial: self.initial,
            context,
            maps,
            following,
            conversion,
            posterior_scale,
            mouth,
            provenance: self.provenance,
        })
    }
}

pub(crate) fn corpus_name(folder: &FeatureFolder) -> String {
    let path = std::path::Path::new(&folder.manifest.corpus);
    path.file_name().map_or_else(
        || folder.manifest.corpus.clone(),
        |n| n.to_string_lossy().into_owned(),
    )
}
