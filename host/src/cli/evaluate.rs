//! `lipstream evaluate`: measures systems on a feature folder.
use std::path::{Path, PathBuf};

use anyhow::Result;

use crate::evaluate::{self, Settings, models};
use crate::features::{FeatureFolder, Split};
use crate::files;
use crate::mge::model::MgeModel;
use crate::model::Model;
use crate::tensors::Tensors;

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

/// The last part of a path: a report is read on other machines.
fn short(path: &Path) -> String {
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
    let tensors = Tensors::read(&args.model)?;
    let trained = MgeModel::is_kind(&tensors)
        .then(|| MgeModel::read(&args.model))
        .transpose()?;
    let model = match &trained {
        Some(trained) => trained.twin.clone(),
        None => Model::read(&args.model)?,
    };
    let mut candidates = vec![models::mean(folder.manifest.visual_size)];
    candidates.extend(models::ridge(&folder, false)?);
    candidates.extend(models::of_model(&folder, &model, args.beam)?);
    if let Some(trained) = &trained {
        candidates.push(models::of_mge(&folder, trained)?);
    }
    let report = evaluate::measure(
        &folder,
        args.split.into(),
        &candidates,
        &Settings::default(),
        &|what| eprintln!("{what}"),
    )?;
    let table = evaluate::markdown(&report);
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print!("{table}");
    }
    if let Some(path) = &args.output {
        let text = format!(
            "# AMSE and ACC\n\n`lipstream evaluate {} -m {}`: {}\n\n{table}",
            short(&args.dir),
            short(&args.model),
            trained.as_ref().map_or(&model.provenance, |t| &t.provenance)
        );
        files::write_bytes(path, text.as_bytes())?;
    }
    Ok(())
}
