//! `lipstream train`: features to a model.
use std::path::PathBuf;

use anyhow::{Context as _, Result};

use crate::features::FeatureFolder;
use crate::hmm::system::{SYSTEMS, System};
use crate::train::{self, Settings};

/// Train a model: a coupled HMM over phones and visemes with local linear visual maps, or another of the papers' systems
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Feature folder with video (made by `lipstream prepare`)
    dir: PathBuf,
    /// Feature folder whose sound trains the audio densities too; may be given many times
    #[arg(long, value_name = "DIR")]
    audio: Vec<PathBuf>,
    /// Model to write
    #[arg(short, long, value_name = "MODEL.safetensors")]
    output: PathBuf,
    /// System to train
    #[arg(long, default_value = Settings::default().system.name, value_parser = system)]
    system: System,
    /// Most Gaussians per audio state, a power of two; the validation clips choose
    #[arg(long, default_value_t = Settings::default().audio_mixtures)]
    audio_mixtures: usize,
    /// Most Gaussians per visual state, a power of two; the validation clips choose
    #[arg(long, default_value_t = Settings::default().visual_mixtures)]
    visual_mixtures: usize,
    /// EM passes after the start and after every split
    #[arg(long, default_value_t = Settings::default().iterations)]
    iterations: usize,
    /// Frames of 10 ms that the choice of states waits, beyond the 40 ms of ΔΔ
    #[arg(long, default_value_t = Settings::default().lag)]
    lag: usize,
    /// Train on so many of the clips with video, drawn by the seed [default: all]
    #[arg(long)]
    clips: Option<usize>,
    /// Seed of what is drawn: clips, and where it is not 0 the directions in which components split
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

fn system(name: &str) -> Result<System> {
    System::from_name(name).with_context(|| {
        let names: Vec<&str> = SYSTEMS.iter().map(|s| s.name).collect();
        format!("there are {}", names.join(", "))
    })
}

pub(crate) fn run(args: Args) -> Result<()> {
    let folder = FeatureFolder::open(&args.dir)?;
    let heard = args
        .audio
        .iter()
        .map(|path| FeatureFolder::open(path))
        .collect::<Result<Vec<_>>>()?;
    let settings = Settings {
        system: args.system,
        audio_mixtures: args.audio_mixtures,
        visual_mixtures: args.visual_mixtures,
        iterations: args.iterations,
        lag: args.lag,
        clips: args.clips,
        seed: args.seed,
        ..Settings::default()
    };
    let begun = std::time::Instant::now();
    let model = train::train(&folder, &heard, &settings, &|line| eprintln!("{line}"))?;
    model.write(&args.output)?;
    eprintln!(
        "wrote {} after {:.0} s",
        args.output.display(),
        begun.elapsed().as_secs_f32()
    );
    Ok(())
}
