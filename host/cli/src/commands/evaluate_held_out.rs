//! `lipstream evaluate FEATURES --held-out FOLDS`: systems on words that their training has never seen said.
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use lipstream_make::evaluate::Candidate;
use lipstream_make::evaluate::held_out::{self, HeldOutSettings, OfFold};
use lipstream_make::features::FeatureFolder;
use lipstream_make::folds::{Folds, Kind, fold_path};

use super::evaluate::{Args, Opened, Sources, predictions};
use super::{choices, evaluate_mouth};
use crate::progress::Terminal;

/// A fold's folder with what was trained on it.
struct Fold {
    path: PathBuf,
    folder: FeatureFolder,
    opened: Opened,
}

pub(super) fn run(args: &Args, at: &Path) -> Result<()> {
    let progress = Terminal::default();
    let output = evaluate_mouth::destination(args.output.as_deref())?;
    let folder = FeatureFolder::open(&args.dir)?;
    folder.of_eigenmouths()?;
    let folds = Folds::open(at)?;
    anyhow::ensure!(
        folds.features == folder.name(),
        "{} holds folds of {}, not of {}",
        at.display(),
        folds.features,
        folder.name()
    );
    let from = Sources {
        model: args.model.as_deref(),
        store: args.models.as_deref(),
        audio: &args.audio,
    };
    let opened = Opened::of(&folder, args.systems.as_deref(), &from, &progress)?;
    let mut all = opened.candidates(&folder, args.beam, false)?;
    for given in &args.predictions {
        all.push(predictions(given)?);
    }
    let fold = |kind: Kind, n: usize| -> Result<Fold> {
        let path = fold_path(at, kind, n);
        let folder = folds.folder(at, kind, n)?;
        let models = path.join("models");
        let model = args
            .model
            .as_deref()
            .and_then(Path::file_name)
            .map(|name| models.join(name));
        let model = match kind {
            Kind::Words => model,
            Kind::Size => model.filter(|model| model.exists()),
        };
        // Sound that `folds` was given too lies beside the folder, without the words.
        let audio = args.audio.iter().map(|dir| {
            let inside = path.join(dir.file_name().unwrap_or_default());
            match inside.exists() {
                true => inside,
                false => dir.clone(),
            }
        });
        let from = Sources {
            model: model.as_deref(),
            store: Some(&models),
            audio: &audio.collect::<Vec<_>>(),
        };
        let opened = Opened::of(&folder, args.systems.as_deref(), &from, &progress).with_context(|| {
            format!(
                "train what is to be measured on {} and put it into {}",
                folder.root.display(),
                models.display()
            )
        })?;
        Ok(Fold { path, folder, opened })
    };
    let pairs = (0..folds.folds.len()).map(|n| Ok((fold(Kind::Words, n)?, fold(Kind::Size, n)?)));
    let pairs = pairs.collect::<Result<Vec<_>>>()?;
    let of_fold = pairs.iter().map(|(words, size)| {
        Ok(OfFold {
            words: words.candidates(args, Kind::Words)?,
            size: size.candidates(args, Kind::Size)?,
        })
    });
    let of_fold = of_fold.collect::<Result<Vec<_>>>()?;
    let settings = HeldOutSettings {
        split: args.split.unwrap_or(choices::Split::Test).into(),
        resamples: args.resamples as usize,
        seed: args.seed,
    };
    let report = held_out::measure(&folder, &folds, &all, &of_fold, settings, &progress)?;
    evaluate_mouth::print_and_write(&report, report.markdown(), args.json, output)
}

impl Fold {
    fn candidates(&self, args: &Args, kind: Kind) -> Result<Vec<Candidate<'_>>> {
        let mut candidates = self.opened.candidates(&self.folder, args.beam, false)?;
        for given in &args.predictions {
            let name = given.split_once('=').map_or(given.as_str(), |(name, _)| name);
            let bare = name.split_once('@').map_or(name, |(bare, _)| bare);
            let from = self.path.join("predictions").join(bare);
            if kind == Kind::Words || from.is_dir() {
                candidates.push(predictions(&format!("{name}={}", from.display()))?);
            }
        }
        Ok(candidates)
    }
}
