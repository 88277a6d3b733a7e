//! `lipstream render`: a video of the mouth, with sound.
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};

use super::streams::{ending, file_name, is_standard, name, read_sound, say};
use super::{choices, convert};
use crate::progress::Terminal;
use lipstream::cues;
use lipstream::engine::{Converted, Engine, FloatModel, RunSettings};
use lipstream::mouth::MouthSpace;
use lipstream::progress::Steps;
use lipstream::render::{self, Painter, Player, Settings, page};
use lipstream::session::Frame;
use lipstream::tensors::Tensors;
use lipstream::{parameters, time};
use lipstream_live::recording::Recording;
use lipstream_media::files;
use lipstream_media::sink::{Ffmpeg, Film, Mp4, PngFrames, RawFrames, Sink, Soundtrack};

/// Draw the mouth that speech or parameters describe
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Speech (WAV, FLAC, MP3, Ogg Vorbis), parameters that `lipstream convert` wrote (.npy, 100 frames a second), or a recorded stream (.stream);
    /// - is speech on standard input
    input: PathBuf,
    /// Model (.safetensors); for parameters, the mouth.safetensors of a feature folder does as well
    #[arg(short, long)]
    model: PathBuf,
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
    /// Camera noise, standard deviation in levels of 0..255 (real cameras: 1 to 3)
    #[arg(long, default_value_t = 0.0)]
    noise: f32,
}

pub(crate) fn run(args: Args) -> Result<()> {
    let settings = Settings {
        fps: args.fps,
        scale: args.scale,
        noise: args.noise,
    };
    let tensors = Tensors::read(&args.model)?;
    let space = mouth(&tensors, &args.model)?;
    let (width, height) = settings.size(&space)?;
    let said = if ending(&args.input) == "stream" {
        of_stream(&args, &tensors, &space, &settings)?
    } else if ending(&args.input) == "npy" {
        of_parameters(&args, &space, &settings)?
    } else if args.audio.is_some() && ending(&args.input) != "stream" {
        bail!("--audio goes with parameters (.npy); speech is its own sound");
    } else if ending(&args.output) == "html" {
        page(&args, &space, &settings)?
    } else {
        of_speech(&args, &space, &settings)?
    };
    let Drawn { pictures, sound } = said;
    say(
        &args.output,
        &format!(
            "{pictures} pictures of {width}×{height}, {:.2} s{}",
            pictures as f64 / f64::from(args.fps),
            if sound {
                ""
            } else {
                ", without sound (--audio WAV adds it)"
            }
        ),
    );
    Ok(())
}

/// What was made.
struct Drawn {
    pictures: usize,
    /// Whether there is a sound to it.
    sound: bool,
}

/// A film of parameters that were converted before.
fn of_parameters(args: &Args, space: &MouthSpace, settings: &Settings) -> Result<Drawn> {
    if ending(&args.output) == "html" {
        bail!("a page shows what the model hears: give speech, not parameters");
    }
    let sound = match &args.audio {
        Some(path) => Some(read_sound(path)?),
        None => None,
    };
    let tracks = parameters::read(&args.input)?;
    let mut scene = Painter::new(space, settings)?;
    let film = render::film(&scene, settings, sound.as_deref().map(Soundtrack::Samples));
    let mut sink = sink(&args.output, &film)?;
    let samples = sound.as_ref().map(Vec::len);
    let picture = |rgb: &[u8]| anyhow::Ok(sink.picture(rgb)?);
    let pictures = render::play(
        &mut scene,
        tracks.view(),
        film.fps,
        samples,
        picture,
        &Terminal::default(),
    )?;
    sink.finish()?;
    Ok(Drawn {
        pictures,
        sound: sound.is_some(),
    })
}

/// A film of a recorded stream, with the sound beside it if there is one: the mouths that were shown live.
fn of_stream(args: &Args, tensors: &Tensors, space: &MouthSpace, settings: &Settings) -> Result<Drawn> {
    if ending(&args.output) == "html" {
        bail!("a page shows what the model hears: give speech, not a recorded stream");
    }
    let mut recording = Recording::open(&args.input)?;
    check_model(tensors, &args.model, recording.hello().model)?;
    let beside = args.input.with_extension("wav");
    let sound = match &args.audio {
        Some(path) => Some(path),
        None => beside.is_file().then_some(&beside),
    };
    let sound = sound.map(|path| Soundtrack::File(path));
    let length = match &sound {
        Some(sound) => Some(sound.samples()?),
        None => None,
    };
    let mut scene = Painter::new(space, settings)?;
    let mut sink = sink(&args.output, &render::film(&scene, settings, sound))?;
    let mut player = Player::new(&mut scene, args.fps, length);
    let mut picture = |rgb: &[u8]| Ok::<_, anyhow::Error>(sink.picture(rgb)?);
    let played = recording.play(|parameters, _| player.frame(parameters, &mut picture))?;
    if played.frames == 0 {
        bail!("{} holds no frame", args.input.display());
    }
    player.finish(&mut picture)?;
    let pictures = player.pictures();
    sink.finish()?;
    if played.began_anew || played.between > 0 {
        eprintln!("{}{}", convert::told(&played), convert::anew(&played));
    }
    Ok(Drawn {
        pictures,
        sound: sound.is_some(),
    })
}

/// A stream can only be drawn with the mouth of the model that it came from.
fn check_model(tensors: &Tensors, path: &Path, id: u32) -> Result<()> {
    let Ok(model) = FloatModel::of_tensors(tensors) else {
        // The mouth.safetensors of a feature folder is no model, and knows of none.
        return Ok(());
    };
    let engine = Engine::fixed(model.export(false)?)?;
    let ours = engine.model_id().unwrap_or_default();
    if ours != id {
        bail!(
            "the stream is of model {id:08x}, {} is {ours:08x}: draw it with the model that the device runs",
            path.display()
        );
    }
    Ok(())
}

/// A film of speech, which is read piece by piece: once for its length, once by the sink, and once by the model.
fn of_speech(args: &Args, space: &MouthSpace, settings: &Settings) -> Result<Drawn> {
    // What can be read only once is kept.
    let samples = match args.input.is_file() {
        true => None,
        false => Some(read_sound(&args.input)?),
    };
    let sound = match &samples {
        Some(samples) => Soundtrack::Samples(samples),
        None => Soundtrack::File(&args.input),
    };
    let length = sound.samples()?;
    let engine = Engine::open(&args.model, args.engine.into())?;
    let all = render::length(length, args.fps);
    let mut session = engine.session(&RunSettings::default())?;
    let mut scene = Painter::new(space, settings)?;
    let mut sink = sink(&args.output, &render::film(&scene, settings, Some(sound)))?;
    let mut player = Player::new(&mut scene, args.fps, Some(length));
    let terminal = Terminal::default();
    let steps = Steps::begin(&terminal, render::PICTURES, all);
    let mut picture = |rgb: &[u8]| {
        sink.picture(rgb)?;
        steps.made();
        Ok(())
    };
    let mut drawn = anyhow::Ok(());
    let mut take = |frame: Frame| {
        if drawn.is_ok() {
            drawn = player.frame(frame.parameters, &mut picture);
        }
    };
    sound.each(|piece| Ok::<_, anyhow::Error>(session.push(piece, &mut take)?))?;
    session.finish(&mut take)?;
    drawn
        .and_then(|()| player.finish(&mut picture))
        .with_context(|| format!("{} gives no mouth", name(&args.input)))?;
    sink.finish()?;
    Ok(Drawn {
        pictures: all,
        sound: true,
    })
}

/// A page, which carries its film: it is made in memory.
fn page(args: &Args, space: &MouthSpace, settings: &Settings) -> Result<Drawn> {
    let sound = read_sound(&args.input)?;
    let engine = Engine::open(&args.model, args.engine.into())?;
    let Converted { parameters, visemes } = engine.convert(&sound, &RunSettings::default())?;
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
        cues: &cues::cues(visemes.view(), time::seconds(sound.len()))?,
    })?;
    files::write_bytes(&args.output, text.as_bytes())?;
    Ok(Drawn {
        pictures: rendered.pictures,
        sound: true,
    })
}

/// Where the pictures go, by the output's name.
fn sink(output: &Path, film: &Film) -> Result<Box<dyn Sink>> {
    if is_standard(output) {
        return Ok(Box::new(RawFrames::new(std::io::BufWriter::new(
            std::io::stdout(),
        ))));
    }
    let is_folder = output
        .as_os_str()
        .to_string_lossy()
        .ends_with(std::path::is_separator);
    if is_folder {
        return Ok(Box::new(PngFrames::new(output, film)?));
    }
    Ok(match ending(output).as_str() {
        "mp4" => Box::new(Mp4::new(output, film)?),
        _ => Box::new(Ffmpeg::new(output, film)?),
    })
}

/// The mouth of a model or of a feature folder.
fn mouth(tensors: &Tensors, path: &Path) -> Result<MouthSpace> {
    if !tensors.has("mouth.mean") {
        bail!(
            "{} has no mouth: it was trained on plain visual numbers, which cannot be drawn",
            path.display()
        );
    }
    MouthSpace::load(tensors).with_context(|| format!("{} is no usable model", path.display()))
}
