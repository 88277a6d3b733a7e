//! `lipstream cues`: mouth shapes over time, for animation programs.
use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};
use lipstream_core::SAMPLE_RATE_HZ;

use super::choices;
use super::render::name;
use lipstream::cues::{self, Format};
use lipstream::engine::{Engine, RunSettings};
use lipstream_media::{files, sound};

/// Write mouth shapes over time for animation programs
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Sound file with speech: WAV, FLAC, MP3 or Ogg Vorbis
    wav: PathBuf,
    /// Tables that `lipstream export` wrote, or a model (.safetensors)
    #[arg(short, long)]
    model: PathBuf,
    /// Where to: .tsv .xml .json .dat (as Rhubarb Lip Sync writes them) or .csv (blend shapes, see --set)
    #[arg(short, long)]
    output: PathBuf,
    /// Columns of a .csv
    #[arg(long, value_enum, default_value_t = Set::Oculus)]
    set: Set,
    /// Arithmetic
    #[arg(long, value_enum, default_value_t = choices::Engine::Fixed)]
    engine: choices::Engine,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Set {
    /// The 15 visemes of Oculus lip sync
    Oculus,
    /// The 52 blend shapes of ARKit
    Arkit,
}

pub(crate) fn run(args: Args) -> Result<()> {
    let ending = args
        .output
        .extension()
        .unwrap_or_default()
        .to_string_lossy()
        .to_lowercase();
    let format = Format::ALL.into_iter().find(|f| f.ending() == ending);
    if format.is_none() && ending != "csv" {
        bail!("{}: write .tsv, .xml, .json, .dat or .csv", args.output.display());
    }
    let samples = sound::read(&args.wav)?.samples;
    let engine = Engine::open(&args.model, args.engine.into())?;
    let weights = engine.convert(&samples, &RunSettings::default())?.visemes;
    let seconds = samples.len() as f64 / f64::from(SAMPLE_RATE_HZ);
    let shapes = cues::cues(weights.view(), seconds)
        .with_context(|| format!("{} gives no cues", args.wav.display()))?;
    let text = match (format, args.set) {
        (Some(format), _) => cues::write(format, &shapes, &name(&args.wav)),
        (None, Set::Oculus) => cues::oculus_csv(weights.view())?,
        (None, Set::Arkit) => cues::arkit_csv(weights.view())?,
    };
    files::write_bytes(&args.output, text.as_bytes())?;
    println!(
        "{}: {}, {seconds:.2} s",
        args.output.display(),
        if format.is_some() {
            format!("{} mouth shapes", shapes.len())
        } else {
            format!("{} rows", weights.nrows())
        }
    );
    Ok(())
}
