//! The numbers for anybody's model: features of every split as `.npy`, and somebody else's predictions as a candidate.
//!
//! ```text
//! OUT/index.json                    Index
//! OUT/{train,val,test}/ID.audio.npy     f32 [frames, 39], causally normalised, 100 a second
//! OUT/{train,val,test}/ID.visual.npy    f32 [frames, D], the mouth at the same frames; absent without video
//! ```
use std::path::Path;

use lipstream_core::{FRAME_SAMPLES, HOP_SAMPLES, N_OBSERVATION, SAMPLE_RATE_HZ};
use rayon::prelude::*;
use serde::Serialize;

use super::candidate::{Candidate, Heard, Prediction};
use crate::error::{Context as _, Error, Result, ensure};
use crate::features::{Clip, FeatureFolder, PhoneLabel, Split, Word};
use crate::train::data;
use lipstream::npy::{read_npy, write_npy};
use lipstream_media::files;

/// What stands in `index.json`.
#[derive(Debug, Serialize)]
struct Index<'a> {
    sample_rate_hz: u32,
    /// Frame t covers the samples from `hop_samples`·t on, `window_samples` of them.
    hop_samples: usize,
    window_samples: usize,
    audio_size: usize,
    visual_size: usize,
    start_mean: &'a [f32],
    clips: Vec<Entry<'a>>,
}

#[derive(Debug, Serialize)]
struct Entry<'a> {
    id: &'a str,
    speaker: &'a str,
    split: Split,
    frames: usize,
    audio: String,
    visual: Option<String>,
    words: &'a [Word],
    phones: &'a [PhoneLabel],
}

/// Writes every clip's features and the index, which comes last: a folder that has one is whole. Returns the
/// number of clips.
pub fn export(folder: &FeatureFolder, to: &Path) -> Result<usize> {
    let index = to.join("index.json");
    if index.exists() {
        std::fs::remove_file(&index).with_context(|| format!("cannot replace {}", index.display()))?;
    }
    let clips = &folder.manifest.clips;
    let entries = clips
        .par_iter()
        .map(|clip| entry(folder, clip, to))
        .collect::<Result<_>>()?;
    let text = serde_json::to_vec_pretty(&Index {
        sample_rate_hz: SAMPLE_RATE_HZ,
        hop_samples: HOP_SAMPLES,
        window_samples: FRAME_SAMPLES,
        audio_size: N_OBSERVATION,
        visual_size: folder.manifest.visual_size,
        start_mean: &folder.manifest.start_mean,
        clips: entries,
    })?;
    files::write_bytes(&index, &text).map_err(Error::other)?;
    Ok(clips.len())
}

fn entry<'a>(folder: &FeatureFolder, clip: &'a Clip, to: &Path) -> Result<Entry<'a>> {
    let name = |what: &str| format!("{}/{}.{what}.npy", clip.split.name(), clip.id);
    write_npy(&to.join(name("audio")), &folder.audio(clip)?).map_err(Error::other)?;
    let visual = (clip.video_frames > 0).then(|| name("visual"));
    if let Some(name) = &visual {
        let mouth = data::to_audio_rate(folder.visual(clip)?.view(), clip.video_hz, clip.audio_frames);
        write_npy(&to.join(name), &mouth).map_err(Error::other)?;
    }
    Ok(Entry {
        id: &clip.id,
        speaker: &clip.speaker,
        split: clip.split,
        frames: clip.audio_frames,
        audio: name("audio"),
        visual,
        words: &clip.words,
        phones: &clip.phones,
    })
}

/// Predictions `FOLDER/ID.npy`, f32 `[frames, D]`, as a candidate.
pub fn predictions<'a>(name: &str, from: &Path) -> Result<Candidate<'a>> {
    ensure!(
        from.is_dir(),
        Choice,
        "{} is no folder with predictions of {name} (ID.npy, one a clip)",
        from.display()
    );
    let root = from.to_owned();
    let mut candidate = Candidate::new(name, None, move |heard: &Heard| {
        Ok(Prediction {
            parameters: read_npy(&root.join(format!("{}.npy", heard.id))).map_err(Error::other)?,
            visemes: None,
        })
    });
    candidate.hears = false;
    Ok(candidate)
}
