//! `lipstream render`: a video of the mouth, with sound.
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use indicatif::ProgressBar;
use ndarray::Array2;

use crate::mouth::MouthSpace;
use crate::render::{self, Settings, foreign, parameters};
use crate::tensors::Tensors;
use crate::{audio, files};

/// Draw the mouth that parameters or speech describe
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Parameters that `lipstream convert` wrote (.npy, 100 frames a second)
    input: PathBuf,
    /// Model, or the mouth.safetensors of a feature folder
    #[arg(short, long)]
    model: PathBuf,
    /// Video to write: .mp4 needs no other program, every other format needs ffmpeg
    #[arg(short, long)]
    output: PathBuf,
    /// Sound of the video: the WAV that the parameters come from
    #[arg(long)]
    audio: Option<PathBuf>,
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
    let space = mouth(&args.model)?;
    let tracks = tracks(&args.input)?;
    let sound = match &args.audio {
        Some(path) => Some(audio::read(path)?.samples),
        None => None,
    };
    let sound = sound.as_deref();
    let bar = ProgressBar::new(0).with_message("pictures");
    let progress = |done: usize, all: usize| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    };
    let pictures = if ending(&args.output) == "mp4" {
        let rendered = render::to_mp4(&space, tracks.view(), sound, &settings, progress)?;
        files::write_bytes(&args.output, &rendered.mp4)?;
        rendered.pictures
    } else {
        foreign::write(&args.output, &space, tracks.view(), sound, &settings, progress)?
    };
    bar.finish_and_clear();
    let (width, height) = settings.size(&space)?;
    println!(
        "{}: {pictures} pictures of {width}×{height}, {:.2} s{}",
        args.output.display(),
        pictures as f64 / f64::from(args.fps),
        if sound.is_some() {
            ", with sound"
        } else {
            ", without sound (--audio WAV adds it)"
        }
    );
    Ok(())
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

fn tracks(input: &Path) -> Result<Array2<f32>> {
    match ending(input).as_str() {
        "npy" => parameters::read(input),
        _ => bail!(
            "{} is no .npy of parameters (make one with `lipstream convert`)",
            input.display()
        ),
    }
}

/// Ending of a file's name in lower case, without the dot.
fn ending(path: &Path) -> String {
    path.extension()
        .unwrap_or_default()
        .to_string_lossy()
        .to_lowercase()
}
