//! `lipstream cues`: mouth shapes over time, for animation programs. The words of Rhubarb Lip Sync's command line mean here what its documentation says.
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use lipstream::cues::{self, BlendSet, Cue, CueError, Format, Rate, Shape, Shapes, Style, Table};
use lipstream::engine::{Engine, RunSettings};
use lipstream::opening::OpeningReader;
use lipstream::progress::Progress as _;
use lipstream::session::Frame;
use lipstream::time;
use lipstream_make::align::dialog::Dialog;
use serde_json::json;

use super::answer::{Answer, Done};
use super::batch::{self, Work};
use super::choices;
use super::cues_events::{Events, Level};
use super::streams::{ending, hear_telling, is_standard, keep_apart, name, open_sound, write};
use crate::progress::{Terminal, is_quiet};

/// Write mouth shapes over time for animation programs
///
/// Takes the options of Rhubarb Lip Sync, whose formats it writes; with --set, weights of other programs' shapes at every moment. Of several sounds, a folder or a pattern the
/// files go into the folder -o.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Sound files with speech (WAV, FLAC, MP3, Ogg, M4A, WebM, AIFF and others), folders of them, patterns like "*.wav"; - is standard input
    #[arg(required = true, value_name = "SOUND")]
    inputs: Vec<PathBuf>,
    /// Tables that `lipstream export` wrote, or a model (.safetensors) [default: the shipped one]
    #[arg(short, long)]
    model: Option<PathBuf>,
    /// Where to: .tsv .xml .json .dat (as Rhubarb Lip Sync writes them), .txt (TSV), .vtt (WebVTT) or .csv (see --set); for several sounds a folder; - is
    /// standard output
    #[arg(short, long, default_value = "-")]
    output: PathBuf,
    /// Format [default: by the output's ending, tsv on standard output and for several sounds, with --set csv]
    #[arg(short, long, visible_alias = "exportFormat", ignore_case = true, value_parser = ["tsv", "xml", "json", "dat", "vtt", "csv"])]
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
    /// What is going on, on standard error, a JSON object a line
    #[arg(long = "machineReadable", visible_alias = "machine-readable")]
    machine_readable: bool,
    /// The least that is said on standard error [default: warning, with --quiet error]
    #[arg(
        long = "consoleLevel",
        visible_alias = "console-level",
        ignore_case = true,
        value_enum,
        value_name = "LEVEL"
    )]
    console_level: Option<Level>,
    /// A file for what is going on
    #[arg(long = "logFile", visible_alias = "log-file", value_name = "FILE")]
    log_file: Option<PathBuf>,
    /// The least that the log file gets
    #[arg(long = "logLevel", visible_alias = "log-level", ignore_case = true, value_enum, value_name = "LEVEL", default_value_t = Level::Debug)]
    log_level: Level,
    /// Sounds that are worked on at once [default: as many as there are processors]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    threads: Option<u16>,
    /// Weights of these shapes, moment by moment, as .csv or .json [default of a .csv: oculus]
    #[arg(long, value_enum)]
    set: Option<choices::BlendSet>,
    /// Rows a second of weights, such as 25, 29.97 or 30000/1001 [default: one every 10 ms]
    #[arg(long, value_name = "RATE")]
    rate: Option<Rate>,
    /// Arithmetic
    #[arg(long, value_enum, default_value_t = choices::Engine::Fixed)]
    engine: choices::Engine,
    #[command(flatten)]
    answer: Answer,
}

impl Args {
    /// Whether anything is told but Rhubarb's messages.
    fn tells(&self) -> bool {
        self.answer.json || !self.machine_readable
    }
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

/// What is written, and what it needs: the same for every sound.
struct Task<'a> {
    args: &'a Args,
    engine: Engine,
    what: What,
    dialog: Option<Dialog>,
}

/// What a file holds.
enum What {
    Cues(Format, Style, Option<OpeningReader>),
    Weights(Table, BlendSet, Option<OpeningReader>),
}

pub(crate) fn run(args: Args) -> Result<()> {
    let log = args.log_file.as_deref();
    let console = args.console_level.unwrap_or(match is_quiet() {
        true => Level::Error,
        false => Level::Warning,
    });
    let events = Events::new(args.machine_readable, console, log, args.log_level)?;
    let files: Vec<String> = args.inputs.iter().map(|input| name(input)).collect();
    let files = files.join(", ");
    events.event(
        "start",
        Level::Info,
        &format!("Input file: {files:?}."),
        ("file", json!(files)),
    );
    let done = work(&args, &events);
    match &done {
        Ok(()) => events.event("success", Level::Info, "Done.", ("output", json!(args.output))),
        Err(error) => {
            let why = format!("{error:#}");
            events.event("failure", Level::Fatal, &why, ("reason", json!(why)));
            if args.machine_readable {
                // The line that people get would be no JSON.
                std::process::exit(1);
            }
        }
    }
    done
}

/// The ending that stands for the format that is asked for.
fn format_of(args: &Args, is_folder: bool) -> String {
    match &args.format {
        Some(format) => format.to_lowercase(),
        None if !is_folder && args.answer.wants_result(&args.output) => "json".to_owned(),
        None if is_folder || is_standard(&args.output) => match args.set {
            Some(_) => "csv".to_owned(),
            None => "tsv".to_owned(),
        },
        None if ending(&args.output) == "txt" => "tsv".to_owned(),
        None => ending(&args.output),
    }
}

fn work(args: &Args, events: &Events) -> Result<()> {
    let is_format =
        |ending: &str| ["csv", "txt"].contains(&ending) || Format::ALL.iter().any(|f| f.ending() == ending);
    let ending = format_of(args, true);
    match batch::plan(&args.inputs, &args.output, &ending, is_format)? {
        Work::One(sound) => {
            let read = [&args.model, &args.dialog].into_iter().flatten().chain([&sound]);
            keep_apart(&args.output, read.map(PathBuf::as_path))?;
            let task = Task::new(args, &format_of(args, false))?;
            events.progress(0.0);
            let done = task.make(&sound, &args.output, events, |part| events.progress(part))?;
            events.progress(1.0);
            if args.tells() {
                args.answer.tell(&args.output, &done);
            }
        }
        Work::Many(_) if args.dialog.is_some() => {
            bail!("--dialogFile is the text of one sound, and there are several")
        }
        Work::Many(jobs) => {
            let task = Task::new(args, &ending)?;
            let progress = Terminal::shown(!args.machine_readable);
            let part = |done: usize| events.progress(done as f64 / jobs.len() as f64);
            part(0);
            let complain = |why: &str| match args.machine_readable {
                true => events.say(Level::Error, why),
                false => {
                    events.log(Level::Error, why);
                    progress.warn(&format!("lipstream: {why}"));
                }
            };
            let outcomes = batch::work(
                &jobs,
                args.threads.map(usize::from),
                &progress,
                part,
                complain,
                |job| {
                    let done = task.make(&job.input, &job.output, events, |_| {})?;
                    events.say(
                        Level::Info,
                        &format!("{}: {}", job.output.display(), done.words()),
                    );
                    Ok(done)
                },
            )?;
            if args.tells() {
                args.answer.tell_many(&args.output, &jobs, &outcomes);
            }
            batch::all_done(&outcomes)?;
        }
    }
    Ok(())
}

impl<'a> Task<'a> {
    /// `ending` is the format.
    fn new(args: &'a Args, ending: &str) -> Result<Self> {
        let format = Format::ALL.into_iter().find(|f| f.ending() == ending);
        if format != Some(Format::Dat) && (args.dat_frame_rate.is_some() || args.dat_use_preston_blair) {
            bail!("--datFrameRate and --datUsePrestonBlair are for --format dat");
        }
        let table = match (ending, args.set) {
            ("csv", _) => Some(Table::Csv),
            ("json", Some(_)) => Some(Table::Json),
            _ => None,
        };
        if table.is_none() && (args.set.is_some() || args.rate.is_some()) {
            bail!("--set and --rate are for weights: write .csv, or .json with --set");
        }
        let engine = Engine::open_or_shipped(args.model.as_deref(), args.engine.into(), false)?;
        let opening = opening(args.model.as_deref(), &engine)?;
        let what = match (table, format) {
            (Some(table), _) => {
                let set = args.set.map_or(BlendSet::Oculus, Into::into);
                What::Weights(table, set, opening)
            }
            (None, Some(format)) => What::Cues(format, style(args), opening),
            (None, None) => bail!(
                "{}: write .tsv, .xml, .json, .dat, .vtt or .csv",
                args.output.display()
            ),
        };
        let dialog = args.dialog.as_deref().map(Dialog::read).transpose()?;
        Ok(Self {
            args,
            engine,
            what,
            dialog,
        })
    }

    /// Writes the file of one sound.
    fn make(&self, sound: &Path, output: &Path, events: &Events, part: impl FnMut(f64)) -> Result<Done> {
        match &self.what {
            What::Cues(format, style, opening) => {
                let (said, seconds) = self.shapes(sound, opening.as_ref(), events, part)?;
                let said = cues::drawn_with(&said, &self.args.extended.0);
                let file = match is_standard(sound) {
                    true => name(sound),
                    false => std::path::absolute(sound)?.display().to_string(),
                };
                let text = cues::write_as(*format, &said, &file, style);
                write(output, |file| Ok(file.write_all(text.as_bytes())?))?;
                Ok(Done::new(
                    format!("{} mouth shapes, {seconds:.2} s", said.len()),
                    json!({ "cues": said.len(), "seconds": seconds }),
                ))
            }
            What::Weights(table, set, opening) => {
                let (mut rows, mut seconds) = (0, 0.0);
                write(output, |file| {
                    let mut numbers = table.write(file, *set, opening.clone(), self.args.rate)?;
                    let samples = self.frames(sound, events, part, |frame, _| {
                        rows += 1;
                        Ok(numbers.frame(frame)?)
                    })?;
                    if rows == 0 {
                        bail!("{} gives no cues: {}", name(sound), CueError::NoFrame);
                    }
                    seconds = time::seconds(samples);
                    Ok(numbers.finish()?)
                })?;
                let words = match self.args.rate {
                    None => format!("{rows} rows, {seconds:.2} s"),
                    Some(rate) => format!("{seconds:.2} s, {:.3} rows a second", rate.hz()),
                };
                let rate = self.args.rate.map_or(time::FRAME_RATE_HZ as f64, Rate::hz);
                Ok(Done::new(
                    words,
                    json!({ "seconds": seconds, "rows_per_second": rate }),
                ))
            }
        }
    }

    /// The mouth shapes of a sound, and how long it is.
    fn shapes(
        &self,
        sound: &Path,
        opening: Option<&OpeningReader>,
        events: &Events,
        part: impl FnMut(f64),
    ) -> Result<(Vec<Cue>, f64)> {
        let mut shapes = Shapes::default();
        let samples = self.frames(sound, events, part, |frame, is_told| {
            // Aligned words say when lips close; the mouth that goes with what was heard does not know them.
            let gap = opening.filter(|_| !is_told);
            let gap = gap.map(|reader| reader.read(frame.parameters).gap);
            Ok(shapes.push(frame.visemes, gap)?)
        })?;
        let seconds = time::seconds(samples);
        let said = shapes.finish(seconds);
        let said = said.with_context(|| format!("{} gives no cues", name(sound)))?;
        Ok((said, seconds))
    }

    /// Calls `each` with every frame of a sound and whether its visemes are those of the text, which they are where one is given and fits; gives the number of
    /// samples.
    fn frames(
        &self,
        sound: &Path,
        events: &Events,
        part: impl FnMut(f64),
        mut each: impl FnMut(&Frame, bool) -> Result<()>,
    ) -> Result<usize> {
        let mut heard = open_sound(sound)?;
        let Some(dialog) = &self.dialog else {
            let session = self.engine.session(&RunSettings::default())?;
            return hear_telling(session, &[], &mut heard, part, |frame| each(frame, false));
        };
        let samples = heard.rest()?.samples;
        let converted = self.engine.convert(&samples, &RunSettings::default())?;
        let said = match dialog.visemes(&samples)? {
            Ok(said) => Some(said),
            Err(why) => {
                events.say(Level::Warning, &why);
                None
            }
        };
        for (index, (parameters, visemes)) in converted
            .parameters
            .outer_iter()
            .zip(converted.visemes.outer_iter())
            .enumerate()
        {
            let said = said.as_ref().and_then(|said| said.get(index));
            let frame = Frame {
                index,
                parameters: &parameters.to_vec(),
                visemes: &said.map_or_else(|| visemes.to_vec(), |row| row.to_vec()),
            };
            each(&frame, said.is_some())?;
        }
        Ok(samples.len())
    }
}

/// How cue files are to be written.
fn style(args: &Args) -> Style {
    Style {
        dat_fps: args.dat_frame_rate.unwrap_or(Style::default().dat_fps),
        preston_blair: args.dat_use_preston_blair,
        closed: match args.extended.0.contains(&Shape::X) {
            true => Shape::X,
            false => Shape::A,
        },
    }
}
