//! `lipstream cues`: mouth shapes over time, for animation programs.
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use lipstream::cues::{self, BlendSet, CueError, Format, Shapes};
use lipstream::engine::{Engine, RunSettings};
use lipstream::opening::OpeningReader;
use lipstream::time;

use super::choices;
use super::streams::{ending, file_name, hear, is_standard, name, open_sound, say, write};

/// Write mouth shapes over time for animation programs
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Sound file with speech: WAV, FLAC, MP3, Ogg, M4A, WebM, AIFF and others; - is standard input
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
    #[arg(long, value_enum, default_value_t = choices::BlendSet::Oculus)]
    set: choices::BlendSet,
    /// Arithmetic
    #[arg(long, value_enum, default_value_t = choices::Engine::Fixed)]
    engine: choices::Engine,
}

/// What reads how open the mouth is: from the model's own mouth, or the shipped one where these are its tables.
fn opening(model: &Path, engine: &Engine) -> Result<Option<OpeningReader>> {
    let own = OpeningReader::of_file(model)?;
    let is_shipped = || engine.model_id().is_some() && engine.model_id() == Engine::shipped().model_id();
    Ok(match own {
        None if is_shipped() => OpeningReader::shipped()?,
        own => own,
    })
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
    let mut sound = open_sound(&args.wav)?;
    let engine = Engine::open(&args.model, args.engine.into())?;
    let session = engine.session(&RunSettings::default())?;
    let what = match format {
        Some(format) => {
            let mut shapes = Shapes::default();
            let samples = hear(session, &[], &mut sound, |frame| Ok(shapes.push(frame.visemes)?))?;
            let seconds = time::seconds(samples);
            let shapes = shapes
                .finish(seconds)
                .with_context(|| format!("{} gives no cues", name(&args.wav)))?;
            let text = cues::write(format, &shapes, &file_name(&args.wav));
            write(&args.output, |file| Ok(file.write_all(text.as_bytes())?))?;
            format!("{} mouth shapes, {seconds:.2} s", shapes.len())
        }
        None => {
            let opening = opening(&args.model, &engine)?;
            let mut samples = 0;
            write(&args.output, |file| {
                let mut rows = BlendSet::from(args.set).write(file, opening.clone())?;
                samples = hear(session, &[], &mut sound, |frame| Ok(rows.frame(frame)?))?;
                if time::frame_count(samples) == 0 {
                    bail!("{} gives no cues: {}", name(&args.wav), CueError::NoFrame);
                }
                Ok(rows.finish()?)
            })?;
            format!(
                "{} rows, {:.2} s",
                time::frame_count(samples),
                time::seconds(samples)
            )
        }
    };
    say(&args.output, &what);
    Ok(())
}
