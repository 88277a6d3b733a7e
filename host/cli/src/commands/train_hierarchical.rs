//! `lipstream train --system hierarchical`: landmarks and videos to the second paper's face.
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use lipstream::kinds::hierarchical::Choice;
use lipstream::kinds::hierarchical::Tree;
use lipstream::kinds::hierarchical::guide::Teacher;
use lipstream::progress::Progress as _;
use lipstream::tensors::Tensors;
use lipstream_make::features::FeatureFolder;
use lipstream_make::hierarchical::maps::Trial;
use lipstream_make::hierarchical::{self, Landmarks, Settings};
use lipstream_media::files;

use super::choices::ClusterChoice;
use crate::progress::Terminal;

/// Options that are of coupled HMMs and of what is grown from them.
pub(super) const OF_HMMS: [&str; 12] = [
    "audio",
    "audio_mixtures",
    "visual_mixtures",
    "iterations",
    "viterbi_start",
    "lag",
    "clips",
    "method",
    "from",
    "state",
    "sound_only",
    "without",
];

/// `speech::OWN_TAPS` in words.
const OWN_TAPS: [&str; 4] = ["-1", "0", "1", "2"];

/// What `--system hierarchical` asks for
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "With --system hierarchical")]
#[group(skip)]
pub(crate) struct Args {
    /// Landmarks of every picture: a folder with ID.npy for each clip, f32 [pictures, landmarks, 2] in pixels, or an .npz with `clips` and `points_x32`
    #[arg(long, value_name = "FILE", conflicts_with_all = OF_HMMS)]
    landmarks: Option<PathBuf>,
    /// Folder with the clips' videos [default: the one that was prepared]
    #[arg(long, value_name = "DIR", requires = "landmarks")]
    videos: Option<PathBuf>,
    /// Areas of the face, parents first: {"areas": [{"name": "face"}, {"name": "mouth", "parent": "face", "landmarks": [0, 1, …]}]} [default: face and mouth]
    #[arg(long, value_name = "FILE.json", requires = "landmarks")]
    tree: Option<PathBuf>,
    /// Model (.safetensors, recurrent or likelihood-trained) that may choose the clusters of pictures (`render --choice`, `evaluate --choice`); it goes into the file
    #[arg(long, value_name = "MODEL", requires = "landmarks")]
    guide: Option<PathBuf>,
    /// Hear the device's front end, as `export` needs it, at hops around the beginning of each picture, in place of the paper's window of 40 ms [hops: -1,0,1,2]
    #[arg(long, value_name = "HOPS", requires = "landmarks", value_delimiter = ',', num_args = 0.., require_equals = true, default_missing_values = OWN_TAPS)]
    for_device: Option<Vec<i8>>,
    /// Training pictures, about, evenly from all clips
    #[arg(long, value_name = "N", requires = "landmarks", default_value_t = Settings::default().pictures)]
    pictures: usize,
    /// Clusters of each area; of several numbers, separated by commas, the validation clips choose
    #[arg(long, value_name = "K", requires = "landmarks", value_delimiter = ',', default_values_t = Settings::default().search.clusters)]
    clusters: Vec<usize>,
    /// Starts of the search for clusters, of which the validation clips choose
    #[arg(long, value_name = "N", requires = "landmarks", default_value_t = Settings::default().search.starts)]
    starts: usize,
}

impl Args {
    /// Whether anything of it was asked for.
    pub(super) fn is_asked(&self) -> bool {
        self.landmarks.is_some()
    }
}

pub(super) fn run(args: &Args, folder: &FeatureFolder, seed: u64, output: &Path) -> Result<()> {
    let Some(landmarks) = &args.landmarks else {
        bail!("a hierarchical model is made of landmarks: say with --landmarks where they are");
    };
    if args.pictures == 0 || args.starts == 0 || args.clusters.contains(&0) {
        bail!("--pictures, --clusters and --starts are 1 at least");
    }
    let mut settings = Settings {
        videos: args.videos.clone(),
        tree: args.tree.as_deref().map(tree).transpose()?,
        taps: args.for_device.clone(),
        teacher: args.guide.as_deref().map(teacher).transpose()?,
        pictures: args.pictures,
        ..Settings::default()
    };
    settings.search.clusters.clone_from(&args.clusters);
    settings.search.starts = args.starts;
    settings.search.seed = seed;
    let terminal = Terminal::default();
    let trained = hierarchical::train(folder, &Landmarks::read(landmarks)?, &settings, &terminal)?;
    for (area, trials) in &trained.trials {
        for line in table(trials, &args.clusters) {
            terminal.say(&format!("{area}: {line}"));
        }
    }
    for (area, tried) in &trained.guided {
        for tried in tried {
            terminal.say(&format!(
                "{area}: chosen by {}, the own sound counting {}: error {:.4}",
                choice_name(tried.choice),
                tried.own,
                tried.error
            ));
        }
    }
    Ok(trained.model.write(output)?)
}

fn teacher(path: &Path) -> Result<Teacher> {
    let file = Tensors::read(path)?;
    Teacher::of_tensors(file).with_context(|| format!("{} cannot choose clusters", path.display()))
}

fn choice_name(choice: Choice) -> String {
    let word = clap::ValueEnum::to_possible_value(&ClusterChoice::from(choice));
    word.map_or_else(String::new, |word| word.get_name().to_owned())
}

fn tree(path: &Path) -> Result<Tree> {
    let bytes = files::read_bytes(path)?;
    serde_json::from_slice(&bytes).with_context(|| format!("{} is no tree of areas", path.display()))
}

/// For each number of clusters the best error over numbers of components, of the best and the worst start.
fn table(trials: &[Trial], clusters: &[usize]) -> Vec<String> {
    let line = |k: &usize| {
        let of_start = |start: usize| {
            let of_both = trials.iter().filter(|t| t.clusters == *k && t.start == start);
            of_both.min_by(|a, b| a.error.total_cmp(&b.error))
        };
        let mut best: Vec<&Trial> = (0..).map_while(of_start).collect();
        best.sort_by(|a, b| a.error.total_cmp(&b.error));
        let (first, last) = (best.first()?, best.last()?);
        Some(format!(
            "{k} clusters: error {:.4} with {} components, {:.4} from the worst of {} starts",
            first.error,
            first.modes,
            last.error,
            best.len()
        ))
    };
    clusters.iter().filter_map(line).collect()
}
