//! A folder of features: what `lipstream prepare` writes and everything after it reads.
//!
//! ```text
//! DIR/manifest.json          Manifest
//! DIR/audio/ID.npy           f32 [frames, 39]  MFCC_E_D_A at 100 Hz, causally normalised
//! DIR/visual/ID.npy          f32 [video frames, D]  eigenmouth weights at the video's own rate
//! DIR/wav/ID.wav             16 kHz mono i16, the very samples that the features were computed from
//! DIR/mouth.safetensors      the eigenmouth space (absent in an audio-only folder)
//! ```
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use ndarray::Array2;
use serde::{Deserialize, Serialize};

use crate::files;

/// Version of the folder's layout; another version is refused in words.
pub const MANIFEST_VERSION: u32 = 1;

/// What is in a feature folder.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Manifest {
    pub version: u32,
    /// Folder that was prepared, as the user gave it.
    pub corpus: String,
    /// Training mean of the 13 raw statics (c1..c12, E) over speech: where the causal mean starts.
    pub start_mean: Vec<f32>,
    /// Numbers in a visual frame; 0 in an audio-only folder.
    pub visual_size: usize,
    pub clips: Vec<Clip>,
    /// Clips that could not be read, with the reason.
    pub skipped: Vec<Skipped>,
}

/// One utterance.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Clip {
    /// Unique in the folder; the stem of the files that belong to it.
    pub id: String,
    pub speaker: String,
    pub split: Split,
    pub audio_frames: usize,
    /// 0 for a clip without video.
    pub video_frames: usize,
    /// Frame rate of `visual/ID.npy`; 0 for a clip without video.
    pub video_hz: f32,
    /// Words with their phones; times are absent in plain transcripts.
    pub words: Vec<Word>,
    /// Phones with times, where the corpus is labelled in phones.
    pub phones: Vec<PhoneLabel>,
}

/// One word and its pronunciations, in phones of X&L table 1.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Word {
    pub text: String,
    /// Alternatives, the most usual first; never empty, never an empty list inside.
    pub pronunciations: Vec<Vec<String>>,
    /// Start and end in seconds.
    pub time: Option<(f32, f32)>,
}

/// A phone with its start and end in seconds.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PhoneLabel {
    pub phone: String,
    pub start: f32,
    pub end: f32,
}

/// What a clip is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    Train,
    Val,
    Test,
}

/// A clip that could not be prepared.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Skipped {
    pub path: String,
    pub reason: String,
}

/// A feature folder with its manifest read.
#[derive(Clone, Debug)]
pub struct FeatureFolder {
    pub root: PathBuf,
    pub manifest: Manifest,
}

impl FeatureFolder {
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
                "{} has layout version {}, this program reads {MANIFEST_VERSION}: run `lipstream prepare` again",
                path.display(),
                manifest.version
            );
        }
        Ok(Self {
            root: root.to_owned(),
            manifest,
        })
    }

    /// Clips of one split, in manifest order.
    pub fn split(&self, split: Split) -> impl Iterator<Item = &Clip> {
        self.manifest.clips.iter().filter(move |c| c.split == split)
    }

    pub fn audio_path(&self, id: &str) -> PathBuf {
        self.root.join("audio").join(format!("{id}.npy"))
    }

    pub fn visual_path(&self, id: &str) -> PathBuf {
        self.root.join("visual").join(format!("{id}.npy"))
    }

    pub fn wav_path(&self, id: &str) -> PathBuf {
        self.root.join("wav").join(format!("{id}.wav"))
    }

    pub fn mouth_path(&self) -> PathBuf {
        self.root.join("mouth.safetensors")
    }

    /// Audio observations, `[frames, 39]`.
    pub fn audio(&self, clip: &Clip) -> Result<Array2<f32>> {
        let path = self.audio_path(&clip.id);
        let array = read_npy(&path)?;
        if array.dim() != (clip.audio_frames, lipstream_core::N_OBSERVATION) {
            bail!(
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
        let array = read_npy(&path)?;
        if array.dim() != (clip.video_frames, self.manifest.visual_size) {
            bail!(
                "{}: shape {:?} is not the manifest's",
                path.display(),
                array.dim()
            );
        }
        Ok(array)
    }
}

/// Reads a two-dimensional f32 array and refuses NaN and infinities.
pub fn read_npy(path: &Path) -> Result<Array2<f32>> {
    let array: Array2<f32> =
        ndarray_npy::read_npy(path).with_context(|| format!("cannot read {}", path.display()))?;
    if let Some(((row, column), _)) = array.indexed_iter().find(|(_, v)| !v.is_finite()) {
        bail!(
            "{}: the number in row {row}, column {column} is not finite",
            path.display()
        );
    }
    Ok(array)
}

/// Writes a two-dimensional f32 array, whole or not at all.
pub fn write_npy(path: &Path, array: &Array2<f32>) -> Result<()> {
    use ndarray_npy::WriteNpyExt;
    files::write_whole(path, |file| Ok(array.write_npy(file)?))
}
