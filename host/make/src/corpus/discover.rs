//! Finding the clips of a corpus by what its folders hold.
//!
//! A clip is a video or sound file together with the label files of the same name beside it. Three layouts are
//! told apart by content, not by name of the corpus:
//!
//! - folders called train, val and test (or their usual synonyms) at any depth are splits (GRID as shipped
//!   here, TIMIT's own TRAIN and TEST);
//! - folders that hold clips are speakers (TIMIT: `dr1-fvmh0/sa1.wav`);
//! - clips that lie beside each other without speaker folders are one speaker's in a split folder, and each
//!   its own speaker's elsewhere, unless [`Options::one_speaker`] says otherwise.
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};

use super::labels;
use crate::error::{Context as _, Result, bail};
use crate::features::Split;
use lipstream_media::video::Part;

/// Extensions of video files; their sound comes with them, or from a sound file beside them.
pub const VIDEO: [&str; 12] = [
    "mpg", "mpeg", "mp4", "m4v", "avi", "mov", "mkv", "webm", "mts", "wmv", "ogv", "flv",
];

/// Extensions of sound files, the preferred first.
pub const SOUND: [&str; 13] = [
    "wav", "flac", "aiff", "aif", "aifc", "caf", "mp3", "m4a", "aac", "ogg", "oga", "opus", "mka",
];

/// How clips are dealt out.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Speakers (or, for one speaker, nothing) whose clips are the validation split.
    pub val_speakers: Vec<String>,
    /// Speakers whose clips are the test split.
    pub test_speakers: Vec<String>,
    /// Every clip is a training clip, whatever the folders are called.
    pub all_train: bool,
    /// All clips are of one speaker.
    pub one_speaker: bool,
}

/// The files of one clip.
#[derive(Clone, Debug, PartialEq)]
pub struct ClipFiles {
    /// Unique, safe as a file name: the stem, or the path where stems repeat.
    pub id: String,
    /// Who speaks, by the folders or the options.
    pub speaker: String,
    /// What the clip is for.
    pub split: Split,
    /// The video file, if there is one.
    pub video: Option<PathBuf>,
    /// The part of the video that is the clip, where it is not the whole.
    pub part: Option<Part>,
    /// Sound apart from the video; the video's own sound is used when there is none.
    pub sound: Option<PathBuf>,
    /// Label files of the clip; empty where it has none.
    pub labels: Vec<PathBuf>,
    /// The stem of the files, as it was written.
    pub stem: String,
}

impl ClipFiles {
    /// A video alone, called by its stem.
    pub fn of_video(path: &Path) -> Self {
        let stem = path
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        Self {
            id: stem.clone(),
            speaker: stem.clone(),
            split: Split::Train,
            video: Some(path.to_owned()),
            part: None,
            sound: None,
            labels: Vec::new(),
            stem,
        }
    }

    /// The file that the sound comes from.
    pub fn sound_path(&self) -> &Path {
        self.sound
            .as_deref()
            .or(self.video.as_deref())
            .unwrap_or(Path::new(""))
    }
}

/// What was found.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// Sorted by id.
    pub clips: Vec<ClipFiles>,
    /// Files that belong to no clip.
    pub left_alone: Vec<PathBuf>,
    /// Whether the split came from folders or options; else it was drawn by speaker or by clip.
    pub split_by: SplitBy,
}

/// Where the split came from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SplitBy {
    /// From folders called train, val or test, or the like.
    Folders,
    /// From the speakers named in [`Options`].
    Options,
    /// By speaker, from the hash of the speaker's name.
    Speaker,
    /// By clip, from the hash of the clip's id.
    Clip,
    /// Nothing was split: every clip is a training clip.
    #[default]
    AllTrain,
}

/// A clip before ids, speakers and splits are settled.
struct Group {
    /// Folders between the corpus and the clip, without split folders.
    folders: Vec<String>,
    split: Option<Split>,
    stem: String,
    video: Option<PathBuf>,
    sounds: Vec<PathBuf>,
    labels: Vec<PathBuf>,
}

/// Finds the clips under `root`; `without` (the output folder) is not searched.
pub fn discover(root: &Path, without: Option<&Path>, options: &Options) -> Result<Found> {
    if !root.is_dir() {
        bail!(
            Choice,
            "{} is no folder; give the folder of a corpus (clips as video or WAV, labels beside them)",
            root.display()
        );
    }
    let without = without.and_then(|p| p.canonicalize().ok());
    let mut files = Vec::new();
    walk(root, without.as_deref(), 0, &mut files)?;
    files.sort();
    let (groups, left_alone) = group(root, files)?;
    if groups.is_empty() {
        bail!(
            Data,
            "{} holds no clips: looked for {} and {} files in it and the folders below",
            root.display(),
            VIDEO[..5].join(", "),
            SOUND[..3].join(", ")
        );
    }
    let ids = ids(&groups);
    let corpus = root
        .canonicalize()
        .ok()
        .and_then(|p| Some(p.file_name()?.to_string_lossy().into_owned()))
        .unwrap_or_else(|| "corpus".into());
    let mut clips: Vec<ClipFiles> = groups
        .into_iter()
        .zip(ids)
        .map(|(group, id)| {
            let speaker = match group.folders.last() {
                _ if options.one_speaker => corpus.clone(),
                Some(folder) => folder.clone(),
                None if group.split.is_some() => corpus.clone(),
                None => id.clone(),
            };
            let sound = SOUND
                .iter()
                .find_map(|e| group.sounds.iter().find(|p| extension(p).as_deref() == Some(e)))
                .cloned();
            ClipFiles {
                id,
                speaker,
                split: group.split.unwrap_or(Split::Train),
                video: group.video,
                part: None,
                sound,
                labels: group.labels,
                stem: group.stem,
            }
        })
        .collect();
    clips.sort_by(|a, b| a.id.cmp(&b.id));
    let from_folders = clips.iter().any(|c| c.split != Split::Train);
    let split_by = deal(&mut clips, from_folders, options)?;
    Ok(Found {
        clips,
        left_alone,
        split_by,
    })
}

/// All files below `folder` but hidden ones.
fn walk(folder: &Path, without: Option<&Path>, depth: usize, out: &mut Vec<PathBuf>) -> Result<()> {
    if depth > 32 {
        bail!(Data, "{}: folders are nested too deep", folder.display());
    }
    let entries = std::fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    for entry in entries {
        let entry = entry.with_context(|| format!("cannot read {}", folder.display()))?;
        let path = entry.path();
        if entry.file_name().to_string_lossy().starts_with('.') {
            continue;
        }
        // Follows links: corpora are often linked together.
        let Ok(meta) = std::fs::metadata(&path) else {
            bail!(Data, "{}: a link that leads nowhere", path.display());
        };
        if meta.is_dir() {
            if without.is_some_and(|w| path.canonicalize().is_ok_and(|p| p == w)) {
                continue;
            }
            walk(&path, without, depth + 1, out)?;
        } else if meta.is_file() {
            out.push(path);
        } else if extension(&path).is_some_and(|e| is_known(&e)) {
            // It may never end.
            bail!(
                Data,
                "{}: a pipe or a device, not a file: take it out of the corpus",
                path.display()
            );
        }
    }
    Ok(())
}

/// Whether files with this extension, in lower case, are part of a corpus.
fn is_known(extension: &str) -> bool {
    [&VIDEO[..], &SOUND[..], &labels::EXTENSIONS[..]]
        .iter()
        .any(|list| list.contains(&extension))
}

fn extension(path: &Path) -> Option<String> {
    Some(path.extension()?.to_str()?.to_lowercase())
}

/// Files with the same folder and stem; those without video or sound are left alone.
fn group(root: &Path, files: Vec<PathBuf>) -> Result<(Vec<Group>, Vec<PathBuf>)> {
    let mut by_stem: BTreeMap<PathBuf, Vec<PathBuf>> = BTreeMap::new();
    let mut left_alone = Vec::new();
    for path in files {
        let known = extension(&path).is_some_and(|e| is_known(&e));
        if known {
            by_stem.entry(path.with_extension("")).or_default().push(path);
        } else {
            left_alone.push(path);
        }
    }
    let mut groups = Vec::new();
    for (base, files) in by_stem {
        let of = |list: &[&str]| -> Vec<PathBuf> {
            let matching = |p: &&PathBuf| extension(p).is_some_and(|e| list.contains(&e.as_str()));
            files.iter().filter(matching).cloned().collect()
        };
        let (videos, sounds, labels) = (of(&VIDEO), of(&SOUND), of(&labels::EXTENSIONS));
        if videos.is_empty() && sounds.is_empty() {
            left_alone.extend(labels);
            continue;
        }
        if videos.len() > 1 {
            bail!(
                Data,
                "{} and {} would be the same clip: keep one",
                videos[0].display(),
                videos[1].display()
            );
        }
        let relative = base.strip_prefix(root).unwrap_or(&base);
        let mut folders: Vec<String> = relative
            .components()
            .filter_map(|c| match c {
                Component::Normal(name) => Some(name.to_string_lossy().into_owned()),
                _ => None,
            })
            .collect();
        let stem = folders.pop().unwrap_or_default();
        let at = folders.iter().position(|f| split_name(f).is_some());
        let split = at.and_then(|i| split_name(&folders.remove(i)));
        groups.push(Group {
            folders,
            split,
            stem,
            video: videos.into_iter().next(),
            sounds,
            labels,
        });
    }
    left_alone.sort();
    Ok((groups, left_alone))
}

fn split_name(folder: &str) -> Option<Split> {
    match folder.to_lowercase().as_str() {
        "train" | "training" | "trn" => Some(Split::Train),
        "val" | "valid" | "validation" | "dev" | "development" => Some(Split::Val),
        "test" | "testing" | "tst" | "eval" => Some(Split::Test),
        _ => None,
    }
}

/// A name without anything that a file system could trip over.
pub(super) fn safe(name: &str) -> String {
    let keep = |c: char| {
        if c.is_ascii_alphanumeric() || "-_.".contains(c) {
            c
        } else {
            '-'
        }
    };
    let name: String = name.chars().map(keep).collect();
    match name.trim_matches(['.', '-']) {
        "" => "clip".into(),
        trimmed => trimmed.chars().take(100).collect(),
    }
}

/// The stems if they are all different (letter case aside), else the folders too; numbered where even that repeats.
fn ids(groups: &[Group]) -> Vec<String> {
    let stems: Vec<String> = groups.iter().map(|g| safe(&g.stem)).collect();
    let different: BTreeSet<String> = stems.iter().map(|s| s.to_lowercase()).collect();
    if different.len() == stems.len() {
        return stems;
    }
    let mut used = BTreeSet::new();
    groups
        .iter()
        .map(|g| {
            let parts: Vec<&str> = g
                .folders
                .iter()
                .map(String::as_str)
                .chain([g.stem.as_str()])
                .collect();
            let id = safe(&parts.join("_"));
            let mut unique = id.clone();
            let mut n = 2;
            while !used.insert(unique.to_lowercase()) {
                unique = format!("{id}~{n}");
                n += 1;
            }
            unique
        })
        .collect()
}

/// A number in 0..100 that depends on `name` only.
fn percentile(name: &str) -> u32 {
    let hash = name.bytes().fold(0xcbf2_9ce4_8422_2325u64, |h, b| {
        (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3)
    });
    ((hash ^ (hash >> 32)).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as u32 % 100
}

/// Settles every clip's split. Without folders and options: by speaker where there are at least five, by clip
/// where there are at least ten of fewer speakers, else everything is for training. Speakers or clips are put in
/// the order of a hash of their names; the first tenth (at least one) is for the test, the next for validation.
pub(super) fn deal(clips: &mut [ClipFiles], from_folders: bool, options: &Options) -> Result<SplitBy> {
    if options.all_train {
        clips.iter_mut().for_each(|c| c.split = Split::Train);
        return Ok(SplitBy::AllTrain);
    }
    let speakers: BTreeSet<String> = clips.iter().map(|c| c.speaker.clone()).collect();
    if !options.test_speakers.is_empty() || !options.val_speakers.is_empty() {
        for name in options.test_speakers.iter().chain(&options.val_speakers) {
            if !speakers.contains(name) {
                let known: Vec<_> = speakers.iter().take(5).map(String::as_str).collect();
                bail!(
                    Choice,
                    "no speaker is called {name:?}; there are {} (and so on)",
                    known.join(", ")
                );
            }
        }
        if let Some(both) = options
            .test_speakers
            .iter()
            .find(|s| options.val_speakers.contains(s))
        {
            bail!(
                Choice,
                "{both:?} cannot be a test speaker and a validation speaker at once"
            );
        }
        for clip in clips.iter_mut() {
            clip.split = if options.test_speakers.contains(&clip.speaker) {
                Split::Test
            } else if options.val_speakers.contains(&clip.speaker) {
                Split::Val
            } else {
                Split::Train
            };
        }
        return Ok(SplitBy::Options);
    }
    if from_folders {
        return Ok(SplitBy::Folders);
    }
    let (names, by): (Vec<String>, SplitBy) = if speakers.len() >= 5 {
        (speakers.into_iter().collect(), SplitBy::Speaker)
    } else if clips.len() >= 10 {
        (clips.iter().map(|c| c.id.clone()).collect(), SplitBy::Clip)
    } else {
        return Ok(SplitBy::AllTrain);
    };
    let share = names.len().div_ceil(10);
    let mut order: Vec<(u32, &String)> = names.iter().map(|n| (percentile(n), n)).collect();
    order.sort();
    let place: BTreeMap<&String, usize> = order.iter().enumerate().map(|(i, (_, n))| (*n, i)).collect();
    for clip in clips.iter_mut() {
        let key = if by == SplitBy::Speaker {
            &clip.speaker
        } else {
            &clip.id
        };
        clip.split = match place[key] / share {
            0 => Split::Test,
            1 => Split::Val,
            _ => Split::Train,
        };
    }
    Ok(by)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corpus(files: &[&str]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for file in files {
            let path = folder.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, b"").unwrap();
        }
        folder
    }

    fn find(folder: &tempfile::TempDir, options: &Options) -> Found {
        discover(folder.path(), None, options).unwrap()
    }

    #[test]
    fn split_folders() {
        let folder = corpus(&[
            "train/a.mpg",
            "train/a.align",
            "train/b.mpg",
            "Test/c.MP4",
            "Test/c.wav",
            "val/d.avi",
            "landmarks.npz",
            "val/alone.align",
            ".hidden/e.mpg",
        ]);
        let found = find(&folder, &Options::default());
        let splits: Vec<_> = found.clips.iter().map(|c| (c.id.as_str(), c.split)).collect();
        assert_eq!(
            splits,
            [
                ("a", Split::Train),
                ("b", Split::Train),
                ("c", Split::Test),
                ("d", Split::Val)
            ]
        );
        assert_eq!(found.split_by, SplitBy::Folders);
        assert_eq!(found.clips[0].labels.len(), 1);
        assert!(found.clips[2].sound.is_some() && found.clips[2].video.is_some());
        assert_eq!(found.left_alone.len(), 2);
        let speakers: BTreeSet<_> = found.clips.iter().map(|c| &c.speaker).collect();
        assert_eq!(speakers.len(), 1);
    }

    #[test]
    fn speaker_folders_share_stems() {
        let folder = corpus(&[
            "dr1-x/sa1.wav",
            "dr1-x/sa1.phn",
            "dr1-x/sa1.wrd",
            "dr2-y/sa1.wav",
            "dr2-y/sa2.flac",
        ]);
        let options = Options {
            test_speakers: vec!["dr2-y".into()],
            ..Options::default()
        };
        let found = find(&folder, &options);
        let ids: Vec<_> = found.clips.iter().map(|c| c.id.as_str()).collect();
        assert_eq!(ids, ["dr1-x_sa1", "dr2-y_sa1", "dr2-y_sa2"]);
        assert_eq!(found.clips[0].labels.len(), 2);
        assert_eq!(found.clips[0].split, Split::Train);
        assert_eq!(found.clips[1].split, Split::Test);
        let bad = Options {
            val_speakers: vec!["nobody".into()],
            ..Options::default()
        };
        assert!(discover(folder.path(), None, &bad).is_err());
    }

    #[test]
    fn the_original_timit_tree() {
        let folder = corpus(&["TRAIN/DR1/FCJF0/SA1.WAV", "TEST/DR1/FAKS0/SA1.WAV"]);
        let found = find(&folder, &Options::default());
        let all: Vec<_> = found
            .clips
            .iter()
            .map(|c| (c.id.as_str(), c.speaker.as_str(), c.split))
            .collect();
        assert_eq!(
            all,
            [
                ("DR1_FAKS0_SA1", "FAKS0", Split::Test),
                ("DR1_FCJF0_SA1", "FCJF0", Split::Train)
            ]
        );
    }

    #[test]
    fn a_flat_folder_is_dealt_out_the_same_way_every_time() {
        let names: Vec<String> = (0..40).map(|i| format!("clip {i}.mov")).collect();
        let folder = corpus(&names.iter().map(String::as_str).collect::<Vec<_>>());
        let found = find(&folder, &Options::default());
        assert_eq!(found.split_by, SplitBy::Speaker);
        assert_eq!(found.clips, find(&folder, &Options::default()).clips);
        let count = |s: Split| found.clips.iter().filter(|c| c.split == s).count();
        assert_eq!(
            (count(Split::Test), count(Split::Val), count(Split::Train)),
            (4, 4, 32)
        );
        let one = Options {
            one_speaker: true,
            ..Options::default()
        };
        assert_eq!(find(&folder, &one).split_by, SplitBy::Clip);
        let all = Options {
            all_train: true,
            ..Options::default()
        };
        assert!(find(&folder, &all).clips.iter().all(|c| c.split == Split::Train));
    }

    #[test]
    fn ids_are_safe_and_differ_without_letter_case() {
        let folder = corpus(&["a/Clip ä.wav", "a/clip ä.wav", "a/clip -.wav", "b/-wav..wav"]);
        let found = find(&folder, &Options::default());
        let ids: BTreeSet<String> = found.clips.iter().map(|c| c.id.to_lowercase()).collect();
        assert_eq!(ids.len(), 4);
        for clip in &found.clips {
            assert!(crate::features::is_safe_id(&clip.id), "{}", clip.id);
        }
    }

    #[test]
    fn nothing_found_says_what_was_looked_for() {
        let folder = corpus(&["notes.txt", "x.npz"]);
        let error = discover(folder.path(), None, &Options::default())
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("no clips") && error.contains("mpg") && error.contains("wav"),
            "{error}"
        );
        assert!(discover(&folder.path().join("none"), None, &Options::default()).is_err());
        let twice = corpus(&["a.mpg", "a.mp4"]);
        assert!(discover(twice.path(), None, &Options::default()).is_err());
    }
}
