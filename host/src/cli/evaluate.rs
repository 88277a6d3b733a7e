//! `lipstream evaluate`: measures models on a feature folder.
use std::path::PathBuf;

use anyhow::{Result, bail};

use crate::evaluate::ridge::RidgeMap;
use crate::evaluate::{self, Row};
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
    let rows = measure(&folder, &model, split)?;
    let table = evaluate::markdown(&rows);
    if args.json {
        println!("{}", evaluate::json(&rows)?);
    } else {
        print!("{table}");
    }
    if let Some(path) = &args.output {
        files::write_bytes(path, table.as_bytes())?;
    }
    Ok(())
}

fn measure(folder: &FeatureFolder, model: &Model, split: Split) -> Result<Vec<Row>> {
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
    ])
}
