//! `lipstream evaluate`: measures models on a feature folder.
use std::path::PathBuf;

use anyhow::{Result, bail};

use crate::audio;
use crate::engine::{Engine, RunSettings};
use crate::evaluate::ridge::RidgeMap;
use crate::evaluate::{self, Row};
use crate::export::{ExportSettings, export};
use crate::features::{FeatureFolder, Split};
use crate::files;
use crate::hmm::convert::{Follower, Lag, convert_with};
use crate::model::Model;

/// Measure models on a feature folder: AMSE and ACC of each system
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Feature folder with video (made by `lipstream prepare`)
    dir: PathBuf,
    /// Model to measure, beside the mean and ridge regression
    #[arg(short, long, value_name = "MODEL.safetensors")]
    model: PathBuf,
    /// Clips to measure on
    #[arg(long, default_value = "test")]
    split: SplitName,
    /// Markdown table to write (it is printed as well)
    #[arg(short, long, value_name = "REPORT.md")]
    output: Option<PathBuf>,
    /// Width of the device's beam in bits [default: the exported one]
    #[arg(long)]
    beam: Option<f64>,
    /// Print JSON instead of the table
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum SplitName {
    Train,
    Val,
    Test,
}

impl SplitName {
    fn name(self) -> &'static str {
        match self {
            SplitName::Train => "training",
            SplitName::Val => "validation",
            SplitName::Test => "test",
        }
    }
}

/// The last part of a path: a report is read on other machines.
fn short(path: &std::path::Path) -> String {
    path.file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

impl From<SplitName> for Split {
    fn from(name: SplitName) -> Split {
        match name {
            SplitName::Train => Split::Train,
            SplitName::Val => Split::Val,
            SplitName::Test => Split::Test,
        }
    }
}

pub(crate) fn run(args: Args) -> Result<()> {
    let folder = FeatureFolder::open(&args.dir)?;
    let model = Model::read(&args.model)?;
    let split = Split::from(args.split);
    let rows = measure(&folder, &model, split, args.beam)?;
    let table = evaluate::markdown(&rows);
    if args.json {
        println!("{}", evaluate::json(&rows)?);
    } else {
        print!("{table}");
    }
    if let Some(path) = &args.output {
        let clips = folder.split(split).filter(|c| c.video_frames > 0).count();
        let report = format!(
            "# AMSE and ACC\n\n`lipstream evaluate {} -m {}`: {clips} {} clips at 100 Hz. {}\n\n{table}",
            short(&args.dir),
            short(&args.model),
            args.split.name(),
            model.provenance
        );
        files::write_bytes(path, report.as_bytes())?;
    }
    Ok(())
}

fn measure(folder: &FeatureFolder, model: &Model, split: Split, beam_bits: Option<f64>) -> Result<Vec<Row>> {
    let truths = evaluate::truths(folder, split)?;
    if truths.is_empty() {
        bail!("{} has no clip with video in this split", folder.root.display());
    }
    if model.visual_size() != folder.manifest.visual_size {
        bail!(
            "the model speaks {} mouth parameters, {} holds {}",
            model.visual_size(),
            folder.root.display(),
            folder.manifest.visual_size
        );
    }
    let train = evaluate::truths(folder, Split::Train)?;
    let validation = evaluate::truths(folder, Split::Val)?;
    let wide = RidgeMap::fit(&train, &validation, (-20..=20).collect())?;
    let live = RidgeMap::fit(&train, &validation, (-30..=8).step_by(2).collect())?;
    let follower = Follower::of_model(model);
    let device = Engine::fixed(export(model, &ExportSettings::of(model))?.bytes)?;
    let with = RunSettings {
        beam_bits,
        ..RunSettings::default()
    };
    let lag = model.following.lag;
    let ahead = model.look_ahead_ms();
    Ok(vec![
        evaluate::score("mean", Some(0), &truths, |t| {
            Ok(ndarray::Array2::zeros((t.visual.nrows(), t.visual.ncols())))
        })?,
        evaluate::score("ridge, ±200 ms", Some(200), &truths, |t| {
            Ok(wide.predict(&t.audio))
        })?,
        evaluate::score("ridge, −300…80 ms", Some(80), &truths, |t| {
            Ok(live.predict(&t.audio))
        })?,
        evaluate::score("ph-vi-chmm + local linear, float", None, &truths, |t| {
            Ok(convert_with(&follower, model, &t.audio, Lag::Whole)?.0)
        })?,
        evaluate::score(
            "ph-vi-chmm + local linear, float, fixed lag",
            Some(ahead),
            &truths,
            |t| Ok(convert_with(&follower, model, &t.audio, Lag::Frames(lag))?.0),
        )?,
        evaluate::score(
            "ph-vi-chmm + local linear, fixed point, beam and lag",
            Some(ahead),
            &truths,
            |t| {
                let sound = audio::read(&folder.wav_path(&t.clip.id))?;
                Ok(device.convert(&sound.samples, &with)?.parameters)
            },
        )?,
    ])
}
