//! `lipstream convert`: sound in, mouth parameters out.
use std::path::PathBuf;

use anyhow::{Result, bail};
use lipstream_core::{FRAME_SAMPLES, HOP_SAMPLES, SAMPLE_RATE_HZ};

use super::choices;
use lipstream::engine::{Converted, Engine, RunSettings};
use lipstream::npy;
use lipstream::phones::VISEMES;
use lipstream_media::{files, sound};

/// Convert speech to mouth parameters
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Sound file with speech: WAV, FLAC, MP3 or Ogg Vorbis
    wav: PathBuf,
    /// Tables that `lipstream export` wrote, or a model (.safetensors)
    #[arg(short, long)]
    model: PathBuf,
    /// Where to: .npy (parameters), .csv or .json (parameters and viseme weights)
    #[arg(short, long)]
    output: PathBuf,
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
    /// Show every movement at once, the quiver of a mouth at rest too (models trained on the error of their mouth)
    #[arg(long)]
    no_settling: bool,
}

pub(crate) fn run(args: Args) -> Result<()> {
    let write = match args.output.extension().and_then(|e| e.to_str()) {
        Some("npy") => npy,
        Some("csv") => csv,
        Some("json") => json,
        _ => bail!("{}: write .npy, .csv or .json", args.output.display()),
    };
    let engine = Engine::open_with(&args.model, args.engine.into(), args.feedback.is_some())?;
    let sound = sound::read(&args.wav)?;
    let with = RunSettings {
        lag: args.lag,
        beam_bits: args.beam,
        feedback: args.feedback,
        profile: args.profile.map(Into::into),
        settle: args.no_settling.then_some(false),
    };
    let converted = engine.convert(&sound.samples, &with)?;
    if converted.parameters.nrows() == 0 {
        bail!(
            "{} is shorter than one window of {} ms",
            args.wav.display(),
            1000 * FRAME_SAMPLES / SAMPLE_RATE_HZ as usize
        );
    }
    write(&args, &converted)?;
    println!(
        "{}: {} frames of {} parameters, {:.2} s",
        args.output.display(),
        converted.parameters.nrows(),
        converted.parameters.ncols(),
        sound.seconds()
    );
    Ok(())
}

/// Centre of frame t's window in seconds.
fn time(t: usize) -> f64 {
    (t * HOP_SAMPLES + FRAME_SAMPLES / 2) as f64 / f64::from(SAMPLE_RATE_HZ)
}

fn npy(args: &Args, converted: &Converted) -> Result<()> {
    npy::write_npy(&args.output, &converted.parameters)
}

fn csv(args: &Args, converted: &Converted) -> Result<()> {
    files::write_whole(&args.output, |file| {
        write!(file, "time_s")?;
        for d in 1..=converted.parameters.ncols() {
            write!(file, ",p{d}")?;
        }
        for viseme in VISEMES {
            write!(file, ",{viseme}")?;
        }
        writeln!(file)?;
        for (t, (values, weights)) in
            std::iter::zip(converted.parameters.rows(), converted.visemes.rows()).enumerate()
        {
            write!(file, "{:.4}", time(t))?;
            for value in values.iter().chain(weights) {
                write!(file, ",{value}")?;
            }
            writeln!(file)?;
        }
        Ok(())
    })
}

fn json(args: &Args, converted: &Converted) -> Result<()> {
    let rows = |array: &ndarray::Array2<f32>| -> Vec<Vec<f32>> {
        array.rows().into_iter().map(|r| r.to_vec()).collect()
    };
    let value = serde_json::json!({
        "rate_hz": SAMPLE_RATE_HZ as usize / HOP_SAMPLES,
        "first_frame_s": time(0),
        "parameters": rows(&converted.parameters),
        "viseme_names": VISEMES,
        "viseme_weights": rows(&converted.visemes),
    });
    files::write_whole(&args.output, |file| {
        serde_json::to_writer(&mut *file, &value)?;
        Ok(writeln!(file)?)
    })
}
