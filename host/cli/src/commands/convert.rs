//! `lipstream convert`: sound in, mouth parameters out.
use std::path::PathBuf;

use anyhow::{Result, bail};
use lipstream::engine::{Engine, RunSettings};
use lipstream::out::Format;
use lipstream::session::Frame;
use lipstream::time::{frame_count, seconds};
use lipstream_core::{FRAME_SAMPLES, SAMPLE_RATE_HZ};
use lipstream_live::recording::{Played, Recording};

use super::choices;
use super::streams::{ending, hear, is_standard, name, open_sound, say, write};

/// Convert speech to mouth parameters
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Sound file with speech: WAV, FLAC, MP3, Ogg, M4A, WebM, AIFF and others; - is standard input. Or a stream that `lipstream record` made (.stream)
    wav: PathBuf,
    /// Tables that `lipstream export` wrote, or a model (.safetensors) [default: the shipped one]
    #[arg(short, long)]
    model: Option<PathBuf>,
    /// Where to: .npy (parameters), .csv or .json (parameters and viseme weights); - is standard output
    #[arg(short, long)]
    output: PathBuf,
    /// Format [default: by the output's ending, csv on standard output]
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
}

pub(crate) fn run(args: Args) -> Result<()> {
    let format = match &args.format {
        Some(format) => (*format).into(),
        None if is_standard(&args.output) => Format::Csv,
        None => match Format::of_ending(&ending(&args.output)) {
            Some(format) => format,
            None => bail!("{}: write .npy, .csv or .json", args.output.display()),
        },
    };
    if ending(&args.wav) == "stream" {
        return of_stream(&args, format);
    }
    let engine = Engine::open_or_shipped(args.model.as_deref(), args.engine.into(), args.feedback.is_some())?;
    let mut sound = open_sound(&args.wav)?;
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
        && let Some(piece) = sound.piece()?
    {
        samples.extend(piece);
    }
    if samples.len() < FRAME_SAMPLES {
        bail!(
            "{} is shorter than one window of {} ms",
            name(&args.wav),
            1000 * FRAME_SAMPLES / SAMPLE_RATE_HZ as usize
        );
    }
    let mut count = 0;
    write(&args.output, |file| {
        let mut numbers = format.write(file, engine.n_parameters())?;
        count = hear(session, &samples, &mut sound, |frame| Ok(numbers.frame(frame)?))?;
        Ok(numbers.finish()?)
    })?;
    say(
        &args.output,
        &format!(
            "{} frames of {} parameters, {:.2} s",
            frame_count(count),
            engine.n_parameters(),
            seconds(count)
        ),
    );
    Ok(())
}

/// The numbers of a recorded stream, 100 frames a second from its first frame on.
fn of_stream(args: &Args, format: Format) -> Result<()> {
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
            args.wav.display()
        );
    }
    let mut recording = Recording::open(&args.wav)?;
    let width = recording.hello().scales.len();
    let mut played = Played::default();
    write(&args.output, |file| {
        let mut numbers = format.write(file, width)?;
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
            bail!("{} holds no frame", args.wav.display());
        }
        Ok(numbers.finish()?)
    })?;
    say(
        &args.output,
        &format!("{} of {width} parameters{}", told(&played), anew(&played)),
    );
    Ok(())
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
