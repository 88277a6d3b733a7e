//! A folder of features: what `lipstream prepare` writes and everything after it reads.
//!
//! ```text
//! DIR/manifest.json          Manifest
//! DIR/audio/ID.npy           f32 [frames, 39]  MFCC_E_D_A at 100 Hz, causally normalised
//! DIR/visual/ID.npy          f32 [video frames, D]  eigenmouth weights at the video's own rate, without their mean
//!                            over the clip (unless `--keep-clip-mean`): what stays for a whole clip is no speech
//!                            with `--lips`: gap and width of the lips, D = 2, and no images or eigenmouths
//! DIR/wav/ID.wav             16 kHz mono i16, the very samples that the features were computed from
//! DIR/mouths/ID.npy          u8 [video frames, height, width, 3]  the mouth images behind the weights, RGB
//! DIR/mouth.safetensors      the eigenmouth space (absent in an audio-only folder)
//! DIR/cache/                 what `prepare` notes to continue where it was interrupted; nothing else reads it
//! ```
//!
//! `manifest.json` is written last and removed first: a folder that has one is whole.
use std::path::{Path, PathBuf};

use ndarray::{Array2, Array4};
use serde::{Deserialize, Serialize};

use crate::error::{Context as _, Error, Result, bail, ensure};
use lipstream::mouth::MouthSpace;
use lipstream::npy::{read_array, read_npy};
use lipstream::phones::Phone;
use lipstream::tensors::Tensors;
use lipstream_media::files;

/// Version of the folder: raised whenever its layout or the numbers of the front end change; another version is refused in words.
pub const MANIFEST_VERSION: u32 = 2;

/// Eigenmouths that are less alike than this are others; the same ones differ by rounding at most.
const SAME_MOUTH: f32 = 0.99;

/// Most frames of a clip, 46 hours of sound: what a manifest promises is not believed beyond.
pub const MOST_FRAMES: usize = 1 << 24;

/// What is in a feature folder.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Manifest {
    /// Version of the folder's layout, [`MANIFEST_VERSION`].
    pub version: u32,
    /// Folder that was prepared, as the user gave it.
    pub corpus: String,
    /// Training mean of the 13 raw statics (c1..c12, E) over speech: where the causal mean starts.
    pub start_mean: Vec<f32>,
    /// Numbers in a visual frame; 0 in an audio-only folder.
    pub visual_size: usize,
    /// Whether a visual frame holds the lips' gap and width (`prepare --lips`), not weights of eigenmouths.
    #[serde(default)]
    pub lips: bool,
    /// The clips of all splits.
    pub clips: Vec<Clip>,
    /// Clips that could not be read, with the reason.
    pub skipped: Vec<Skipped>,
}

/// One utterance.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Clip {
    /// Unique in the folder; the stem of the files that belong to it.
    pub id: String,
    /// Who speaks.
    pub speaker: String,
    /// What the clip is for.
    pub split: Split,
    /// Frames of `audio/ID.npy`, 100 a second.
    pub audio_frames: usize,
    /// 0 for a clip without video.
    pub video_frames: usize,
    /// Frame rate of `visual/ID.npy`; 0 for a clip without video.
    pub video_hz: f32,
    /// Words with their phones; times are absent in plain transcripts. Silence is no word: between timed words
    /// it is what no word covers. Empty where the corpus has no labels.
    pub words: Vec<Word>,
    /// Phones with times, silences (`sil`, `sp`) among them; empty where neither labels nor sound told any.
    pub phones: Vec<PhoneLabel>,
    /// Where the phones come from.
    #[serde(default)]
    pub phones_from: PhonesFrom,
}

/// Where a clip's phones come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PhonesFrom {
    /// From label files: somebody knows.
    #[default]
    Labels,
    /// By forced alignment of a transcript.
    Aligned,
    /// By recognition, without any text.
    Recognised,
}

/// One word and its pronunciations, in phones of X&L table 1.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Word {
    /// The word as it is spelt.
    pub text: String,
    /// Alternatives, the most usual first; never empty, never an empty list inside.
    pub pronunciations: Vec<Vec<String>>,
    /// Start and end in seconds.
    pub time: Option<(f32, f32)>,
}

impl lipstream::hmm::network::Pronounced for Word {
    fn pronunciations(&self) -> &[Vec<String>] {
        &self.pronunciations
    }
}

/// A phone with its start and end in seconds.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PhoneLabel {
    /// Name of the phone.
    pub phone: String,
    /// Where it begins, in seconds.
    pub start: f32,
    /// Where it ends, in seconds.
    pub end: f32,
}

/// What a clip is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// Models are fitted to these clips.
    Train,
    /// Choices between models and settings are made on these clips.
    Val,
    /// Finished models are measured on these clips.
    Test,
}

impl Split {
    /// The three splits in their usual order.
    pub const ALL: [Split; 3] = [Split::Train, Split::Val, Split::Test];

    /// The name that manifests and options use, in lower case.
    pub fn name(self) -> &'static str {
        match self {
            Split::Train => "train",
            Split::Val => "val",
            Split::Test => "test",
        }
    }

    /// The split of this name; refused in words.
    pub fn named(name: &str) -> Result<Self> {
        Self::ALL
            .into_iter()
            .find(|split| split.name() == name)
            .ok_or_else(|| Error::Choice(format!("no split is called {name:?}: train, val, test")))
    }
}

/// A clip that could not be prepared.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Skipped {
    /// Path of the sound or video file that it was read from.
    pub path: String,
    /// Why it could not be prepared, in words.
    pub reason: String,
}

/// A feature folder with its manifest read.
#[derive(Clone, Debug)]
pub struct FeatureFolder {
    /// Path of the folder.
    pub root: PathBuf,
    /// What is in the folder.
    pub manifest: Manifest,
}

impl FeatureFolder {
    /// Reads and checks the manifest. An error when there is none, or it is damaged or of another version.
    pub fn open(root: &Path) -> Result<Self> {
        let path = root.join("manifest.json");
        let bytes = files::read_bytes(&path).with_context(|| {
            format!(
                "{} is no feature folder (make one with `lipstream prepare`)",
                root.display()
            )
        })?;
        let manifest: Manifest =
            serde_json::from_slice(&bytes).with_context(|| format!("{} is damaged", path.display()))?;
        if manifest.version != MANIFEST_VERSION {
            bail!(
                File,
                "{} is of version {}, this program reads {MANIFEST_VERSION}: run `lipstream prepare` again",
                path.display(),
                manifest.version
            );
        }
        manifest
            .check()
            .with_context(|| format!("{} is damaged", path.display()))?;
        Ok(Self {
            root: root.to_owned(),
            manifest,
        })
    }

    /// Refuses a folder whose visual numbers are no weights of eigenmouths.
    ///
    /// # Errors
    ///
    /// [`Error::Choice`]: it holds lips.
    pub fn of_eigenmouths(&self) -> Result<()> {
        ensure!(
            !self.manifest.lips,
            Choice,
            "{} holds the gap and width of lips, not mouths: give it to `train --train mge --watched`",
            self.root.display()
        );
        Ok(())
    }

    /// Last part of its path: what a report calls it on other machines.
    pub fn name(&self) -> String {
        let name = self.root.file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    }

    /// Clips of one split, in manifest order.
    pub fn split(&self, split: Split) -> impl Iterator<Item = &Clip> {
        self.manifest.clips.iter().filter(move |c| c.split == split)
    }

    /// File of a clip's audio observations.
    pub fn audio_path(&self, id: &str) -> PathBuf {
        self.root.join("audio").join(format!("{id}.npy"))
    }

    /// File of a clip's eigenmouth weights.
    pub fn visual_path(&self, id: &str) -> PathBuf {
        self.root.join("visual").join(format!("{id}.npy"))
    }

    /// File of a clip's sound.
    pub fn wav_path(&self, id: &str) -> PathBuf {
        self.root.join("wav").join(format!("{id}.wav"))
    }

    /// File of a clip's mouth images.
    pub fn mouths_path(&self, id: &str) -> PathBuf {
        self.root.join("mouths").join(format!("{id}.npy"))
    }

    /// File of the eigenmouth space, which an audio-only folder lacks.
    pub fn mouth_path(&self) -> PathBuf {
        self.root.join("mouth.safetensors")
    }

    /// Refuses a mouth whose parameters mean something else than this folder's: their numbers could be compared and would say nothing. A folder without eigenmouths refuses none.
    ///
    /// # Errors
    ///
    /// How alike the two are, or that the folder's eigenmouths cannot be read.
    pub fn has_mouth(&self, space: &MouthSpace) -> Result<()> {
        let path = self.mouth_path();
        if !path.is_file() {
            return Ok(());
        }
        let own = Tensors::read(&path)
            .and_then(|tensors| MouthSpace::load(&tensors))
            .map_err(Error::other)?;
        let likeness = space.likeness(&own);
        let is_same = likeness > SAME_MOUTH;
        ensure!(
            is_same,
            Choice,
            "the model's eigenmouths are not those of {} (likeness {likeness:.2} of 1): its parameters mean another mouth's; train it on this folder, or name the folder that it was \
             trained on",
            self.root.display()
        );
        Ok(())
    }

    /// Audio observations, `[frames, 39]`.
    pub fn audio(&self, clip: &Clip) -> Result<Array2<f32>> {
        let path = self.audio_path(&clip.id);
        let array = read_npy(&path).map_err(Error::other)?;
        if array.dim() != (clip.audio_frames, lipstream_core::N_OBSERVATION) {
            bail!(
                File,
                "{}: shape {:?} is not the manifest's",
                path.display(),
                array.dim()
            );
        }
        Ok(array)
    }

    /// Visual observations at the video's rate, `[video frames, D]`.
    pub fn visual(&self, clip: &Clip) -> Result<Array2<f32>> {
        let path = self.visual_path(&clip.id);
        let array = read_npy(&path).map_err(Error::other)?;
        if array.dim() != (clip.video_frames, self.manifest.visual_size) {
            bail!(
                File,
                "{}: shape {:?} is not the manifest's",
                path.display(),
                array.dim()
            );
        }
        Ok(array)
    }
}

/// True for a name that is a file's stem everywhere and leads nowhere else.
pub fn is_safe_id(id: &str) -> bool {
    !id.is_empty()
        && id.len() <= 128
        && !id.starts_with(['.', '-'])
        && id
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || "-_.~".contains(c))
}

impl Manifest {
    /// Whether what is written can be used as it stands: sizes, ids as file names, phones of table 1, times.
    pub fn check(&self) -> Result<()> {
        ensure!(
            self.start_mean.len() == lipstream_core::N_STATIC
                && self.start_mean.iter().all(|v| v.is_finite()),
            File,
            "the start mean is not {} numbers",
            lipstream_core::N_STATIC
        );
        let mut ids = std::collections::HashSet::new();
        for clip in &self.clips {
            ensure!(is_safe_id(&clip.id), File, "{:?} cannot be a file name", clip.id);
            ensure!(
                ids.insert(clip.id.to_lowercase()),
                File,
                "clip {} is there twice",
                clip.id
            );
            clip.check().with_context(|| format!("clip {}", clip.id))?;
            ensure!(
                clip.video_frames == 0 || self.visual_size > 0,
                File,
                "clip {} has video, but a visual frame has no numbers",
                clip.id
            );
        }
        Ok(())
    }
}

impl Clip {
    /// Phones that somebody labelled; none where a program found them.
    pub fn labelled_phones(&self) -> &[PhoneLabel] {
        match self.phones_from {
            PhonesFrom::Labels => &self.phones,
            PhonesFrom::Aligned | PhonesFrom::Recognised => &[],
        }
    }

    /// Whether anything tells which phones are said.
    pub fn is_labelled(&self) -> bool {
        !(self.words.is_empty() && self.phones.is_empty())
    }

    fn check(&self) -> Result<()> {
        for (what, frames) in [("sound", self.audio_frames), ("pictures", self.video_frames)] {
            ensure!(
                frames <= MOST_FRAMES,
                File,
                "{frames} frames of {what} are more than a clip has: at most {MOST_FRAMES}"
            );
        }
        if self.video_frames > 0 {
            ensure!(
                self.video_hz.is_finite() && self.video_hz > 0.0,
                File,
                "its video has {} frames a second",
                self.video_hz
            );
        }
        let span = |start: f32, end: f32| start.is_finite() && end.is_finite() && 0.0 <= start && start < end;
        for word in &self.words {
            ensure!(
                !word.pronunciations.is_empty() && word.pronunciations.iter().all(|p| !p.is_empty()),
                File,
                "word {:?} has no pronunciation",
                word.text
            );
            for phone in word.pronunciations.iter().flatten() {
                ensure!(
                    Phone::from_name(phone).is_some(),
                    File,
                    "no phone is called {phone:?}"
                );
            }
            if let Some((start, end)) = word.time {
                ensure!(
                    span(start, end),
                    File,
                    "word {:?} from {start} s to {end} s",
                    word.text
                );
            }
        }
        for label in &self.phones {
            ensure!(
                Phone::from_name(&label.phone).is_some(),
                File,
                "no phone is called {:?}",
                label.phone
            );
            ensure!(
                span(label.start, label.end),
                File,
                "phone {} from {} s to {} s",
                label.phone,
                label.start,
                label.end
            );
        }
        Ok(())
    }
}

/// Reads the mouth images of a clip, `[video frames, height, width, 3]`.
pub fn read_mouths(path: &Path) -> Result<Array4<u8>> {
    let images: Array4<u8> = read_array(path).map_err(Error::other)?;
    ensure!(
        images.dim().3 == 3,
        File,
        "{}: shape {:?} is no sequence of RGB images",
        path.display(),
        images.dim()
    );
    Ok(images)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::chain;

    fn manifest() -> Manifest {
        Manifest {
            version: MANIFEST_VERSION,
            corpus: "corpus".into(),
            start_mean: vec![0.0; lipstream_core::N_STATIC],
            visual_size: 0,
            lips: false,
            clips: vec![Clip {
                id: "a".into(),
                speaker: "s".into(),
                split: Split::Train,
                audio_frames: 2,
                video_frames: 0,
                phones_from: PhonesFrom::Labels,
                video_hz: 0.0,
                words: vec![Word {
                    text: "be".into(),
                    pronunciations: vec![vec!["b".into(), "iy".into()]],
                    time: Some((0.0, 0.5)),
                }],
                phones: vec![PhoneLabel {
                    phone: "b".into(),
                    start: 0.0,
                    end: 0.25,
                }],
            }],
            skipped: Vec::new(),
        }
    }

    fn opened(manifest: &Manifest) -> Result<FeatureFolder> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("manifest.json");
        std::fs::write(path, serde_json::to_string(manifest).unwrap()).unwrap();
        FeatureFolder::open(folder.path())
    }

    #[test]
    fn a_sound_manifest_is_read_back() {
        let manifest = manifest();
        let back = opened(&manifest).unwrap().manifest;
        assert_eq!(
            serde_json::to_string(&back).unwrap(),
            serde_json::to_string(&manifest).unwrap()
        );
    }

    #[test]
    fn damaged_manifests_are_refused() {
        let damages: [fn(&mut Manifest); 13] = [
            |m| m.version = 99,
            |m| m.start_mean.truncate(3),
            |m| m.clips[0].id = "../a".into(),
            |m| m.clips[0].id = String::new(),
            |m| m.clips.push(m.clips[0].clone()),
            |m| m.clips[0].words[0].pronunciations.clear(),
            |m| m.clips[0].words[0].pronunciations[0].clear(),
            |m| m.clips[0].words[0].pronunciations[0][0] = "qq".into(),
            |m| m.clips[0].words[0].time = Some((0.5, 0.5)),
            |m| m.clips[0].phones[0].phone = "AH0".into(),
            |m| m.clips[0].phones[0].start = -1.0,
            |m| m.clips[0].video_frames = 10,
            |m| m.clips[0].audio_frames = usize::MAX,
        ];
        for (i, damage) in damages.iter().enumerate() {
            let mut manifest = manifest();
            damage(&mut manifest);
            let error = opened(&manifest).map(|_| ()).unwrap_err();
            let text = chain(&error);
            assert!(!text.contains('\n'), "{i}: {text}");
        }
        let folder = tempfile::tempdir().unwrap();
        assert!(FeatureFolder::open(folder.path()).is_err());
        std::fs::write(folder.path().join("manifest.json"), b"{").unwrap();
        assert!(FeatureFolder::open(folder.path()).is_err());
    }
}
