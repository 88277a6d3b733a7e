//! `lipstream train`: features to a model.
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result, bail};

use super::answer::{self, Answer, Done};
use super::train_hierarchical;
use super::train_mge;
use super::train_shards::{self, Shards};
use crate::progress::Terminal;
use lipstream::engine::FloatModel;
use lipstream::hmm::system::{SYSTEMS, System};
use lipstream::kinds::hierarchical;
use lipstream_core::model::container::checksum;
use lipstream_make::align;
use lipstream_make::features::FeatureFolder;
use lipstream_make::train::adapt::adapt;
use lipstream_make::train::resume::Resume;
use lipstream_make::train::state::State;
use lipstream_make::train::{self, TrainSettings, shards};
use lipstream_media::files;
use serde_json::json;

/// `lipstream train`, whole or in pieces.
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub(crate) struct Train {
    #[command(subcommand)]
    pieces: Option<Shards>,
    #[command(flatten)]
    whole: Args,
}

/// Train a model: a coupled HMM over phones and visemes with local linear visual maps, or another of the papers' systems
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Feature folder with video (made by `lipstream prepare`)
    #[arg(required = true)]
    dir: Option<PathBuf>,
    /// Feature folder whose sound trains the audio densities too; may be given many times
    #[arg(long, value_name = "DIR")]
    audio: Vec<PathBuf>,
    /// Model to write
    #[arg(short, long, value_name = "MODEL.safetensors", required = true)]
    output: Option<PathBuf>,
    /// System to train: one of the coupled HMMs' names, or hierarchical, the second paper's face [default: local-linear, or what --from holds]
    #[arg(long, value_parser = asked)]
    system: Option<Asked>,
    /// Most Gaussians per audio state, a power of two; the validation clips choose [default: 4 for local-linear, which the device
    /// runs, and with --sound-only; else until they say stop]
    #[arg(long, value_name = "K")]
    audio_mixtures: Option<usize>,
    /// Most Gaussians per visual state, a power of two; the validation clips choose [default: 2 for local-linear, else until they
    /// say stop]
    #[arg(long, value_name = "K")]
    visual_mixtures: Option<usize>,
    /// EM passes after the start and after every split
    #[arg(long, default_value_t = TrainSettings::default().iterations)]
    iterations: usize,
    /// Before the first EM pass, as many passes that count the best path alone
    #[arg(long, conflicts_with_all = ["sound_only", "state", "from"])]
    viterbi_start: bool,
    /// Frames of 10 ms that the choice of states waits, beyond the 40 ms of ΔΔ
    #[arg(long, default_value_t = TrainSettings::default().lag)]
    lag: usize,
    /// Train on so many of the clips with video, drawn by the seed [default: all]
    #[arg(long)]
    clips: Option<usize>,
    /// Seed of what is drawn: clips, where it is not 0 the directions in which components split, and all that
    /// `--train mge` draws
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// How: by likelihood as in the papers, or from there on by the error of the mouth (minimum generation error)
    #[arg(long = "train", value_enum, default_value_t = Method::Likelihood)]
    method: Method,
    /// Model to start from. By likelihood: it goes on hearing as it does and gets the mouth of the clips, whose phones must be known or
    /// recognised. With `--train mge`: a model trained by likelihood goes on being trained [default: it is trained first]; one trained on
    /// the error of its mouth, such as the shipped one, goes on hearing as it does and gets the new mouth, and no phones are asked for.
    /// A minute of video or two are enough for a new mouth
    #[arg(long, value_name = "MODEL.safetensors", conflicts_with = "state")]
    from: Option<PathBuf>,
    #[command(flatten)]
    mge: train_mge::Args,
    /// Continue from where `lipstream train merge` has brought the first stage, in place of joint EM
    #[arg(long, value_name = "STATE")]
    state: Option<PathBuf>,
    /// Train an audio HMM for `lipstream align`, from sound and labels alone
    #[arg(long, conflicts_with_all = ["audio", "visual_mixtures", "lag"])]
    sound_only: bool,
    /// Training speakers to leave out, separated by commas
    #[arg(long, value_name = "NAMES", value_delimiter = ',', requires = "sound_only")]
    without: Vec<String>,
    /// Frames of 5 ms that a phone may reach beyond its label
    #[arg(long, value_name = "N", requires = "sound_only")]
    tolerance: Option<usize>,
    #[command(flatten)]
    hierarchical: train_hierarchical::Args,
    #[command(flatten)]
    answer: Answer,
}

/// What training minimises.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Method {
    Likelihood,
    Mge,
}

/// The system that is asked for.
#[derive(Clone, Copy, Debug)]
enum Asked {
    /// A system of HMMs.
    Hmm(System),
    /// The second paper's.
    Hierarchical,
}

fn asked(name: &str) -> Result<Asked> {
    if name == hierarchical::KIND {
        return Ok(Asked::Hierarchical);
    }
    match system(name) {
        Ok(system) => Ok(Asked::Hmm(system)),
        Err(error) => bail!("{error}, {}", hierarchical::KIND),
    }
}

pub(super) fn system(name: &str) -> Result<System> {
    System::from_name(name).with_context(|| {
        let names: Vec<&str> = SYSTEMS.iter().map(|s| s.name).collect();
        format!("there are {}", names.join(", "))
    })
}

pub(crate) fn run(args: Train) -> Result<()> {
    match args.pieces {
        Some(pieces) => train_shards::run(pieces),
        None => whole(args.whole),
    }
}

fn whole(args: Args) -> Result<()> {
    // Only with start, accumulate or merge are they not there.
    let (Some(dir), Some(output)) = (&args.dir, &args.output) else {
        bail!("give a feature folder and --output");
    };
    let folder = FeatureFolder::open(dir)?;
    folder.of_eigenmouths()?;
    if args.sound_only {
        return sound_only(&folder, &args, output);
    }
    let system = match args.system {
        Some(Asked::Hierarchical) => {
            return hierarchical(&args, &folder, output);
        }
        Some(Asked::Hmm(system)) => Some(system),
        None => None,
    };
    if args.hierarchical.is_asked() {
        bail!("--landmarks goes with --system {}", hierarchical::KIND);
    }
    let heard = args
        .audio
        .iter()
        .map(|path| FeatureFolder::open(path))
        .collect::<Result<Vec<_>, _>>()?;
    let usual = TrainSettings::of(system.unwrap_or(TrainSettings::default().system));
    let mut settings = TrainSettings {
        audio_mixtures: args.audio_mixtures.unwrap_or(usual.audio_mixtures),
        visual_mixtures: args.visual_mixtures.unwrap_or(usual.visual_mixtures),
        iterations: args.iterations,
        viterbi_start: args.viterbi_start,
        lag: args.lag,
        clips: args.clips,
        seed: args.seed,
        ..usual
    };
    let mut state_checksum = 0;
    if let Some(path) = &args.state {
        let (state, checksum) = State::read(path)?;
        (settings.state, state_checksum) = (Some(state), checksum);
    }
    let from = args.from.as_deref().map(FloatModel::read).transpose()?;
    let adapts = matches!(
        (args.method, &from),
        (Method::Likelihood, Some(_)) | (Method::Mge, Some(FloatModel::Recurrent(_)))
    ) && !args.mge.adds_memory();
    if adapts && !heard.is_empty() {
        bail!("a model that is adapted goes on hearing as it does: leave out --audio");
    }
    if args.method == Method::Likelihood || from.is_none() {
        let run = this_run(&folder, &heard, &settings)?;
        let from = match &args.from {
            Some(path) => checksum(&files::read_bytes(path)?),
            None => 0,
        };
        settings.resume = Resume::beside(output, &format!("{run}{state_checksum:08x} {from:08x}\n"))?;
    }
    let begun = Instant::now();
    let terminal = Terminal::default();
    let by_likelihood = || train::train(&folder, &heard, &settings, &terminal);
    match (args.method, from) {
        (Method::Likelihood, None) => by_likelihood()?.write(output)?,
        (Method::Likelihood, Some(from)) => {
            let from = match from {
                FloatModel::Likelihood(model) => *model,
                // What it was trained from: the same ears, by likelihood.
                FloatModel::Recurrent(model) => model.parent,
            };
            if let Some(asked) = system.filter(|asked| *asked != from.system) {
                bail!(
                    "{} is to be trained, the model that is adapted is {}: leave out --system",
                    asked.name,
                    from.system.name
                );
            }
            adapt(&folder, &from, &settings, &terminal)?.write(output)?;
        }
        (Method::Mge, from) => {
            let from = match from {
                None => train_mge::Start::Likelihood(Box::new(by_likelihood()?)),
                Some(FloatModel::Likelihood(parent)) => train_mge::Start::Likelihood(parent),
                Some(FloatModel::Recurrent(model)) => train_mge::Start::Recurrent(model),
            };
            train_mge::run(&args.mge, &folder, heard, &from, args.clips, args.seed, output)?;
        }
    }
    settings.resume.finish()?;
    wrote(args.answer, output, begun);
    Ok(())
}

fn wrote(answer: Answer, output: &Path, begun: Instant) {
    let seconds = begun.elapsed().as_secs_f32();
    let done = Done::new(
        format!("wrote {} after {seconds:.0} s", output.display()),
        json!({ "output": answer::path(output), "seconds": seconds }),
    );
    answer.note(&done);
}

fn hierarchical(args: &Args, folder: &FeatureFolder, output: &Path) -> Result<()> {
    let begun = Instant::now();
    train_hierarchical::run(&args.hierarchical, folder, args.seed, output)?;
    wrote(args.answer, output, begun);
    Ok(())
}

/// What makes a run this run: the program, the settings, the data.
fn this_run(folder: &FeatureFolder, heard: &[FeatureFolder], settings: &TrainSettings) -> Result<String> {
    let mut run = format!("{} {settings:?}\n", env!("CARGO_PKG_VERSION"));
    for folder in std::iter::once(folder).chain(heard) {
        run += &format!("{:08x}\n", shards::corpus(folder)?);
    }
    Ok(run)
}

fn sound_only(folder: &FeatureFolder, args: &Args, output: &Path) -> Result<()> {
    let begun = Instant::now();
    let usual = align::train::AudioHmmSettings::default();
    let settings = align::train::AudioHmmSettings {
        mixtures: args.audio_mixtures.unwrap_or(usual.mixtures),
        iterations: args.iterations,
        tolerance: args.tolerance.or(usual.tolerance),
        without: args.without.clone(),
    };
    align::train::train(folder, &settings, output.parent(), &Terminal::default())?.write(output)?;
    wrote(args.answer, output, begun);
    Ok(())
}
