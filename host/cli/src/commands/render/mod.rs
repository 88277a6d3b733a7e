//! `lipstream render`: a video of the mouth, or of a face with it, with sound.
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};

use super::answer::{Answer, Done};
use super::choices;
use super::faces::{FaceArgs, mouth};
use super::streams::{ending, file_name, keep_apart, name, read_sound};
use crate::progress::Terminal;
use lipstream::cues;
use lipstream::engine::{Converted, Engine, RunSettings};
use lipstream::kinds::hierarchical::HierarchicalModel;
use lipstream::mouth::MouthSpace;
use lipstream::opening::OpeningReader;
use lipstream::render::{self, Painter, Scene as _, Settings, page};
use lipstream::tensors::Tensors;
use lipstream::{parameters, shipped, time};
use lipstream_make::details;
use lipstream_make::features::FeatureFolder;
use lipstream_media::files;
use serde_json::json;

mod face;
mod going_on;
mod hierarchical;
mod source;

use going_on::{begun, sink};
use source::{Sound, Source};

/// Draw the mouth that speech or parameters describe
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Speech (WAV, FLAC, MP3, Ogg, M4A and others), parameters that `lipstream convert` wrote (.npy, 100 frames a second), or a recorded stream (.stream);
    /// - is speech on standard input
    input: PathBuf,
    /// Model (.safetensors), of which a hierarchical one draws the whole face; for parameters, the mouth.safetensors of a feature folder does as well [default: the shipped one]
    #[arg(short, long)]
    model: Option<PathBuf>,
    /// Where to: .mp4, .html (a page that plays it), FOLDER/ (numbered PNG files), - (raw rgb24 pictures on standard output); every
    /// other video format needs ffmpeg
    #[arg(short, long)]
    output: PathBuf,
    /// Sound of the video, when the input is parameters
    #[arg(long)]
    audio: Option<PathBuf>,
    /// Arithmetic, when the input is speech
    #[arg(long, value_enum, default_value_t = choices::Engine::Fixed)]
    engine: choices::Engine,
    /// Pictures a second
    #[arg(long, default_value_t = 25)]
    fps: u32,
    /// Times the size of the eigenmouths [default: about 384 pixels wide]
    #[arg(long)]
    scale: Option<usize>,
    /// Camera noise, standard deviation in levels of 0..255 (real cameras: 1 to 3) [default: none; on a recording what the drawn mouth lacks against it]
    #[arg(long)]
    noise: Option<f32>,
    /// With a hierarchical model: bring another voice's speech parameters to the training voice's distribution, as learnt from the whole sound
    #[arg(long, value_enum)]
    adapt: Option<choices::Adaptation>,
    /// With a hierarchical model: what chooses the cluster of each picture [default: mahalanobis]
    #[arg(long, value_enum)]
    choice: Option<choices::ClusterChoice>,
    #[command(flatten)]
    face: FaceArgs,
    /// Put the fine detail that eigenmouths leave out onto the mouth alone, from the mouths of this feature folder, on which the model was trained
    #[arg(long, value_name = "FEATURES", conflicts_with = "background")]
    detail_from: Option<PathBuf>,
    #[command(flatten)]
    answer: Answer,
}

impl Args {
    /// What messages call the model.
    fn model_name(&self) -> &Path {
        self.model.as_deref().unwrap_or(Path::new(shipped::NAME))
    }
}

pub(crate) fn run(args: Args) -> Result<()> {
    let settings = Settings {
        fps: args.fps,
        scale: args.scale,
        noise: args.noise.unwrap_or(0.0),
    };
    let read = [&args.model, &args.audio, &args.face.background];
    let read = read.into_iter().flatten().chain([&args.input]);
    keep_apart(&args.output, read.map(PathBuf::as_path))?;
    let tensors = Tensors::read_or_shipped(args.model.as_deref())?;
    let of_speech = !["stream", "npy"].contains(&ending(&args.input).as_str());
    if args.audio.is_some() && of_speech {
        bail!("--audio goes with parameters (.npy); speech is its own sound");
    }
    if HierarchicalModel::is_kind(&tensors) {
        let drawn = hierarchical::draw(&args, &tensors, of_speech)?;
        tell(&args, &drawn);
        return Ok(());
    }
    let of_hierarchical = [
        (args.adapt.is_some(), "--adapt"),
        (args.choice.is_some(), "--choice"),
    ];
    if let Some((_, word)) = of_hierarchical.iter().find(|(given, _)| *given) {
        bail!(
            "{word} is of hierarchical models; {} holds another",
            args.model_name().display()
        );
    }
    let space = mouth(&tensors, args.model_name())?;
    settings.size(&space)?;
    let drawn = match (ending(&args.output).as_str(), &args.face.background) {
        ("html", _) if !of_speech => {
            bail!("a page shows what the model hears: give speech, not parameters or a recorded stream")
        }
        ("html", Some(_)) => bail!("a page shows the mouth alone: leave --background out, or write a video"),
        ("html", None) => page(&args, &space, &settings)?,
        (_, background) => {
            if background.is_some() && args.scale.is_some() {
                bail!("--scale is of the mouth alone: a face has the size of its background");
            }
            let (source, sound) = source::open(&args, &tensors)?;
            match background {
                Some(video) => face::draw(&args, video, &space, source, &sound)?,
                None => alone(&args, &space, &settings, source, &sound)?,
            }
        }
    };
    tell(&args, &drawn);
    Ok(())
}

/// Tells what was made.
fn tell(args: &Args, drawn: &Drawn) {
    let Drawn {
        pictures,
        size: (width, height),
        sound,
    } = *drawn;
    let seconds = pictures as f64 / f64::from(args.fps);
    let silent = match sound {
        true => "",
        false => ", without sound (--audio WAV adds it)",
    };
    let done = Done::new(
        format!("{pictures} pictures of {width}×{height}, {seconds:.2} s{silent}"),
        json!({ "pictures": pictures, "width": width, "height": height, "seconds": seconds, "sound": sound }),
    );
    args.answer.tell(&args.output, &done);
}

/// What was made.
struct Drawn {
    pictures: usize,
    /// Width and height.
    size: (usize, usize),
    /// Whether there is a sound to it.
    sound: bool,
}

/// A film of the mouth alone.
fn alone(
    args: &Args,
    space: &MouthSpace,
    settings: &Settings,
    mut source: Source,
    sound: &Sound,
) -> Result<Drawn> {
    let mut scene = Painter::new(space, settings)?;
    if let (Some(folder), Some(choice)) = (&args.detail_from, args.face.detail()) {
        let tracks = face::tracks(args, space.size(), &mut source, sound)?;
        let candidates = details::candidates(&FeatureFolder::open(folder)?, space, &Terminal::default())?;
        let mut scene = scene.with_details(candidates, tracks.view(), choice)?;
        return face::film(args, &mut scene, &tracks, sound);
    }
    let size = scene.size();
    let mut sink = sink(args, &render::film(&scene, settings, sound.track()))?;
    let begun = begun(args, sink.as_ref(), &Terminal::default());
    let pictures = source.play(args, sound, (&mut scene, begun), |rgb| Ok(sink.picture(rgb)?))?;
    sink.finish()?;
    Ok(Drawn {
        pictures,
        size,
        sound: sound.track().is_some(),
    })
}

/// A page, which carries its film: it is made in memory.
fn page(args: &Args, space: &MouthSpace, settings: &Settings) -> Result<Drawn> {
    let sound = read_sound(&args.input)?;
    let engine = Engine::open_or_shipped(args.model.as_deref(), args.engine.into(), false)?;
    let converted = engine.convert(&sound, &RunSettings::default())?;
    let gaps = OpeningReader::of(space).map(|reader| converted.gaps(&reader));
    let Converted { parameters, visemes } = converted;
    parameters::check(parameters.view()).with_context(|| format!("{} gives no mouth", name(&args.input)))?;
    let rendered = render::to_mp4(
        space,
        parameters.view(),
        Some(&sound),
        settings,
        &Terminal::default(),
    )?;
    let text = page::write(&page::Page {
        title: &file_name(&args.input),
        mp4: &rendered.mp4,
        sound: &sound,
        viseme_weights: visemes.view(),
        parameters: parameters.view(),
        deviation: space.deviation.view(),
        cues: &cues::cues(visemes.view(), gaps.as_deref(), time::seconds(sound.len()))?,
    })?;
    files::write_bytes(&args.output, text.as_bytes())?;
    Ok(Drawn {
        pictures: rendered.pictures,
        size: (rendered.width, rendered.height),
        sound: true,
    })
}
