//! `lipstream train start|accumulate|merge`: joint EM in pieces, for a corpus that outgrows one machine.
use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};

use super::answer::{self, Answer, Done};
use super::train::system;
use crate::progress::Terminal;
use lipstream::hmm::system::System;
use lipstream_make::features::FeatureFolder;
use lipstream_make::train::TrainSettings;
use lipstream_make::train::shards::{self, Splitting};
use serde_json::json;

/// EM in pieces.
#[derive(Debug, clap::Subcommand)]
pub(crate) enum Shards {
    Start(Start),
    Accumulate(Accumulate),
    Merge(Merge),
}

/// Write the state before the first EM pass
#[derive(Debug, clap::Args)]
pub(crate) struct Start {
    /// Feature folder with video (made by `lipstream prepare`)
    dir: PathBuf,
    /// Feature folder whose sound will train the audio densities too; may be given many times
    #[arg(long, value_name = "DIR")]
    audio: Vec<PathBuf>,
    /// System to train
    #[arg(long, default_value = TrainSettings::default().system.name, value_parser = system)]
    system: System,
    /// State to write
    #[arg(short, long, value_name = "STATE")]
    output: PathBuf,
    #[command(flatten)]
    answer: Answer,
}

/// Sum one EM pass over a share of the clips
#[derive(Debug, clap::Args)]
pub(crate) struct Accumulate {
    /// Feature folder with video
    dir: PathBuf,
    /// Which share: 3/8 is the third of eight
    #[arg(long, value_name = "I/N", value_parser = shard)]
    shard: (usize, usize),
    /// State of training, from `start` or `merge`
    #[arg(short, long, value_name = "STATE")]
    model: PathBuf,
    /// Sums to write
    #[arg(short, long, value_name = "SUMS")]
    output: PathBuf,
    #[command(flatten)]
    answer: Answer,
}

/// Add the sums of all shards and write the next state
#[derive(Debug, clap::Args)]
pub(crate) struct Merge {
    /// Sums of every shard, in any order
    #[arg(required = true)]
    sums: Vec<PathBuf>,
    /// State that the sums were made with
    #[arg(short, long, value_name = "STATE")]
    model: PathBuf,
    /// State to write; may be the same file
    #[arg(short, long, value_name = "STATE")]
    output: PathBuf,
    /// Double the Gaussians of every state that has enough frames
    #[arg(long)]
    split: bool,
    /// Most Gaussians per audio state when splitting
    #[arg(long, default_value_t = TrainSettings::default().audio_mixtures)]
    audio_mixtures: usize,
    /// Most Gaussians per visual state when splitting
    #[arg(long, default_value_t = TrainSettings::default().visual_mixtures)]
    visual_mixtures: usize,
    #[command(flatten)]
    answer: Answer,
}

fn shard(text: &str) -> Result<(usize, usize)> {
    let (shard, of) = text
        .split_once('/')
        .context("write it as 3/8, the third of eight")?;
    let (shard, of): (usize, usize) = (shard.parse()?, of.parse()?);
    if shard == 0 || shard > of {
        bail!("shards go from 1/{of} to {of}/{of}");
    }
    Ok((shard, of))
}

pub(crate) fn run(command: Shards) -> Result<()> {
    let progress = Terminal::default();
    match command {
        Shards::Start(args) => {
            let folder = FeatureFolder::open(&args.dir)?;
            let others = args
                .audio
                .iter()
                .map(|path| FeatureFolder::open(path))
                .collect::<Result<Vec<_>, _>>()?;
            shards::start(&folder, &others, args.system, &progress)?.write(&args.output)?;
            let done = Done::new(
                format!("wrote {}", args.output.display()),
                json!({ "output": answer::path(&args.output) }),
            );
            args.answer.note(&done);
        }
        Shards::Accumulate(args) => {
            let folder = FeatureFolder::open(&args.dir)?;
            let sums = shards::accumulate_files(&folder, &args.model, args.shard, &args.output, &progress)?;
            let done = Done::new(
                format!(
                    "wrote {}: {} frames, log likelihood {:.4} a frame, {} clips without a path",
                    args.output.display(),
                    sums.frames,
                    sums.per_frame(),
                    sums.failed.len()
                ),
                json!({
                    "output": answer::path(&args.output),
                    "frames": sums.frames,
                    "log_likelihood": sums.per_frame(),
                    "clips_without_a_path": sums.failed.len(),
                }),
            );
            args.answer.note(&done);
        }
        Shards::Merge(args) => {
            let split = args.split.then_some(Splitting {
                audio_mixtures: args.audio_mixtures,
                visual_mixtures: args.visual_mixtures,
            });
            let (state, sums) = shards::merge(&args.model, &args.sums, split)?;
            state.write(&args.output)?;
            let done = Done::new(
                format!(
                    "pass {}: log likelihood {:.4} a frame over {} frames; wrote {}",
                    state.passes,
                    sums.per_frame(),
                    sums.frames,
                    args.output.display()
                ),
                json!({
                    "output": answer::path(&args.output),
                    "pass": state.passes,
                    "frames": sums.frames,
                    "log_likelihood": sums.per_frame(),
                }),
            );
            args.answer.note(&done);
        }
    }
    Ok(())
}
