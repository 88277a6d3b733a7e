//! `lipstream cues`: mouth shapes over time, for animation programs. The words of Rhubarb Lip Sync's command line mean here what its documentation says.
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use lipstream::cues::{self, BlendSet, Cue, CueError, Format, Shape, Shapes, Style};
use lipstream::engine::{Engine, RunSettings};
use lipstream::opening::OpeningReader;
use lipstream::time;
use serde_json::json;

use super::choices;
use super::dialog::Dialog;
use super::streams::{ending, hear, is_standard, name, open_sound, say, write};

/// Write mouth shapes over time for animation programs
///
/// Takes the options of Rhubarb Lip Sync, whose formats it writes.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Sound file with speech: WAV, FLAC, MP3, Ogg, M4A, WebM, AIFF and others; - is standard input
    wav: PathBuf,
    /// Tables that `lipstream export` wrote, or a model (.safetensors) [default: the shipped one]
    #[arg(short, long)]
    model: Option<PathBuf>,
    /// Where to: .tsv .xml .json .dat (as Rhubarb Lip Sync writes them), .txt (TSV) or .csv (blend shapes, see --set); - is
    /// standard output
    #[arg(short, long, default_value = "-")]
    output: PathBuf,
    /// Format [default: by the output's ending, tsv on standard output]
    #[arg(short, long, visible_alias = "exportFormat", ignore_case = true, value_parser = ["tsv", "xml", "json", "dat", "csv"])]
    format: Option<String>,
    /// Text that is said, a plain text file: its words decide the shapes where they fit what is heard
    #[arg(short, long = "dialogFile", visible_alias = "dialog", value_name = "FILE")]
    dialog: Option<PathBuf>,
    /// Of Rhubarb's recognizers none is used; both words are taken, since what is heard here are sounds of any language
    #[arg(short, long, ignore_case = true, value_parser = ["pocketSphinx", "phonetic"])]
    recognizer: Option<String>,
    /// Shapes that the character has besides the six basic ones, of G, H and X
    #[arg(long = "extendedShapes", visible_alias = "extended-shapes", value_name = "SHAPES", default_value = "GHX", value_parser = extended)]
    extended: Extended,
    /// Pictures a second of a .dat, 24 to 100 [default: 24]
    #[arg(long = "datFrameRate", visible_alias = "dat-frame-rate", value_name = "RATE", value_parser = frame_rate)]
    dat_frame_rate: Option<f64>,
    /// Preston Blair's names of the shapes in a .dat, as OpenToonz wants them
    #[arg(long = "datUsePrestonBlair", visible_alias = "dat-use-preston-blair")]
    dat_use_preston_blair: bool,
    /// Say nothing unless something is wrong
    #[arg(short, long)]
    quiet: bool,
    /// What is going on, on standard error, a JSON object a line
    #[arg(long = "machineReadable", visible_alias = "machine-readable")]
    machine_readable: bool,
    /// Columns of a .csv
    #[arg(long, value_enum, default_value_t = choices::BlendSet::Oculus)]
    set: choices::BlendSet,
    /// Arithmetic
    #[arg(long, value_enum, default_value_t = choices::Engine::Fixed)]
    engine: choices::Engine,
}

/// Shapes that a character has besides the six basic ones.
#[derive(Clone, Debug)]
struct Extended(Vec<Shape>);

fn extended(word: &str) -> Result<Extended, String> {
    let shape = |c: char| match c.to_ascii_uppercase() {
        'G' => Ok(Shape::G),
        'H' => Ok(Shape::H),
        'X' => Ok(Shape::X),
        _ => Err(format!("{c:?} is none of the extended shapes G, H and X")),
    };
    Ok(Extended(word.chars().map(shape).collect::<Result<_, _>>()?))
}

fn frame_rate(word: &str) -> Result<f64, String> {
    let rate: f64 = word.parse().map_err(|_| format!("{word:?} is no number"))?;
    match (24.0..=100.0).contains(&rate) {
        true => Ok(rate),
        false => Err("a frame rate is 24 to 100 pictures a second".to_owned()),
    }
}

/// What reads how open the mouth is: from the model's own mouth, or the shipped one where these are its tables.
pub(super) fn opening(model: Option<&Path>, engine: &Engine) -> Result<Option<OpeningReader>> {
    let own = model.map(OpeningReader::of_file).transpose()?.flatten();
    let is_shipped = || engine.model_id().is_some() && engine.model_id() == Engine::shipped().model_id();
    Ok(match own {
        None if model.is_none() || is_shipped() => OpeningReader::shipped()?,
        own => own,
    })
}

pub(crate) fn run(args: Args) -> Result<()> {
    let events = Events(args.machine_readable);
    let file = name(&args.wav);
    events.say(
        "start",
        "Info",
        &format!("Input file: {file:?}."),
        ("file", json!(file)),
    );
    let done = make(&args, &events);
    match &done {
        Ok(()) => events.say("success", "Info", "Done.", ("output", json!(args.output))),
        Err(error) if args.machine_readable => {
            let why = format!("{error:#}");
            events.say("failure", "Fatal", &why, ("reason", json!(why)));
            // The line that people get would be no JSON.
            std::process::exit(1);
        }
        Err(_) => {}
    }
    done
}

/// What is going on, for programs, if they have asked.
struct Events(bool);

impl Events {
    /// A line of Rhubarb's "machine-readable status messages".
    fn say(&self, kind: &str, level: &str, message: &str, what: (&str, serde_json::Value)) {
        if self.0 {
            let log = json!({ "level": level, "message": message });
            eprintln!("{}", json!({ "type": kind, what.0: what.1, "log": log }));
        }
    }

    fn progress(&self, value: f64) {
        let percent = format!("Progress: {:.0}%", 100.0 * value);
        self.say("progress", "Trace", &percent, ("value", json!(value)));
    }

    fn warn(&self, what: &str) {
        match self.0 {
            true => self.say("log", "Warning", what, ("text", json!(what))),
            false => eprintln!("warning: {what}"),
        }
    }
}

/// The ending that stands for the format that is asked for.
fn format_of(args: &Args) -> String {
    match &args.format {
        Some(format) => format.to_lowercase(),
        None if is_standard(&args.output) => "tsv".to_owned(),
        None if ending(&args.output) == "txt" => "tsv".to_owned(),
        None => ending(&args.output),
    }
}

fn make(args: &Args, events: &Events) -> Result<()> {
    let ending = format_of(args);
    let format = Format::ALL.into_iter().find(|f| f.ending() == ending);
    if format.is_none() && ending != "csv" {
        bail!("{}: write .tsv, .xml, .json, .dat or .csv", args.output.display());
    }
    if format != Some(Format::Dat) && (args.dat_frame_rate.is_some() || args.dat_use_preston_blair) {
        bail!("--datFrameRate and --datUsePrestonBlair are for --format dat");
    }
    let engine = Engine::open_or_shipped(args.model.as_deref(), args.engine.into(), false)?;
    events.progress(0.0);
    let what = match format {
        Some(format) => {
            let (said, seconds) = shapes(args, &engine, events)?;
            let said = cues::drawn_with(&said, &args.extended.0);
            let style = Style {
                dat_fps: args.dat_frame_rate.unwrap_or(Style::default().dat_fps),
                preston_blair: args.dat_use_preston_blair,
                closed: match args.extended.0.contains(&Shape::X) {
                    true => Shape::X,
                    false => Shape::A,
                },
            };
            let sound = match is_standard(&args.wav) {
                true => name(&args.wav),
                false => std::path::absolute(&args.wav)?.display().to_string(),
            };
            let text = cues::write_as(format, &said, &sound, &style);
            write(&args.output, |file| Ok(file.write_all(text.as_bytes())?))?;
            format!("{} mouth shapes, {seconds:.2} s", said.len())
        }
        None if args.dialog.is_some() => {
            bail!("--dialogFile is for mouth shapes, not for blend shapes (.csv)")
        }
        None => blends(args, &engine)?,
    };
    events.progress(1.0);
    if !args.quiet && !args.machine_readable {
        say(&args.output, &what);
    }
    Ok(())
}

/// The mouth shapes of the sound, and how long it is.
fn shapes(args: &Args, engine: &Engine, events: &Events) -> Result<(Vec<Cue>, f64)> {
    let mut sound = open_sound(&args.wav)?;
    let mut shapes = Shapes::default();
    let samples = match &args.dialog {
        None => {
            let session = engine.session(&RunSettings::default())?;
            hear(session, &[], &mut sound, |frame| Ok(shapes.push(frame.visemes)?))?
        }
        Some(dialog) => {
            let dialog = Dialog::read(dialog)?;
            let samples = sound.rest()?.samples;
            match dialog.visemes(&samples)? {
                Ok(visemes) => visemes.iter().try_for_each(|row| shapes.push(row))?,
                Err(why) => {
                    events.warn(&why);
                    let heard = engine.convert(&samples, &RunSettings::default())?;
                    for row in heard.visemes.outer_iter() {
                        shapes.push(&row.to_vec())?;
                    }
                }
            }
            samples.len()
        }
    };
    let seconds = time::seconds(samples);
    let said = shapes.finish(seconds);
    let said = said.with_context(|| format!("{} gives no cues", name(&args.wav)))?;
    Ok((said, seconds))
}

/// Writes a table of blend shapes; gives what is to be said of it.
fn blends(args: &Args, engine: &Engine) -> Result<String> {
    let mut sound = open_sound(&args.wav)?;
    let session = engine.session(&RunSettings::default())?;
    let opening = opening(args.model.as_deref(), engine)?;
    let mut samples = 0;
    write(&args.output, |file| {
        let mut rows = BlendSet::from(args.set).write(file, opening.clone())?;
        samples = hear(session, &[], &mut sound, |frame| Ok(rows.frame(frame)?))?;
        if time::frame_count(samples) == 0 {
            bail!("{} gives no cues: {}", name(&args.wav), CueError::NoFrame);
        }
        Ok(rows.finish()?)
    })?;
    Ok(format!(
        "{} rows, {:.2} s",
        time::frame_count(samples),
        time::seconds(samples)
    ))
}
