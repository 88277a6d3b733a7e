//! A new person's mouth for a model that goes on hearing as it does.
//!
//! What hears stays: projection, emissions, transitions, the memory's gains, drives and rates, which have heard many speakers. What the mouth is
//! made of is learnt anew from the new person's video: first the global map W₀ by least squares on the model's own inputs z, then everything that
//! is added up into the mouth, by the error of the mouth through the recursion (M10 without its cross-entropies). No labels are needed.
//! A second memory is left out: it would need clips of its own ([`second`](super::second)).
use std::path::Path;

use nalgebra::DMatrix;
use ndarray::{Array1, Array2, ArrayView2};

use super::data;
use super::settings::MgeTrainSettings;
use super::train::run;
use crate::em::source::in_order;
use crate::error::{Error, Result, bail};
use crate::features::{Clip, FeatureFolder, Split};
use crate::train::{TrainSettings, adapt as by_likelihood};
use lipstream::kinds::likelihood::Model;
use lipstream::kinds::recurrent::model::RecurrentModel;
use lipstream::kinds::recurrent::parameters::{Group, Parameters};
use lipstream::mouth::MouthSpace;
use lipstream::progress::Progress;
use lipstream::tensors::Tensors;

/// What learns: what is added up into the mouth, and what the mouth says of the viseme states.
const MOUTH: &[Group] = &[
    Group::Visual,
    Group::Global,
    Group::GlobalBias,
    Group::AudioOffset,
    Group::VisualOffset,
    Group::Output,
];
/// Batches of a pass, about: a minute of video has few clips, and would have few steps.
const BATCHES: usize = 6;
/// Penalty of the least squares on inputs of about variance one, as a share of the frames.
const PENALTY: f64 = 0.01;

/// The settings with which a model's mouth is learnt anew: the model's own sizes, no cross-entropies, only the mouth learns.
pub fn settings(of: &RecurrentModel, base: &MgeTrainSettings) -> MgeTrainSettings {
    let shape = &of.parameters.shape;
    let mut settings = MgeTrainSettings {
        memory: shape.memory,
        audio_entropy: 0.0,
        visual_entropy: 0.0,
        heard_entropy: 0.0,
        ..base.of_model(shape)
    };
    settings.rule.only = Some(MOUTH);
    settings
}

/// Gives `model` the mouth of `folder`.
///
/// # Errors
///
/// That the folder has another number of eigenmouths than the model speaks, or nothing to learn from; and what reading it says.
pub fn adapt(
    folder: &FeatureFolder,
    model: &RecurrentModel,
    base: &MgeTrainSettings,
    checkpoint: Option<&Path>,
    progress: &dyn Progress,
) -> Result<RecurrentModel> {
    let mut settings = settings(model, base);
    settings.check()?;
    let outputs = model.parameters.shape.outputs;
    if folder.manifest.visual_size != outputs {
        bail!(
            Choice,
            "{} holds {} eigenmouths, the model that is adapted speaks {outputs}: prepare as many",
            folder.root.display(),
            folder.manifest.visual_size
        );
    }
    if model.gated.is_some() {
        progress.say("the model's second memory is left out: it speaks another person's mouth");
    }
    let parent = twin(folder, &model.parent, base, progress)?;
    let clips = folder.split(Split::Train).count();
    settings.batch = settings.batch.min((clips / BATCHES).max(2));
    let aside = checkpoint.and_then(Path::parent);
    let data = data::read_to_adapt(folder, &parent, &model.scale, &settings, aside, progress)?;
    progress.say(&format!(
        "{} clips to learn the mouth from, {} to validate on; labels are not needed",
        data.train.len(),
        data.validation.len()
    ));
    adapt_on(&data, model, &parent, &settings, checkpoint, progress)
}

/// The likelihood-trained model that stands beside the adapted one, with the new mouth. Its densities need phones: where nothing tells them, only
/// its mouth is the new one, and it can align but not speak.
fn twin(
    folder: &FeatureFolder,
    parent: &Model,
    base: &MgeTrainSettings,
    progress: &dyn Progress,
) -> Result<Model> {
    if folder.split(Split::Train).any(Clip::is_labelled) {
        let settings = TrainSettings {
            visual_mixtures: 1,
            // How it is followed is known.
            acoustic_scales: vec![parent.following.acoustic_scale],
            lag: parent.following.lag,
            clips: base.clips,
            seed: base.seed,
            ..TrainSettings::default()
        };
        return by_likelihood::adapt(folder, parent, &settings, progress);
    }
    let space = Tensors::read(&folder.mouth_path()).and_then(|tensors| MouthSpace::load(&tensors));
    Ok(Model {
        mouth: Some(space.map_err(Error::other)?),
        ..parent.clone()
    })
}

/// [`adapt`] on data that has been read, with [`settings`]; `parent` is the model's own, with the new mouth.
///
/// # Errors
///
/// That no clip has a mouth.
pub fn adapt_on(
    data: &data::Data,
    model: &RecurrentModel,
    parent: &Model,
    settings: &MgeTrainSettings,
    checkpoint: Option<&Path>,
    progress: &dyn Progress,
) -> Result<RecurrentModel> {
    let shape = model.parameters.shape.clone();
    let start = || Ok((start(model, data)?, model.context_mean.clone()));
    let mut adapted = run(data, parent, &shape, &start, settings, checkpoint, progress)?;
    adapted.provenance = format!("a mouth of its own, for what hears in: {}", model.provenance);
    Ok(adapted)
}

/// The model's own parameters, with a mouth by least squares from the inputs z alone.
fn start(model: &RecurrentModel, data: &data::Data) -> Result<Parameters> {
    let shape = &model.parameters.shape;
    let (z, c, d) = (shape.inputs, shape.context.size(), shape.outputs);
    let mut parameters = model.parameters.clone();
    let projection = ArrayView2::from_shape((z, c), parameters.of(Group::Projection))?.to_owned();
    let mean = Array1::from(model.context_mean.clone());
    let (mut gram, mut cross, mut n) = (Array2::<f64>::zeros((z, z)), Array2::<f64>::zeros((z, d)), 0.0);
    let read = |index: usize| data.train.get(index);
    in_order(data.train.len(), read, |clip| {
        let Some(mouth) = &clip.mouth else { return Ok(()) };
        let context = shape.context.stack(&clip.x, clip.x.nrows()) - &mean;
        let inputs = context.dot(&projection.t());
        gram += &inputs.t().dot(&inputs).mapv(f64::from);
        cross += &inputs.t().dot(mouth).mapv(f64::from);
        n += inputs.nrows() as f64;
        Ok(())
    })?;
    if n == 0.0 {
        bail!(Data, "no clip with a mouth to learn from");
    }
    let gram = DMatrix::from_fn(z, z, |i, j| gram[[i, j]] + if i == j { PENALTY * n } else { 0.0 });
    let cross = DMatrix::from_fn(z, d, |i, j| cross[[i, j]]);
    let global = gram
        .cholesky()
        .ok_or_else(|| Error::Numbers("the inputs' covariance is singular".into()))?
        .solve(&cross);
    for group in MOUTH {
        parameters.of_mut(*group).fill(0.0);
    }
    parameters.assign(
        Group::Global,
        &Array2::from_shape_fn((d, z), |(j, i)| global[(i, j)] as f32),
    );
    Ok(parameters)
}
