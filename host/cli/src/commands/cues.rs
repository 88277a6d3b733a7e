//! `lipstream cues`: mouth shapes over time, for animation programs.
use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};
use lipstream_core::SAMPLE_RATE_HZ;

use super::choices;
use super::streams::{ending, file_name, is_standard, name, read_sound, say, write};
use lipstream::cues::{self, Format};
use lipstream::engine::{Engine, RunSettings};

/// Write mouth shapes over time for animation programs
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Sound file with speech: WAV, FLAC, MP3 or Ogg Vorbis; - is standard input
    wav: PathBuf,
    /// Tables that `lipstream export` wrote, or a model (.safetensors)
    #[arg(short, long)]
    model: PathBuf,
    /// Where to: .tsv .xml .json .dat (as Rhubarb Lip Sync writes them) or .csv (blend shapes, see --set); - is standard
    /// output
    #[arg(short, long)]
    output: PathBuf,
    /// Format [default: by the output's ending, tsv on standard output]
    #[arg(long, value_parser = ["tsv", "xml", "json", "dat", "csv"])]
    format: Option<String>,
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
    let ending = match &args.format {
        Some(format) => format.to_lowercase(),
        None if is_standard(&args.output) => "tsv".to_owned(),
        None => ending(&args.output),
    };
    let format = Format::ALL.into_iter().find(|f| f.ending() == ending);
    if format.is_none() && ending != "csv" {
        bail!("{}: write .tsv, .xml, .json, .dat or .csv", args.output.display());
    }
    let samples = read_sound(&args.wav)?.samples;
    let engine = Engine::open(&args.model, args.engine.into())?;
    let weights = engine.convert(&samples, &RunSettings::default())?.visemes;
    let seconds = samples.len() as f64 / f64::from(SAMPLE_RATE_HZ);
    let shapes =
        cues::cues(weights.view(), seconds).with_context(|| format!("{} gives no cues", name(&args.wav)))?;
    let text = match (format, args.set) {
        (Some(format), _) => cues::write(format, &shapes, &file_name(&args.wav)),
        (None, Set::Oculus) => cues::oculus_csv(weights.view())?,
        (None, Set::Arkit) => cues::arkit_csv(weights.view())?,
    };
    write(&args.output, |file| Ok(file.write_all(text.as_bytes())?))?;
    let what = match format {
        Some(_) => format!("{} mouth shapes", shapes.len()),
        None => format!("{} rows", weights.nrows()),
    };
    say(&args.output, &format!("{what}, {seconds:.2} s"));
    Ok(())
}
