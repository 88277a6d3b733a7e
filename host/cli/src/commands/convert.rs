//! `lipstream convert`: sound in, mouth parameters out.
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use lipstream::engine::{Engine, RunSettings};
use lipstream::opening::OpeningReader;
use lipstream::out::Format;
use lipstream::progress::Progress as _;
use lipstream::session::Frame;
use lipstream::time::{frame_count, seconds};
use lipstream_core::{FRAME_SAMPLES, SAMPLE_RATE_HZ};
use lipstream_live::recording::{Played, Recording};
use serde_json::json;

use super::answer::{Answer, Done};
use super::batch::{self, Work};
use super::choices;
use super::cues::opening;
use super::streams::{ending, hear, is_standard, keep_apart, name, open_sound, write};
use crate::progress::Terminal;

/// Convert speech to mouth parameters
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Sound files with speech (WAV, FLAC, MP3, Ogg, M4A, WebM, AIFF and others), folders of them, patterns like "*.wav"; - is standard input. Or a stream that
    /// `lipstream record` made (.stream)
    #[arg(required = true, value_name = "SOUND")]
    inputs: Vec<PathBuf>,
    /// Tables that `lipstream export` wrote, or a model (.safetensors) [default: the shipped one]
    #[arg(short, long)]
    model: Option<PathBuf>,
    /// Where to: .npy (parameters), .csv or .json (parameters and viseme weights); for several sounds a folder; - is standard output
    #[arg(short, long)]
    output: PathBuf,
    /// Format [default: by the output's ending, csv on standard output and for several sounds]
    #[arg(long, value_enum)]
    format: Option<choices::Numbers>,
    /// Arithmetic
    #[arg(long, value_enum, default_value_t = choices::Engine::Fixed)]
    engine: choices::Engine,
    /// Delay that is allowed: live 45 ms, standard 80 ms, studio without limit [default: the model's own]
    #[arg(long, value_enum)]
    profile: Option<choices::Profile>,
    /// Hops that an occupancy waits for [default: the model's]
    #[arg(long)]
    lag: Option<u16>,
    /// Width of the beam in bits, fixed engine only [default: the tables']
    #[arg(long)]
    beam: Option<f64>,
    /// The mouth by the paper's EM inside the lag window in place of the model's maps, with this exponent on its likelihood (0 to
    /// 4); likelihood-trained models only
    #[arg(long, value_name = "EXPONENT")]
    feedback: Option<f64>,
    /// How the mouth is found from the states, in floats; likelihood-trained models only [default: the model's own]
    #[arg(long, value_enum, value_name = "WAY", conflicts_with = "feedback")]
    mouth_by: Option<choices::MouthBy>,
    /// Show every movement at once, the quiver of a mouth at rest too (models trained on the error of their mouth)
    #[arg(long)]
    no_settling: bool,
    /// Sounds that are worked on at once [default: as many as there are processors]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    threads: Option<u16>,
    #[command(flatten)]
    answer: Answer,
}

pub(crate) fn run(args: Args) -> Result<()> {
    let of_many = args.format.map_or(Format::Csv, Into::into);
    let is_format = |ending: &str| Format::of_ending(ending).is_some();
    match batch::plan(&args.inputs, &args.output, of_many.ending(), is_format)? {
        Work::One(sound) => {
            let read = args.model.iter().chain([&sound]);
            keep_apart(&args.output, read.map(PathBuf::as_path))?;
            let format = match &args.format {
                Some(format) => (*format).into(),
                None if args.answer.wants_result(&args.output) => Format::Json,
                None if is_standard(&args.output) => Format::Csv,
                None => match Format::of_ending(&ending(&args.output)) {
                    Some(format) => format,
                    None => bail!("{}: write .npy, .csv or .json", args.output.display()),
                },
            };
            let done = match ending(&sound) == "stream" {
                true => of_stream(&args, &sound, format)?,
                false => {
                    let engine = engine(&args)?;
                    let opening = needed_opening(&args, &engine, format)?;
                    of_sound(&args, (&engine, opening), &sound, &args.output, format)?
                }
            };
            args.answer.tell(&args.output, &done);
        }
        Work::Many(jobs) => {
            let engine = engine(&args)?;
            let opening = needed_opening(&args, &engine, of_many)?;
            let progress = Terminal::default();
            let complain = |why: &str| progress.warn(&format!("lipstream: {why}"));
            let outcomes = batch::work(
                &jobs,
                args.threads.map(usize::from),
                &progress,
                |_| {},
                complain,
                |job| {
                    let with = (&engine, opening.clone());
                    of_sound(&args, with, &job.input, &job.output, of_many)
                },
            )?;
            args.answer.tell_many(&args.output, &jobs, &outcomes);
            batch::all_done(&outcomes)?;
        }
    }
    Ok(())
}

fn engine(args: &Args) -> Result<Engine> {
    let visual = args.feedback.is_some();
    Ok(Engine::open_or_shipped(
        args.model.as_deref(),
        args.engine.into(),
        visual,
    )?)
}

/// What reads how far the mouth is open, where the format has that.
fn needed_opening(args: &Args, engine: &Engine, format: Format) -> Result<Option<OpeningReader>> {
    match format {
        Format::Npy => Ok(None),
        Format::Csv | Format::Json => opening(args.model.as_deref(), engine),
    }
}

/// Writes the numbers of one sound.
fn of_sound(
    args: &Args,
    (engine, opening): (&Engine, Option<OpeningReader>),
    sound: &Path,
    output: &Path,
    format: Format,
) -> Result<Done> {
    let mut heard = open_sound(sound)?;
    let with = RunSettings {
        lag: args.lag,
        beam_bits: args.beam,
        feedback: args.feedback,
        speech: args.mouth_by.map(Into::into),
        profile: args.profile.map(Into::into),
        settle: args.no_settling.then_some(false),
    };
    let session = engine.session(&with)?;
    // A sound that is too short is refused before anything is written.
    let mut samples = Vec::new();
    while samples.len() < FRAME_SAMPLES
        && let Some(piece) = heard.piece()?
    {
        samples.extend(piece);
    }
    if samples.len() < FRAME_SAMPLES {
        bail!(
            "{} is shorter than one window of {} ms",
            name(sound),
            1000 * FRAME_SAMPLES / SAMPLE_RATE_HZ as usize
        );
    }
    let mut count = 0;
    write(output, |file| {
        let mut numbers = format.write(file, engine.n_parameters(), opening)?;
        count = hear(session, &samples, &mut heard, |frame| Ok(numbers.frame(frame)?))?;
        Ok(numbers.finish()?)
    })?;
    let (frames, width, seconds) = (frame_count(count), engine.n_parameters(), seconds(count));
    Ok(Done::new(
        format!("{frames} frames of {width} parameters, {seconds:.2} s"),
        json!({ "frames": frames, "parameters": width, "seconds": seconds }),
    ))
}

/// The numbers of a recorded stream, 100 frames a second from its first frame on.
fn of_stream(args: &Args, stream: &Path, format: Format) -> Result<Done> {
    let settings = [
        args.lag.is_some(),
        args.beam.is_some(),
        args.feedback.is_some(),
        args.mouth_by.is_some(),
        args.profile.is_some(),
    ];
    if args.model.is_some() || settings.contains(&true) || args.no_settling {
        bail!(
            "{} is converted already: leave out everything but --output and --format",
            stream.display()
        );
    }
    let mut recording = Recording::open(stream)?;
    let width = recording.hello().scales.len();
    let mut played = Played::default();
    // A recording names its model; the shipped one's mouth can be measured.
    let opening = match Some(recording.hello().model) == Engine::shipped().model_id() {
        true => OpeningReader::shipped()?,
        false => None,
    };
    write(&args.output, |file| {
        let mut numbers = format.write(file, width, opening)?;
        let mut index = 0;
        played = recording.play(|parameters, visemes| {
            numbers.frame(&Frame {
                index,
                parameters,
                visemes,
            })?;
            index += 1;
            Ok::<_, anyhow::Error>(())
        })?;
        if played.frames == 0 {
            bail!("{} holds no frame", stream.display());
        }
        Ok(numbers.finish()?)
    })?;
    Ok(Done::new(
        format!("{} of {width} parameters{}", told(&played), anew(&played)),
        json!({
            "frames": played.frames,
            "parameters": width,
            "between": played.between,
            "began_anew": played.began_anew,
        }),
    ))
}

/// How many frames were played, and how many of them were not in the file.
pub(super) fn told(played: &Played) -> String {
    match played.between {
        0 => format!("{} frames", played.frames),
        between => format!(
            "{} frames, {between} of them between those that came,",
            played.frames
        ),
    }
}

/// A word about a run that ended before the recording did.
pub(super) fn anew(played: &Played) -> &'static str {
    match played.began_anew {
        true => "; the device began anew there, what follows is left out",
        false => "",
    }
}
