//! `lipstream cues`: mouth shapes over time, for animation programs.
use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};
use lipstream::cues::{self, BlendSet, CueError, Format, Shapes};
use lipstream::engine::{Engine, RunSettings};
use lipstream::session::Frame;
use lipstream::time;
use lipstream_media::sound::Reader;

use super::choices;
use super::streams::{ending, file_name, is_standard, name, open_sound, say, write};

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
    #[arg(long, value_enum, default_value_t = choices::BlendSet::Oculus)]
    set: choices::BlendSet,
    /// Arithmetic
    #[arg(long, value_enum, default_value_t = choices::Engine::Fixed)]
    engine: choices::Engine,
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
    let what = match format {
        Some(format) => {
            let mut shapes = Shapes::default();
            let (_, seconds) = hear(&mut sound, &engine, |frame| Ok(shapes.push(frame.visemes)?))?;
            let shapes = shapes
                .finish(seconds)
                .with_context(|| format!("{} gives no cues", name(&args.wav)))?;
            let text = cues::write(format, &shapes, &file_name(&args.wav));
            write(&args.output, |file| Ok(file.write_all(text.as_bytes())?))?;
            format!("{} mouth shapes, {seconds:.2} s", shapes.len())
        }
        None => {
            let mut said = (0, 0.0);
            write(&args.output, |file| {
                let mut rows = BlendSet::from(args.set).write(file)?;
                said = hear(&mut sound, &engine, |frame| Ok(rows.frame(frame)?))?;
                if said.0 == 0 {
                    bail!("{} gives no cues: {}", name(&args.wav), CueError::NoFrame);
                }
                Ok(rows.finish()?)
            })?;
            format!("{} rows, {:.2} s", said.0, said.1)
        }
    };
    say(&args.output, &what);
    Ok(())
}

/// Calls `each` with every frame of a sound; gives their number, and the sound's length in seconds.
fn hear(
    sound: &mut Reader,
    engine: &Engine,
    mut each: impl FnMut(&Frame) -> Result<()>,
) -> Result<(usize, f64)> {
    let mut session = engine.session(&RunSettings::default())?;
    let (mut frames, mut samples, mut heard) = (0, 0, Ok(()));
    let mut take = |frame: Frame| {
        frames += 1;
        if heard.is_ok() {
            heard = each(&frame);
        }
    };
    while let Some(piece) = sound.piece()? {
        samples += piece.len();
        session.push(piece, &mut take)?;
    }
    session.finish(&mut take)?;
    heard?;
    Ok((frames, time::seconds(samples)))
}
