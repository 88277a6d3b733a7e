//! Faces of a hierarchical model, whole, from speech.
use anyhow::{Context as _, Result, bail, ensure};
use lipstream::kinds::hierarchical::voice::Voice;
use lipstream::kinds::hierarchical::{Choice, HierarchicalModel, at_frames, speech};
use lipstream::render::Scene as _;
use lipstream::render::hierarchical::HierarchicalScene;
use lipstream::tensors::Tensors;
use lipstream::time;

use super::face::{film, tracks};
use super::source::{Sound, Source};
use super::{Args, Drawn};
use crate::commands::streams::{ending, read_sound};

/// Draws what a model says of speech.
pub(super) fn draw(args: &Args, tensors: &Tensors, of_speech: bool) -> Result<Drawn> {
    ensure!(
        of_speech,
        "{} holds a hierarchical model, which is moved by speech, not by parameters or a recorded stream",
        args.model_name().display()
    );
    ensure!(
        ending(&args.output) != "html",
        "a page shows eigenmouths: of a hierarchical model write a video"
    );
    if args.face.background.is_some() || args.detail_from.is_some() || args.noise.is_some() {
        bail!("a hierarchical model draws the whole face: leave out --background, --detail-from and --noise");
    }
    let model = HierarchicalModel::from_tensors(tensors)
        .with_context(|| format!("{} is no usable model", args.model_name().display()))?;
    let mut scene = HierarchicalScene::new(&model, args.scale)?;
    let samples = read_sound(&args.input)?;
    let mut heard = model.hear(&samples);
    if let Some(adaptation) = args.adapt {
        heard = Voice::learn(&model.speech, heard.view(), adaptation.into()).apply(&heard);
    }
    let choice = args.choice.map_or(Choice::Mahalanobis, Choice::from);
    let said = model.convert_speech(&heard, &samples, choice)?;
    let count = time::frame_count(samples.len());
    let mut source = Source::Parameters(at_frames(&said, speech::PICTURES_HZ as f32, count));
    let sound = Sound::of_samples(samples)?;
    let tracks = tracks(args, scene.n_parameters(), &mut source, &sound)?;
    film(args, &mut scene, &tracks, &sound)
}
