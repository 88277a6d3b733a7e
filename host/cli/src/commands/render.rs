//! `lipstream render`: a video of the mouth, with sound.
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use indicatif::ProgressBar;
use ndarray::Array2;

use super::choices;
use super::streams::{ending, file_name, is_standard, name, read_sound, say};
use lipstream::cues;
use lipstream::engine::{Engine, RunSettings};
use lipstream::mouth::MouthSpace;
use lipstream::parameters;
use lipstream::render::{self, Painter, Settings, page};
use lipstream::tensors::Tensors;
use lipstream_media::files;
use lipstream_media::sink::{Ffmpeg, Film, Mp4, PngFrames, RawFrames, Sink};

/// Draw the mouth that speech or parameters describe
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Speech (WAV, FLAC, MP3, Ogg Vorbis), or parameters that `lipstream convert` wrote (.npy, 100 frames a second);
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

/// What is to be drawn and heard.
struct Performance {
    /// `[frames, D]`
    tracks: Array2<f32>,
    /// `[frames, 13]`; absent in plain parameters.
    visemes: Option<Array2<f32>>,
    sound: Option<Vec<i16>>,
}

pub(crate) fn run(args: Args) -> Result<()> {
    let settings = Settings {
        fps: args.fps,
        scale: args.scale,
        noise: args.noise,
    };
    let space = mouth(&args.model)?;
    let (width, height) = settings.size(&space)?;
    let performance = performance(&args)?;
    let tracks = performance.tracks.view();
    let sound = performance.sound.as_deref();
    let bar = ProgressBar::new(0).with_message("pictures");
    let progress = |done: usize, total: usize| {
        bar.set_length(total as u64);
        bar.set_position(done as u64);
    };
    let pictures = if ending(&args.output) == "html" {
        let (Some(visemes), Some(sound)) = (&performance.visemes, sound) else {
            bail!("a page shows what the model hears: give speech, not parameters");
        };
        let rendered = render::to_mp4(&space, tracks, Some(sound), &settings, progress)?;
        let seconds = sound.len() as f64 / f64::from(lipstream_core::SAMPLE_RATE_HZ);
        let text = page::write(&page::Page {
            title: &file_name(&args.input),
            mp4: &rendered.mp4,
            sound,
            viseme_weights: visemes.view(),
            parameters: tracks,
            deviation: space.deviation.view(),
            cues: &cues::cues(visemes.view(), seconds)?,
        })?;
        files::write_bytes(&args.output, text.as_bytes())?;
        rendered.pictures
    } else {
        let mut scene = Painter::new(&space, &settings)?;
        let film = render::film(&scene, &settings, sound);
        let mut sink = sink(&args.output, &film)?;
        let pictures = render::play(&mut scene, tracks, &film, |rgb| Ok(sink.picture(rgb)?), progress)?;
        sink.finish()?;
        pictures
    };
    bar.finish_and_clear();
    say(
        &args.output,
        &format!(
            "{pictures} pictures of {width}×{height}, {:.2} s{}",
            pictures as f64 / f64::from(args.fps),
            if sound.is_some() {
                ""
            } else {
                ", without sound (--audio WAV adds it)"
            }
        ),
    );
    Ok(())
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
fn mouth(path: &Path) -> Result<MouthSpace> {
    let tensors = Tensors::read(path)?;
    if !tensors.has("mouth.mean") {
        bail!(
            "{} has no mouth: it was trained on plain visual numbers, which cannot be drawn",
            path.display()
        );
    }
    MouthSpace::load(&tensors).with_context(|| format!("{} is no usable model", path.display()))
}

fn performance(args: &Args) -> Result<Performance> {
    if ending(&args.input) == "npy" {
        let sound = match &args.audio {
            Some(path) => Some(read_sound(path)?.samples),
            None => None,
        };
        return Ok(Performance {
            tracks: parameters::read(&args.input)?,
            visemes: None,
            sound,
        });
    }
    if args.audio.is_some() {
        bail!("--audio goes with parameters (.npy); speech is its own sound");
    }
    let samples = read_sound(&args.input)?.samples;
    let engine = Engine::open(&args.model, args.engine.into())?;
    let converted = engine.convert(&samples, &RunSettings::default())?;
    parameters::check(converted.parameters.view())
        .with_context(|| format!("{} gives no mouth", name(&args.input)))?;
    Ok(Performance {
        tracks: converted.parameters,
        visemes: Some(converted.visemes),
        sound: Some(samples),
    })
}
