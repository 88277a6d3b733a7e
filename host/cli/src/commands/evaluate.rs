//! `lipstream evaluate`: measures systems on a feature folder.
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};

use super::{choices, evaluate_held_out, evaluate_mouth};
use crate::progress::{Terminal, say};
use lipstream::hmm::system::{Speech, System};
use lipstream::kinds::hierarchical::HierarchicalModel;
use lipstream::kinds::likelihood::Model;
use lipstream::kinds::recurrent::model::RecurrentModel;
use lipstream::mouth::MouthSpace;
use lipstream::progress::Progress;
use lipstream::tensors::Tensors;
use lipstream_make::evaluate::{
    self, Candidate, Destination, EvaluateSettings, Heading, NoiseSettings, exchange, hierarchical,
    look_ahead, models, systems,
};
use lipstream_make::features::FeatureFolder;
use lipstream_make::hierarchical::Landmarks;

/// Options that say how systems are compared: there is nothing to compare one model's mouth with.
const OF_SYSTEMS: [&str; 13] = [
    "systems",
    "models",
    "audio",
    "predictions",
    "also",
    "landmarks",
    "against",
    "noise",
    "noise_system",
    "babble",
    "cold",
    "quick",
    "beam",
];

/// Measure systems on a feature folder: AMSE, ACC, closure, noise, cold starts, with tables and figures
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Feature folder with video (made by `lipstream prepare`); with --strangers a video or a folder of videos
    pub(super) dir: PathBuf,
    /// Measure how well the lip gap of the model [default: the shipped one] follows that of the people in the videos DIR, whom it need not know:
    /// correlation with their landmarks at lag 0, after 30 s of their voice, at the best lag; loudness and chance beside it
    #[arg(long, conflicts_with_all = OF_SYSTEMS)]
    strangers: bool,
    /// Measure how well the model [default: the shipped one] follows every speaker of the feature folder DIR, which needs no video: whether lips close at p, b, m
    /// and nowhere else, and whether visemes are the labels'. All clips, unless --split is given
    #[arg(long, conflicts_with = "strangers", conflicts_with_all = OF_SYSTEMS)]
    voices: bool,
    /// Measure on words that training has never seen said: FOLDS is made by `lipstream folds DIR`, and what is to be measured is trained on each of its folders. `-m` and
    /// `--predictions NAME=FOLDER` name what is trained on all clips; the same file in FOLDS/words-N/models, the folder FOLDS/words-N/predictions/NAME is
    /// that of a fold (of size-N too where it is there). Missing --systems are trained
    #[arg(long, value_name = "FOLDS", conflicts_with_all = ["strangers", "voices", "also", "against", "noise", "noise_system", "babble", "cold", "quick"])]
    pub(super) held_out: Option<PathBuf>,
    /// Model to measure, beside the mean and ridge regression
    #[arg(short, long, value_name = "MODEL.safetensors")]
    pub(super) model: Option<PathBuf>,
    /// Systems of the papers to measure: names separated by commas, `all` of the papers', or `variants` of their HMMs. Those that are not in --models are trained
    #[arg(long, value_name = "NAMES")]
    pub(super) systems: Option<String>,
    /// Folder with the systems' models; what is missing is trained and kept there [default: REPORT/models]
    #[arg(long, value_name = "DIR")]
    pub(super) models: Option<PathBuf>,
    /// Model to measure too, under this name: likelihood-trained, a system that was trained otherwise, or hierarchical (several times)
    #[arg(long, value_name = "NAME=MODEL.safetensors")]
    also: Vec<String>,
    /// What chooses clusters in the hierarchical models of --also; of several, separated by commas, each is a row of its own [default: mahalanobis]
    #[arg(
        long,
        value_name = "CHOICE",
        value_delimiter = ',',
        requires = "also",
        value_enum
    )]
    choice: Vec<choices::ClusterChoice>,
    /// Feature folder whose sound trains the systems too; may be given many times
    #[arg(long, value_name = "DIR", requires = "systems")]
    pub(super) audio: Vec<PathBuf>,
    /// Landmarks of the clips (as `train --landmarks`): compare lip gaps and pictures of all systems too
    #[arg(long, value_name = "FILE")]
    landmarks: Option<PathBuf>,
    /// Predictions made elsewhere: a folder with ID.npy for every clip. NAME@80=FOLDER states a look-ahead of 80 ms
    #[arg(long, value_name = "NAME=FOLDER")]
    pub(super) predictions: Vec<String>,
    /// Clips to measure on [default: test]
    #[arg(long)]
    pub(super) split: Option<choices::Split>,
    /// Report to write: a folder (page, tables and JSON, with noise and cold starts), or a .md, .html or .json file
    #[arg(short, long, value_name = "REPORT")]
    pub(super) output: Option<PathBuf>,
    /// System that the others are compared with [default: ph-vi-chmm]
    #[arg(long, value_name = "NAME")]
    against: Option<String>,
    /// Measure in white noise and babble, 20 to 0 dB
    #[arg(long)]
    noise: bool,
    /// Systems that hear the noise (several times; default: all)
    #[arg(long, value_name = "NAME")]
    noise_system: Vec<String>,
    /// Feature folder whose training clips babble [default: DIR]
    #[arg(long, value_name = "DIR")]
    babble: Option<PathBuf>,
    /// Measure streams that start in mid-clip
    #[arg(long)]
    cold: bool,
    /// Neither noise nor cold starts, also for a folder
    #[arg(long, conflicts_with_all = ["noise", "cold", "noise_system", "babble"])]
    quick: bool,
    /// Resamples of the intervals and tests
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u32).range(100..=1_000_000))]
    pub(super) resamples: u32,
    /// Seed of resamples, noise and starts
    #[arg(long, default_value_t = 1)]
    pub(super) seed: u64,
    /// Width of the device's beam in bits [default: the exported one]
    #[arg(long)]
    pub(super) beam: Option<f64>,
    /// Print JSON instead of the tables
    #[arg(long)]
    pub(super) json: bool,
}

/// The last part of a path: a report is read on other machines.
fn short(path: &Path) -> String {
    path.file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

pub(crate) fn run(args: Args) -> Result<()> {
    if args.strangers || args.voices {
        let asked = evaluate_mouth::Asked {
            path: &args.dir,
            model: args.model.as_deref(),
            output: args.output.as_deref(),
            as_json: args.json,
        };
        return match args.voices {
            true => evaluate_mouth::voices(&asked, args.split.map(Into::into)),
            false => evaluate_mouth::strangers(&asked),
        };
    }
    if let Some(folds) = &args.held_out {
        return evaluate_held_out::run(&args, folds);
    }
    let progress = Terminal::default();
    let destination = args.output.as_deref().map(Destination::of).transpose()?;
    let folder = FeatureFolder::open(&args.dir)?;
    folder.of_eigenmouths()?;
    let full = destination.as_ref().is_some_and(Destination::is_folder) && !args.quick;
    let settings = settings(&args, full)?;
    let store = args.models.clone().or_else(|| {
        let folder = destination.as_ref().filter(|d| d.is_folder());
        folder
            .and(args.output.as_ref())
            .map(|output| output.join("models"))
    });
    let from = Sources {
        model: args.model.as_deref(),
        store: store.as_deref(),
        audio: &args.audio,
    };
    let opened = Opened::of(&folder, args.systems.as_deref(), &from, &progress)?;
    let also = args.also.iter().map(|given| named(given, &folder));
    let also = also.collect::<Result<Vec<_>>>()?;
    let mut candidates = opened.candidates(&folder, args.beam, full)?;
    for (name, model) in &also {
        match model {
            Also::Likelihood(model) => candidates.extend(systems::also(name, model, &folder)?),
            Also::Hierarchical(model) => candidates.extend(by_choice(&args.choice, name, model, &folder)?),
        }
    }
    let (chosen, stored) = (&opened.chosen, &opened.stored);
    if full {
        candidates.extend(look_ahead::curves(&folder, chosen, stored, &progress)?);
        if let Some(trained) = &opened.trained {
            candidates.extend(look_ahead::of_mge(trained, "mge, one model"));
        }
    }
    for given in &args.predictions {
        candidates.push(predictions(given)?);
    }
    let report = evaluate::measure(
        &folder,
        args.split.unwrap_or(choices::Split::Test).into(),
        &candidates,
        &settings,
        &progress,
    )?;
    if args.json {
        print!("{}", evaluate::json(&report)?);
    } else {
        print!("{}", evaluate::markdown(&Heading::default(), &report));
    }
    if let Some(destination) = destination {
        let heading = Heading {
            title: "AMSE and ACC".to_owned(),
            command: command(&args),
            provenance: match (&opened.trained, &opened.model) {
                (Some(trained), _) => trained.provenance.clone(),
                (None, Some(model)) => model.provenance.clone(),
                (None, None) => String::new(),
            },
        };
        for path in destination.write(&heading, &report)? {
            say(&format!("written: {}", path.display()));
        }
    }
    Ok(())
}

/// Where models are, and what systems are trained on beside the folder.
pub(super) struct Sources<'a> {
    pub(super) model: Option<&'a Path>,
    pub(super) store: Option<&'a Path>,
    pub(super) audio: &'a [PathBuf],
}

/// Models that have been read or trained, of which systems are made.
pub(super) struct Opened {
    /// The model to measure, or its parent.
    model: Option<Model>,
    trained: Option<RecurrentModel>,
    /// The papers' systems that are asked for, and their models.
    chosen: Vec<System>,
    stored: Vec<Model>,
}

impl Opened {
    /// The model, and those of the papers' `systems`: read where they are, or trained on `folder` and kept there.
    pub(super) fn of(
        folder: &FeatureFolder,
        systems: Option<&str>,
        from: &Sources,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let (model, trained) = from.model.map(|path| read(path, folder)).transpose()?.unzip();
        let chosen = systems.map(systems::parse).transpose()?.unwrap_or_default();
        let stored = match from.store {
            _ if chosen.is_empty() => Vec::new(),
            None => {
                bail!("say with --models where the systems' models are, or write a report folder with -o")
            }
            Some(store) => {
                let heard = from.audio.iter().map(|path| FeatureFolder::open(path));
                let heard = heard.collect::<Result<Vec<_>, _>>()?;
                systems::open_or_train(&chosen, store, folder, &heard, progress)?
            }
        };
        Ok(Self {
            model,
            trained: trained.flatten(),
            chosen,
            stored,
        })
    }

    /// The mean and ridge regression (its points of quality against look-ahead too with `curves`), the model, and the systems.
    pub(super) fn candidates<'a>(
        &'a self,
        folder: &'a FeatureFolder,
        beam: Option<f64>,
        curves: bool,
    ) -> Result<Vec<Candidate<'a>>> {
        let mut candidates = vec![models::mean(folder.manifest.visual_size)];
        candidates.extend(models::ridge(folder, curves)?);
        if let Some(model) = &self.model {
            candidates.extend(match model.system.speech {
                Speech::LocalLinear => models::of_model(folder, model, beam)?,
                // The device does not speak by means; a system that is measured anyway stands there once.
                _ if self.chosen.contains(&model.system) => Vec::new(),
                _ => systems::candidates(&systems::by_means(model.system), std::slice::from_ref(model))?,
            });
        }
        if let Some(trained) = &self.trained {
            candidates.extend(models::of_mge(folder, trained, beam)?);
        }
        candidates.extend(systems::candidates(&self.chosen, &self.stored)?);
        Ok(candidates)
    }
}

/// A model trained by likelihood; or one trained on its error, after the parent that it came from.
fn read(path: &Path, folder: &FeatureFolder) -> Result<(Model, Option<RecurrentModel>)> {
    let tensors = Tensors::read(path)?;
    has_mouth(&tensors, path, folder)?;
    ensure!(
        !HierarchicalModel::is_kind(&tensors),
        "{} holds a hierarchical model: measure it with --also hierarchical={}",
        path.display(),
        path.display()
    );
    if RecurrentModel::is_kind(&tensors) {
        let trained = RecurrentModel::read(path)?;
        return Ok((trained.parent.clone(), Some(trained)));
    }
    Ok((Model::read(path)?, None))
}

/// Refuses a model that draws another mouth than the folder's, where it draws one.
fn has_mouth(tensors: &Tensors, path: &Path, folder: &FeatureFolder) -> Result<()> {
    if !tensors.has("mouth.mean") {
        return Ok(());
    }
    let space = MouthSpace::load(tensors)?;
    // Another number of parameters has words of its own.
    if space.size() == folder.manifest.visual_size {
        folder
            .has_mouth(&space)
            .with_context(|| path.display().to_string())?;
    }
    Ok(())
}

fn settings(args: &Args, full: bool) -> Result<EvaluateSettings> {
    let wants_noise = full || args.noise || !args.noise_system.is_empty() || args.babble.is_some();
    let noise = wants_noise.then(|| -> Result<NoiseSettings> {
        Ok(NoiseSettings {
            babble: args.babble.as_deref().map(FeatureFolder::open).transpose()?,
            systems: args.noise_system.clone(),
            ..NoiseSettings::default()
        })
    });
    Ok(EvaluateSettings {
        resamples: args.resamples as usize,
        seed: args.seed,
        reference: args.against.clone(),
        noise: noise.transpose()?,
        cold_starts: full || args.cold,
        landmarks: args.landmarks.as_deref().map(Landmarks::read).transpose()?,
    })
}

/// A model that is measured beside the others.
enum Also {
    Likelihood(Box<Model>),
    Hierarchical(Box<HierarchicalModel>),
}

/// A hierarchical model under its name, its clusters chosen by its own sound, and under its name with the choice's otherwise.
fn by_choice<'a>(
    choices: &[choices::ClusterChoice],
    name: &str,
    model: &'a HierarchicalModel,
    folder: &FeatureFolder,
) -> Result<Vec<Candidate<'a>>> {
    let own = [choices::ClusterChoice::Mahalanobis];
    let choices = if choices.is_empty() { &own } else { choices };
    let candidate = |choice: &choices::ClusterChoice| {
        let word = clap::ValueEnum::to_possible_value(choice);
        let name = match (word, *choice == own[0]) {
            (Some(word), false) => format!("{name}, {}", word.get_name()),
            _ => name.to_owned(),
        };
        hierarchical::candidate(&name, model, (*choice).into(), folder).with_context(|| name.clone())
    };
    choices.iter().map(candidate).collect()
}

/// NAME=MODEL.safetensors.
fn named(given: &str, folder: &FeatureFolder) -> Result<(String, Also)> {
    match given.split_once('=') {
        Some((name, path)) if !name.is_empty() => {
            let path = Path::new(path);
            let tensors = Tensors::read(path)?;
            has_mouth(&tensors, path, folder)?;
            let model = match HierarchicalModel::is_kind(&tensors) {
                true => Also::Hierarchical(Box::new(HierarchicalModel::read(path)?)),
                false => Also::Likelihood(Box::new(Model::read(path)?)),
            };
            Ok((name.to_owned(), model))
        }
        _ => bail!("--also {given}: write NAME=MODEL.safetensors"),
    }
}

/// NAME=FOLDER or NAME@MS=FOLDER.
pub(super) fn predictions<'a>(given: &str) -> Result<Candidate<'a>> {
    let Some((name, folder)) = given.split_once('=') else {
        bail!("--predictions {given}: write NAME=FOLDER");
    };
    let (name, ahead) = match name.rsplit_once('@') {
        Some((name, ms)) => {
            let ms = ms.trim_end_matches("ms");
            let ms = ms
                .parse()
                .with_context(|| format!("--predictions {given}: {ms:?} is no number of ms"))?;
            (name, Some(ms))
        }
        None => (name, None),
    };
    ensure!(!name.is_empty(), "--predictions {given}: the name is missing");
    let mut candidate = exchange::predictions(name, Path::new(folder))?;
    candidate.look_ahead_ms = ahead;
    Ok(candidate)
}

/// The command without this machine's paths and without what stands in the report anyway.
fn command(args: &Args) -> String {
    let quoted = |name: &str| {
        let plain = name
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || "-_.@".contains(c));
        if plain {
            name.to_owned()
        } else {
            format!("'{name}'")
        }
    };
    let mut words = vec!["lipstream evaluate".to_owned(), short(&args.dir)];
    if let Some(model) = &args.model {
        words.push(format!("-m {}", short(model)));
    }
    if let Some(systems) = &args.systems {
        words.push(format!("--systems {}", quoted(systems)));
    }
    if let Some(models) = &args.models {
        words.push(format!("--models {}", short(models)));
    }
    for (flag, all) in [("--predictions", &args.predictions), ("--also", &args.also)] {
        for given in all {
            let name = given.split('=').next().unwrap_or_default();
            words.push(format!("{flag} {}=…", quoted(name)));
        }
    }
    if let Some(path) = &args.landmarks {
        words.push(format!("--landmarks {}", short(path)));
    }
    if let Some(name) = &args.against {
        words.push(format!("--against {}", quoted(name)));
    }
    for (flag, given) in [
        ("--noise", args.noise),
        ("--cold", args.cold),
        ("--quick", args.quick),
    ] {
        if given {
            words.push(flag.to_owned());
        }
    }
    for name in &args.noise_system {
        words.push(format!("--noise-system {}", quoted(name)));
    }
    if let Some(folder) = &args.babble {
        words.push(format!("--babble {}", short(folder)));
    }
    if let Some(bits) = args.beam {
        words.push(format!("--beam {bits}"));
    }
    words.join(" ")
}
