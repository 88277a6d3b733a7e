//! A new person's mouth for a likelihood-trained model that goes on hearing as it does.
//!
//! Audio densities, transitions and bigram stay as many speakers have taught them. The mouth's densities begin where the sound alone aligns the clips, and
//! are then re-estimated under both chains (X&L appendix A with the audio half held); the local linear maps and how the model is followed are learnt
//! anew, as in [`train`](super::train). Clips need their phones, which may be recognised ones: it is they that say which state a picture belongs to.
use super::data::{Clips, Observed};
use super::em::{self, Learnt};
use super::{TrainSettings, Trained, audio, corpus_name, with_video};
use crate::em::density::Floors;
use crate::em::source::{Source, in_order};
use crate::em::{Aligner, Parameters, Start};
use crate::error::{Error, Result, bail};
use crate::features::FeatureFolder;
use lipstream::hmm::system::Density;
use lipstream::kinds::likelihood::Model;
use lipstream::progress::Progress;

/// Gives `model` the mouth of `folder`, which may have another number of eigenmouths.
///
/// # Errors
///
/// That the model's densities are of sound and mouth together, that the folder has no video or no clip that can be used; and what reading it says.
pub fn adapt(
    folder: &FeatureFolder,
    model: &Model,
    settings: &TrainSettings,
    progress: &dyn Progress,
) -> Result<Model> {
    let system = model.system;
    if system.density == Density::Joint {
        bail!(
            Choice,
            "a component of {} is of sound and mouth together: its mouth cannot be learnt without the sound; adapt one of the coupled systems",
            system.name
        );
    }
    let phones = &model.phones;
    let (train, validation) = with_video(folder, phones, settings, progress)?;
    progress.say(&format!(
        "{}: the mouth of {} clips for what hears in: {}",
        system.name,
        train.len(),
        model.provenance
    ));
    let hearing = Parameters {
        topology: system.topology,
        phones: phones.clone(),
        audio: model.audio.clone(),
        visual: None,
        transition: model.transition.clone(),
    };
    let (first, floors) = first_look(&hearing, &train, progress)?;
    let start = Parameters {
        visual: first.visual,
        ..hearing
    };
    let learnt = Learnt {
        audio: None,
        visual: Some(floors),
    };
    let mut coupled = em::adapted(start, &learnt, &train, &validation, settings, progress)?;
    audio::look_of_viseme(&mut coupled, &audio::seen(&train, phones.len()));
    let provenance = format!(
        "{}, by likelihood: a mouth of its own from {} clips of {} with video, for what hears in: {}",
        system.name,
        train.len(),
        corpus_name(folder),
        model.provenance
    );
    let parameters = coupled.parameters;
    let trained = Trained {
        system,
        phones: phones.clone(),
        start_mean: model.start_mean.clone(),
        audio: parameters.audio,
        visual: parameters.visual,
        transition: parameters.transition,
        initial: model.initial.clone(),
        bigram: model.bigram.clone(),
        provenance,
    };
    trained.completed(folder, (&train, &validation), settings, progress)
}

/// Single Gaussians of the mouth, each state's over the frames that the sound alone aligns with it.
fn first_look(hearing: &Parameters, train: &Clips, progress: &dyn Progress) -> Result<(Parameters, Floors)> {
    let clips = train.observed(Observed::Apart);
    let first = clips.get(0)?;
    let sizes = (
        first.audio.ncols(),
        first.visual.as_ref().map_or(0, |v| v.ncols()),
    );
    if sizes.0 != hearing.audio.mean.dim().2 {
        bail!(
            Choice,
            "the model hears {} numbers a frame, the features have {}: prepare them with this program",
            hearing.audio.mean.dim().2,
            sizes.0
        );
    }
    let mut sums = Start::new(hearing.topology, &hearing.phones, sizes);
    let aligner = Aligner::new(hearing);
    let mut lost = Vec::new();
    let work = |n: usize| {
        let utterance = clips.get(n)?.into_owned();
        let path = aligner.path(&utterance);
        Ok((utterance, path))
    };
    in_order(clips.len(), work, |(utterance, path)| {
        match path {
            Some(path) => sums.add(&utterance, &em::labels(&path)),
            None => lost.push(utterance.id),
        }
        Ok(())
    })?;
    if !lost.is_empty() {
        progress.warn(&format!("no path through {}", lost.join(" ")));
    }
    if lost.len() == clips.len() {
        bail!(Data, "no clip fits its phones: check the labels");
    }
    let (parameters, _, floors) = sums.finish();
    let floors = floors.ok_or_else(|| Error::Data("the clips have no video".into()))?;
    Ok((parameters, floors))
}
