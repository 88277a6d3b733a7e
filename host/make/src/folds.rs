//! Held-out words: feature folders in whose training clips a set of words is never said.
//!
//! A corpus of few words flatters a model that learns them by heart. A *fold* is a set of words and what is left of the training and validation
//! clips without them; beside it lies a fold of *the same size*, as many clips drawn from all, so that fewer clips are not taken for missing words.
//!
//! ```text
//! OUT/folds.json                 Folds
//! OUT/words-1/FOLDER/…           a feature folder: no training and no validation clip says a word of fold 1
//! OUT/size-1/FOLDER/…            a feature folder: as many clips of each split, drawn from all
//! ```
//!
//! Files are links to those of the folder that they come from (copies where links cannot be); test clips are all there.
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use rand::seq::SliceRandom as _;
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use crate::error::{Context as _, Error, Result, ensure};
use crate::features::{Clip, FeatureFolder, Split};
use lipstream_media::files;

/// What `folds.json` says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Folds {
    /// Name of the folder whose words are held out.
    pub features: String,
    /// Greatest share of its training clips that a fold may lose.
    pub most: f64,
    /// Seed by which words and clips were drawn.
    pub seed: u64,
    /// The words of each fold.
    pub folds: Vec<Fold>,
}

/// The words of one fold.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fold {
    /// In lower case, in the order of the alphabet; no word is in two folds.
    pub words: Vec<String>,
    /// Training clips with video that say none of them.
    pub left: usize,
}

/// How folds are drawn.
#[derive(Clone, Copy, Debug)]
pub struct FoldSettings {
    /// Number of folds.
    pub folds: usize,
    /// Greatest share of the training clips that a fold may lose, between 0 and 1.
    pub most: f64,
    /// Of words and clips.
    pub seed: u64,
}

impl Fold {
    /// Whether the clip says one of the words.
    pub fn is_said_in(&self, clip: &Clip) -> bool {
        said(clip).any(|word| self.words.contains(&word))
    }

    /// Frames of 10 ms in which the clip says one of the words.
    pub fn frames(&self, clip: &Clip) -> Vec<usize> {
        let hops = |s: f32| (s * 100.0).round().max(0.0) as usize;
        let words = clip.words.iter().filter(|w| self.words.contains(&lower(&w.text)));
        let spans = words.filter_map(|word| word.time);
        let frames: BTreeSet<usize> = spans
            .flat_map(|(start, end)| hops(start)..hops(end).min(clip.audio_frames))
            .collect();
        frames.into_iter().collect()
    }
}

fn lower(text: &str) -> String {
    text.to_lowercase()
}

fn said(clip: &Clip) -> impl Iterator<Item = String> {
    clip.words.iter().map(|word| lower(&word.text))
}

/// Draws the folds: words come in random order, and each joins the first fold that does not lose too many clips by it. A word that fits into
/// none is held out by none.
///
/// # Errors
///
/// [`Error::Choice`] for a share that is none, [`Error::Data`] where no clip has words with times, or a fold stays empty.
pub fn draw(folder: &FeatureFolder, settings: &FoldSettings) -> Result<Folds> {
    ensure!(
        settings.folds > 0 && settings.most > 0.0 && settings.most < 1.0,
        Choice,
        "{} folds that lose {} of the clips: give 1 or more, and a share between 0 and 1",
        settings.folds,
        settings.most
    );
    let train: Vec<&Clip> = folder
        .split(Split::Train)
        .filter(|clip| clip.video_frames > 0)
        .collect();
    let tested: BTreeSet<String> = folder
        .split(Split::Test)
        .flat_map(|clip| &clip.words)
        .filter(|word| word.time.is_some())
        .map(|word| lower(&word.text))
        .collect();
    ensure!(
        !tested.is_empty() && !train.is_empty(),
        Data,
        "{}: no test clip has words with times, or no training clip has video: there are no words to hold out",
        folder.root.display()
    );
    // Clips by the words that they say.
    let mut clips: BTreeMap<String, BTreeSet<usize>> = BTreeMap::new();
    for (n, clip) in train.iter().enumerate() {
        for word in said(clip).filter(|word| tested.contains(word)) {
            clips.entry(word).or_default().insert(n);
        }
    }
    let mut words: Vec<&String> = clips.keys().collect();
    words.shuffle(&mut Pcg64::seed_from_u64(settings.seed));
    let most = (settings.most * train.len() as f64) as usize;
    let mut drawn: Vec<(Vec<String>, BTreeSet<usize>)> = vec![Default::default(); settings.folds];
    for word in words {
        let fits = |lost: &BTreeSet<usize>| lost.union(&clips[word]).count() <= most;
        // The fold that has lost least so far: folds are of like size.
        let fold = drawn
            .iter_mut()
            .filter(|(_, lost)| fits(lost))
            .min_by_key(|(_, lost)| lost.len());
        if let Some((held, lost)) = fold {
            held.push(word.clone());
            lost.extend(&clips[word]);
        }
    }
    let folds = drawn.into_iter().map(|(mut words, lost)| {
        words.sort();
        Fold {
            words,
            left: train.len() - lost.len(),
        }
    });
    let folds: Vec<Fold> = folds.collect();
    ensure!(
        folds.iter().all(|fold| !fold.words.is_empty()),
        Data,
        "{}: every word is said in more than {} of {} training clips: let folds lose more of them",
        folder.root.display(),
        most,
        train.len()
    );
    Ok(Folds {
        features: folder.name(),
        most: settings.most,
        seed: settings.seed,
        folds,
    })
}

/// Which of the two folders of a fold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Without the words.
    Words,
    /// As many clips, drawn from all.
    Size,
}

impl Kind {
    /// Both.
    pub const ALL: [Kind; 2] = [Kind::Words, Kind::Size];

    fn name(self) -> &'static str {
        match self {
            Kind::Words => "words",
            Kind::Size => "size",
        }
    }
}

/// Where a fold lies in `out`; folds are counted from 0.
pub fn fold_path(out: &Path, kind: Kind, fold: usize) -> PathBuf {
    out.join(format!("{}-{}", kind.name(), fold + 1))
}

impl Folds {
    /// Reads what [`write()`] has written.
    pub fn open(out: &Path) -> Result<Self> {
        let path = out.join("folds.json");
        let bytes = files::read_bytes(&path).with_context(|| {
            format!(
                "{} holds no folds (make them with `lipstream folds`)",
                out.display()
            )
        })?;
        let folds: Self =
            serde_json::from_slice(&bytes).with_context(|| format!("{} is damaged", path.display()))?;
        ensure!(
            !folds.folds.is_empty() && folds.folds.iter().all(|fold| !fold.words.is_empty()),
            File,
            "{}: a fold without words",
            path.display()
        );
        Ok(folds)
    }

    /// The folder of a fold, opened.
    pub fn folder(&self, out: &Path, kind: Kind, fold: usize) -> Result<FeatureFolder> {
        FeatureFolder::open(&fold_path(out, kind, fold).join(&self.features))
    }
}

/// Writes the folds of `folders`, whose first is the one they were drawn for; `folds.json` comes last. Folders without words (sound of which only phones are known) are
/// taken whole where the words are held out, since nobody can tell.
pub fn write(folds: &Folds, folders: &[FeatureFolder], out: &Path) -> Result<()> {
    let mut names = BTreeSet::new();
    for folder in folders {
        ensure!(
            names.insert(folder.name()),
            Choice,
            "two folders are called {:?}",
            folder.name()
        );
    }
    for (n, fold) in folds.folds.iter().enumerate() {
        let mut rng = Pcg64::seed_from_u64(folds.seed ^ ((n as u64 + 1) << 32));
        for folder in folders {
            let keeps = |clip: &&Clip| clip.split == Split::Test || !fold.is_said_in(clip);
            let clips = &folder.manifest.clips;
            let without: Vec<Clip> = clips.iter().filter(keeps).cloned().collect();
            let size = as_many(clips, &without, &mut rng);
            for (kind, clips) in [(Kind::Words, without), (Kind::Size, size)] {
                link(folder, clips, &fold_path(out, kind, n).join(folder.name()))?;
            }
        }
    }
    let text = serde_json::to_vec_pretty(folds)?;
    files::write_bytes(&out.join("folds.json"), &text).map_err(Error::other)?;
    Ok(())
}

/// As many clips of each split as `like` has, drawn from `all`, in the order of `all`.
fn as_many(all: &[Clip], like: &[Clip], rng: &mut Pcg64) -> Vec<Clip> {
    let mut kept = BTreeSet::<usize>::new();
    for split in Split::ALL {
        let mut of_split: Vec<usize> = (0..all.len()).filter(|&n| all[n].split == split).collect();
        let wanted = like.iter().filter(|clip| clip.split == split).count();
        for place in 0..wanted {
            let other = rng.random_range(place..of_split.len());
            of_split.swap(place, other);
        }
        kept.extend(&of_split[..wanted]);
    }
    kept.into_iter().map(|n| all[n].clone()).collect()
}

/// A folder `to` that holds `clips` of `folder`; its manifest comes last.
fn link(folder: &FeatureFolder, clips: Vec<Clip>, to: &Path) -> Result<()> {
    let of_clip = |clip: &Clip| {
        [
            folder.audio_path(&clip.id),
            folder.wav_path(&clip.id),
            folder.visual_path(&clip.id),
            folder.mouths_path(&clip.id),
        ]
    };
    let files = clips.iter().flat_map(of_clip).chain([folder.mouth_path()]);
    for from in files.filter(|file| file.exists()) {
        let inside = from.strip_prefix(&folder.root).unwrap_or(&from);
        let to = to.join(inside);
        let parent = to.parent().unwrap_or(&to);
        std::fs::create_dir_all(parent).with_context(|| format!("cannot create {}", parent.display()))?;
        // What an earlier run has left may be a link to something that is no more.
        if to.exists() {
            std::fs::remove_file(&to).with_context(|| format!("cannot replace {}", to.display()))?;
        }
        std::fs::hard_link(&from, &to)
            .or_else(|_| std::fs::copy(&from, &to).map(|_| ()))
            .with_context(|| format!("cannot write {}", to.display()))?;
    }
    let mut manifest = folder.manifest.clone();
    manifest.clips = clips;
    manifest.skipped.clear();
    files::write_bytes(&to.join("manifest.json"), &serde_json::to_vec_pretty(&manifest)?)
        .map_err(Error::other)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::{MANIFEST_VERSION, Manifest, PhonesFrom, Word};

    fn clip(n: usize, split: Split, words: &[&str]) -> Clip {
        let word = |(i, text): (usize, &&str)| Word {
            text: (*text).to_owned(),
            pronunciations: vec![vec!["b".into()]],
            time: Some((i as f32 * 0.1, i as f32 * 0.1 + 0.1)),
        };
        Clip {
            id: format!("{}-{n}", split.name()),
            speaker: "s".into(),
            split,
            audio_frames: 30,
            video_frames: 8,
            video_hz: 25.0,
            words: words.iter().enumerate().map(word).collect(),
            phones: Vec::new(),
            phones_from: PhonesFrom::Labels,
        }
    }

    /// 30 clips of each split; each says one of 5 colours and one of 10 digits.
    fn folder(root: &Path) -> FeatureFolder {
        let digits = ["0", "1", "2", "3", "4", "5", "6", "7", "8", "9"];
        let colours = ["Red", "blue", "green", "white", "black"];
        let clips = Split::ALL.into_iter().flat_map(|split| {
            (0..30).map(move |n| clip(n, split, &[colours[n % 5], "now", digits[n * 7 % 10]]))
        });
        FeatureFolder {
            root: root.to_owned(),
            manifest: Manifest {
                version: MANIFEST_VERSION,
                corpus: "c".into(),
                start_mean: vec![0.0; lipstream_core::N_STATIC],
                visual_size: 2,
                lips: false,
                clips: clips.collect(),
                skipped: Vec::new(),
            },
        }
    }

    const SETTINGS: FoldSettings = FoldSettings {
        folds: 3,
        most: 0.4,
        seed: 1,
    };

    #[test]
    fn no_word_is_in_two_folds_and_no_fold_loses_too_much() {
        let folder = folder(Path::new("f"));
        let folds = draw(&folder, &SETTINGS).unwrap();
        let all: Vec<&String> = folds.folds.iter().flat_map(|f| &f.words).collect();
        let once: BTreeSet<&&String> = all.iter().collect();
        assert_eq!(all.len(), once.len());
        assert!(
            !all.contains(&&"now".to_owned()),
            "what everybody says cannot be held out"
        );
        for fold in &folds.folds {
            let train = folder.split(Split::Train);
            assert_eq!(fold.left, train.filter(|c| !fold.is_said_in(c)).count());
            assert!(fold.left >= 18, "{fold:?}");
        }
        assert_eq!(folds, draw(&folder, &SETTINGS).unwrap());
        assert_ne!(
            folds.folds,
            draw(&folder, &FoldSettings { seed: 2, ..SETTINGS })
                .unwrap()
                .folds
        );
    }

    #[test]
    fn frames_are_those_of_the_words() {
        let fold = Fold {
            words: vec!["red".into()],
            left: 0,
        };
        let clip = clip(0, Split::Test, &["Red", "now", "red"]);
        let expected: Vec<usize> = (0..10).chain(20..30).collect();
        assert_eq!(fold.frames(&clip), expected);
        assert!(fold.is_said_in(&clip));
    }

    #[test]
    fn folds_lie_in_folders_that_open() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("features");
        let folder = folder(&root);
        for clip in &folder.manifest.clips {
            files::write_bytes(&folder.audio_path(&clip.id), clip.id.as_bytes()).unwrap();
        }
        let folds = draw(&folder, &SETTINGS).unwrap();
        let out = dir.path().join("folds");
        for _ in 0..2 {
            write(&folds, std::slice::from_ref(&folder), &out).unwrap();
        }
        let back = Folds::open(&out).unwrap();
        assert_eq!(back, folds);
        for (n, fold) in back.folds.iter().enumerate() {
            let [words, size] = Kind::ALL.map(|kind| back.folder(&out, kind, n).unwrap());
            for split in [Split::Train, Split::Val] {
                assert!(words.split(split).all(|clip| !fold.is_said_in(clip)));
                assert_eq!(words.split(split).count(), size.split(split).count());
            }
            assert_eq!(words.split(Split::Train).count(), fold.left);
            assert!(size.split(Split::Train).any(|clip| fold.is_said_in(clip)));
            assert_eq!(words.split(Split::Test).count(), 30);
            let clip = words.split(Split::Train).next().unwrap();
            assert_eq!(
                std::fs::read(words.audio_path(&clip.id)).unwrap(),
                clip.id.as_bytes()
            );
        }
    }

    #[test]
    fn what_cannot_be_drawn_is_refused_in_words() {
        let folder = folder(Path::new("f"));
        for (settings, word) in [
            (FoldSettings { folds: 0, ..SETTINGS }, "0 folds"),
            (
                FoldSettings {
                    most: 1.0,
                    ..SETTINGS
                },
                "between 0 and 1",
            ),
            (
                FoldSettings {
                    most: 0.02,
                    ..SETTINGS
                },
                "lose more",
            ),
        ] {
            let error = draw(&folder, &settings).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
        let mut silent = folder;
        silent
            .manifest
            .clips
            .iter_mut()
            .for_each(|clip| clip.words.clear());
        let error = draw(&silent, &SETTINGS).unwrap_err().to_string();
        assert!(error.contains("no words to hold out"), "{error}");
        let missing = Folds::open(Path::new("nowhere")).unwrap_err().to_string();
        assert!(missing.contains("lipstream folds"), "{missing}");
    }
}
