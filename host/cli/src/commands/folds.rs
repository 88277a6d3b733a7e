//! `lipstream folds`: feature folders in whose training clips some words are never said.
use std::path::PathBuf;

use anyhow::Result;
use lipstream_make::features::FeatureFolder;
use lipstream_make::folds::{self, Fold, FoldSettings};
use serde_json::{Value, json};

use super::answer::{self, Answer};

/// Hold out words: feature folders whose training clips never say some of the words, to measure a system on words that it has not learnt
///
/// Train on OUT/words-1/FEATURES and so on (and, to tell missing words from missing clips, on OUT/size-1/FEATURES: as many clips of all words), each model
/// into the folder `models` beside it, then `lipstream evaluate FEATURES --held-out OUT`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Feature folder with video whose words are held out; then folders of sound that loses clips with these words too
    #[arg(required = true)]
    features: Vec<PathBuf>,
    /// Folder to write
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Number of folds
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u16).range(1..=100))]
    folds: u16,
    /// Greatest share of the training clips that a fold may lose
    #[arg(long, default_value_t = 0.4)]
    most: f64,
    /// Seed of what is drawn
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    answer: Answer,
}

pub(crate) fn run(args: Args) -> Result<()> {
    let folders = args.features.iter().map(|path| FeatureFolder::open(path));
    let folders = folders.collect::<Result<Vec<_>, _>>()?;
    folders[0].of_eigenmouths()?;
    let settings = FoldSettings {
        folds: args.folds.into(),
        most: args.most,
        seed: args.seed,
    };
    let folds = folds::draw(&folders[0], &settings)?;
    folds::write(&folds, &folders, &args.output)?;
    if args.answer.json {
        let of_fold = |fold: &Fold| json!({ "training_clips": fold.left, "without": fold.words });
        let told: Vec<Value> = folds.folds.iter().map(of_fold).collect();
        println!(
            "{}",
            json!({ "output": answer::path(&args.output), "folds": told })
        );
    }
    for (n, fold) in folds.folds.iter().enumerate().filter(|_| !args.answer.json) {
        println!(
            "fold {}: {} training clips without {}",
            n + 1,
            fold.left,
            fold.words.join(" ")
        );
    }
    for folder in &folders[1..] {
        let clips = &folder.manifest.clips;
        let wordless = clips.iter().filter(|clip| clip.words.is_empty()).count();
        if wordless > 0 {
            eprintln!(
                "{}: {wordless} of {} clips tell no words: they are in every fold, whatever they say",
                folder.name(),
                clips.len()
            );
        }
    }
    Ok(())
}
