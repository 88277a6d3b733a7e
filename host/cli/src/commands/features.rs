//! `lipstream features`: audio observations of a sound file, or all features of a folder for models made elsewhere.
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use lipstream_core::{FRAME_SAMPLES, N_STATIC};

use lipstream::npy::npy_bytes;
use lipstream::reference::{self, Normalisation};
use lipstream::time::seconds;
use lipstream::{frontend, htk};
use lipstream_make::evaluate::exchange;
use lipstream_make::features::FeatureFolder;
use serde_json::json;

use super::answer::{Answer, Done};
use super::streams::{ending, is_standard, keep_apart, name, read_sound, write};

/// Write audio observations (MFCC_E_D_A) of a sound, or the features of a whole folder as .npy
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Sound file: WAV, FLAC, MP3, Ogg, M4A, WebM, AIFF and others (- is standard input); other rates than 16 kHz are resampled. Or a feature
    /// folder (made by `lipstream prepare`)
    sound: PathBuf,
    /// Where to write: .htk or .npy, - is standard output; for a folder, the folder that gets index.json and one .npy a clip
    #[arg(short, long)]
    output: PathBuf,
    /// Format of a sound's observations [default: by the output's ending, htk on standard output]
    #[arg(long, value_enum)]
    format: Option<Format>,
    /// Arithmetic: the reference in floats, or what the device computes
    #[arg(long, value_enum, default_value_t = Engine::Float)]
    engine: Engine,
    /// Normalisation of the statics
    #[arg(long, value_enum, default_value_t = Norm::None)]
    norm: Norm,
    /// Feature folder whose training mean the causal mean starts from
    #[arg(long, value_name = "DIR", required_if_eq("norm", "causal"))]
    start: Option<PathBuf>,
    #[command(flatten)]
    answer: Answer,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Format {
    /// HTK's parameter file
    Htk,
    /// NumPy's array file
    Npy,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Engine {
    Float,
    Fixed,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Norm {
    /// As HTK writes them
    None,
    /// Less the causal mean, as in training and on the device
    Causal,
}

pub(crate) fn run(args: Args) -> Result<()> {
    if args.sound.is_dir() {
        return export(&args);
    }
    let format = match args.format {
        Some(format) => format,
        None if is_standard(&args.output) => Format::Htk,
        None => match ending(&args.output).as_str() {
            "htk" => Format::Htk,
            "npy" => Format::Npy,
            _ => bail!("{}: the name must end in .htk or .npy", args.output.display()),
        },
    };
    let normalisation = match (args.norm, &args.start) {
        (Norm::None, _) => Normalisation::None,
        (Norm::Causal, Some(folder)) => Normalisation::Causal {
            start_mean: start_mean(folder)?,
        },
        (Norm::Causal, None) => bail!("--norm causal needs --start DIR"),
    };
    keep_apart(&args.output, [args.sound.as_path()])?;
    let samples = read_sound(&args.sound)?;
    if samples.len() < FRAME_SAMPLES {
        bail!(
            "{} holds {:.1} ms of sound; one analysis window is 25 ms",
            name(&args.sound),
            1000.0 * seconds(samples.len())
        );
    }
    let observations = match args.engine {
        Engine::Float => reference::observations(&samples, normalisation),
        Engine::Fixed => frontend::observations(&samples, normalisation),
    };
    let bytes = match format {
        Format::Htk => htk::bytes(&observations)?,
        Format::Npy => npy_bytes(&observations)?,
    };
    write(&args.output, |file| Ok(file.write_all(&bytes)?))?;
    let (frames, width) = observations.dim();
    let done = Done::new(
        format!("{frames} frames"),
        json!({ "frames": frames, "numbers": width }),
    );
    args.answer.tell(&args.output, &done);
    Ok(())
}

/// Audio and mouth of every clip at 100 Hz.
fn export(args: &Args) -> Result<()> {
    if matches!(args.engine, Engine::Fixed)
        || matches!(args.norm, Norm::Causal)
        || args.start.is_some()
        || args.format.is_some()
    {
        bail!(
            "{} is a folder: its features are written as they are, without --format, --engine, --norm or --start",
            args.sound.display()
        );
    }
    let folder = FeatureFolder::open(&args.sound)?;
    let clips = exchange::export(&folder, &args.output)?;
    let done = Done::new(format!("{clips} clips"), json!({ "clips": clips }));
    args.answer.tell(&args.output, &done);
    Ok(())
}

fn start_mean(folder: &Path) -> Result<[f32; N_STATIC]> {
    let manifest = FeatureFolder::open(folder)?.manifest;
    match <[f32; N_STATIC]>::try_from(manifest.start_mean) {
        Ok(mean) if mean.iter().all(|m| m.is_finite()) => Ok(mean),
        _ => bail!("{}: start_mean is not {N_STATIC} numbers", folder.display()),
    }
}
