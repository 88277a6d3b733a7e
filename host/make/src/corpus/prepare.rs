//! `prepare`: a corpus to a feature folder (features.rs), clip by clip on all cores.
//!
//! Passes: sound, labels and the speech mean; audio observations, which start from that mean; mouth images;
//! the eigenmouths of the training clips; their weights in every clip. No pass holds more than a few clips in
//! memory. What a pass has made is kept with a note of its inputs (stamp.rs), so that a second run continues.
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::discover::{self, ClipFiles, Found};
use super::heard::{Heard, Hearing, Listener};
use super::labels::{self, Labels, SpokenWord, transcript};
use super::lips;
use super::mend;
use super::pronounce::{self, Pronouncer};
use super::stamp::{self, Notes};
use super::summary::{self, Summary};
use super::take;
use super::visual;
use crate::error::{Context as _, Error, Result, bail, chain};
use crate::features::{
    Clip, FeatureFolder, MANIFEST_VERSION, Manifest, PhoneLabel, PhonesFrom, Skipped, Split, Word,
};
use lipstream::npy;
use lipstream::progress::{Progress, Steps};
use lipstream::reference::{self, Normalisation, SpeechMean};
use lipstream_media::video;
use lipstream_media::{files, sound};

/// Shorter sounds (s) are no utterances: nothing would be left between the edges of Δ and ΔΔ.
const SHORTEST_S: f64 = 0.15;

/// Clips in memory at once, for each thread.
const CLIPS_PER_THREAD: usize = 4;

/// What to prepare and how.
#[derive(Clone, Debug)]
pub struct PrepareSettings {
    /// Folder of the corpus.
    pub corpus: PathBuf,
    /// Feature folder to write.
    pub out: PathBuf,
    /// How clips are dealt out to speakers and splits.
    pub clips: discover::Options,
    /// The user's pronunciations, in CMUdict's text format.
    pub dictionary: Option<PathBuf>,
    /// Who hears the phones of clips that have no labels with times.
    pub hearing: Hearing,
    /// Leaves the pictures of videos alone.
    pub audio_only: bool,
    /// Measures lips by landmarks in place of mouth images and eigenmouths: for people whose motion is to be learnt, not their looks.
    pub lips: bool,
    /// Eigenmouths to keep; fewer where there are not as many different images.
    pub eigenmouths: usize,
    /// So many eigenmouths of each colour, as in the paper, instead of joint ones.
    pub by_channel: bool,
    /// Leaves each clip's mean in its weights: what a speaker looks like all through a clip.
    pub keep_clip_mean: bool,
    /// Writes a film of every clip with what was found drawn on it: the mouth's rectangle, the lips.
    pub overlay: bool,
    /// Milliseconds by which the sound of all videos is late against their pictures (negative: early); None finds it out for each
    /// speaker and mends it where it is sure, 0 leaves sound where it is.
    pub sync_offset_ms: Option<f32>,
    /// Nothing of an earlier run is used.
    pub fresh: bool,
}

impl Default for PrepareSettings {
    fn default() -> Self {
        Self {
            corpus: PathBuf::new(),
            out: PathBuf::new(),
            clips: discover::Options::default(),
            dictionary: None,
            hearing: Hearing::default(),
            audio_only: false,
            lips: false,
            eigenmouths: 30,
            by_channel: false,
            keep_clip_mean: false,
            overlay: false,
            sync_offset_ms: None,
            fresh: false,
        }
    }
}

/// What gives clips their words and phones.
pub(super) struct Labelling {
    pub(super) pronouncer: Pronouncer,
    pub(super) listener: Listener,
    /// Whether a clip is left out whose words are not what is heard in it, as a piece of a take, whose words were found for it.
    only_what_fits: bool,
}

/// A clip on its way: its manifest entry and where its pronunciations came from.
pub(super) struct Prepared {
    pub(super) source: ClipFiles,
    pub(super) clip: Clip,
    pub(super) words: BTreeMap<String, pronounce::Origin>,
    pub(super) named_sentence: bool,
    pub(super) heard: Heard,
    pub(super) seconds: f64,
    sound_stamp: String,
}

#[cfg(test)]
impl Prepared {
    /// A clip with nothing but its files and its length.
    pub(super) fn bare(source: ClipFiles, seconds: f64) -> Self {
        Self {
            clip: Clip {
                id: source.id.clone(),
                speaker: source.speaker.clone(),
                split: source.split,
                audio_frames: 0,
                video_frames: 0,
                phones_from: PhonesFrom::Labels,
                video_hz: 0.0,
                words: Vec::new(),
                phones: Vec::new(),
            },
            source,
            words: BTreeMap::new(),
            named_sentence: false,
            heard: Heard::Nothing,
            seconds,
            sound_stamp: String::new(),
        }
    }
}

/// Prepares a corpus. Clips that cannot be read are skipped and named in the result; the error is for the whole.
pub fn prepare(settings: &PrepareSettings, progress: &dyn Progress) -> Result<Summary> {
    let began = std::time::Instant::now();
    let is_take = settings.corpus.is_file();
    let labelling = Labelling {
        pronouncer: Pronouncer::new(settings.dictionary.as_deref())?,
        listener: Listener::new(&settings.hearing),
        only_what_fits: is_take,
    };
    let found = if is_take {
        // Before the pieces' sound is written to it.
        claim(&settings.out, settings.fresh)?;
        let late_ms = match take::is_sound(&settings.corpus) {
            true => 0.0,
            false => mend::of_take(&settings.corpus, settings, progress)?,
        };
        take::cut(settings, late_ms, &labelling, progress)?
    } else {
        discover::discover(&settings.corpus, Some(&settings.out), &settings.clips)?
    };
    let decodes =
        |c: &ClipFiles| (c.video.is_some() && !settings.audio_only) || !is_read_here(c.sound_path());
    if found.clips.iter().any(decodes) {
        video::available().map_err(Error::other)?;
    }
    let mut late = BTreeMap::new();
    if !is_take {
        claim(&settings.out, settings.fresh)?;
        late = mend::of_speakers(&found.clips, settings, progress)?;
    }

    let mut skipped = Vec::new();
    let (mut clips, start_mean) = listen(&found, &late, settings, &labelling, progress, &mut skipped)?;
    observe(&clips, &settings.out, start_mean, progress)?;
    let visual_size = if settings.audio_only {
        0
    } else if settings.lips {
        lips::see(&mut clips, settings, progress, &mut skipped)?
    } else {
        visual::see(&mut clips, settings, progress, &mut skipped)?
    };

    clips.sort_by(|a, b| a.clip.id.cmp(&b.clip.id));
    let manifest = Manifest {
        version: MANIFEST_VERSION,
        corpus: settings.corpus.display().to_string(),
        start_mean: start_mean.to_vec(),
        visual_size,
        lips: settings.lips,
        clips: clips.iter().map(|c| c.clip.clone()).collect(),
        skipped,
    };
    manifest
        .check()
        .context("the manifest that was made is unsound")?;
    sweep(settings, &manifest)?;
    let text = serde_json::to_vec_pretty(&manifest)?;
    files::write_bytes(&settings.out.join("manifest.json"), &text).map_err(Error::other)?;
    let mut summary = summary::summarise(settings, &found, &clips, manifest);
    summary.seconds_taken = began.elapsed().as_secs_f64();
    Ok(summary)
}

/// Makes the output folder ours: it is empty, or was prepared before. Its manifest goes until the end.
fn claim(out: &Path, fresh: bool) -> Result<()> {
    if out.is_dir() {
        let occupied = std::fs::read_dir(out)
            .with_context(|| format!("cannot read {}", out.display()))?
            .next()
            .is_some();
        if occupied && !out.join("manifest.json").is_file() && !out.join("cache").is_dir() {
            bail!(
                Choice,
                "{} is not empty and no feature folder; give a new folder",
                out.display()
            );
        }
    }
    let cache = out.join("cache");
    if fresh && cache.is_dir() {
        std::fs::remove_dir_all(&cache).with_context(|| format!("cannot remove {}", cache.display()))?;
    }
    std::fs::create_dir_all(&cache).with_context(|| format!("cannot make {}", out.display()))?;
    match std::fs::remove_file(out.join("manifest.json")) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
            Err(e).with_context(|| format!("cannot replace {}", out.join("manifest.json").display()))
        }
        _ => Ok(()),
    }
}

/// One line of an error, for the manifest and the user's terminal.
pub(super) fn reason(error: &Error) -> String {
    chain(error).lines().collect::<Vec<_>>().join("; ")
}

/// First pass: sound to `wav/`, labels, words; the mean of the statics over the training clips' speech.
fn listen(
    found: &Found,
    late: &BTreeMap<String, f32>,
    settings: &PrepareSettings,
    labelling: &Labelling,
    progress: &dyn Progress,
    skipped: &mut Vec<Skipped>,
) -> Result<(Vec<Prepared>, [f32; lipstream_core::N_STATIC])> {
    let (mut train, mut others) = (SpeechMean::default(), SpeechMean::default());
    let mut clips = Vec::with_capacity(found.clips.len());
    let steps = Steps::begin(progress, "sound and labels", found.clips.len());
    for some in found
        .clips
        .chunks(CLIPS_PER_THREAD * rayon::current_num_threads())
    {
        let read: Vec<_> = some
            .par_iter()
            .map(|source| {
                let late_ms = late
                    .get(&source.speaker)
                    .copied()
                    .filter(|_| source.video.is_some());
                let result = listen_to(source, late_ms.unwrap_or(0.0), &settings.out, labelling);
                let path = source.sound_path().display();
                match &result {
                    Err(error) => progress.warn(&format!("skipped {path}: {}", reason(error))),
                    Ok((clip, _)) if clip.heard == Heard::Otherwise => progress.warn(&format!(
                        "{path}: its words do not fit what is heard in it; check them"
                    )),
                    Ok(_) => {}
                }
                steps.made();
                result
            })
            .collect();
        // In the order of the clips, so that the mean is the same whatever the number of threads.
        for (source, result) in some.iter().zip(read) {
            match result {
                Ok((clip, statics)) => {
                    let mean = if source.split == Split::Train {
                        &mut train
                    } else {
                        &mut others
                    };
                    mean.add(statics.view());
                    clips.push(clip);
                }
                Err(error) => skipped.push(Skipped {
                    path: source.sound_path().display().to_string(),
                    reason: reason(&error),
                }),
            }
        }
    }
    if clips.is_empty() {
        bail!(
            Data,
            "none of the {} clips in {} can be read (the first: {})",
            found.clips.len(),
            settings.corpus.display(),
            skipped.first().map_or("", |s| s.reason.as_str())
        );
    }
    let mean = train.mean().or(others.mean()).ok_or_else(|| {
        Error::Data(format!(
            "no speech is heard in the {} clips: all of them are silent or steady noise",
            clips.len()
        ))
    })?;
    Ok((clips, mean))
}

fn listen_to(
    source: &ClipFiles,
    late_ms: f32,
    out: &Path,
    labelling: &Labelling,
) -> Result<(Prepared, ndarray::Array2<f64>)> {
    let sound_stamp = stamp::of_file(source.sound_path())? + &mend::stamp_of(late_ms);
    let samples = sound(source, late_ms, out, &sound_stamp)?;
    let seconds = samples.len() as f64 / f64::from(lipstream_core::SAMPLE_RATE_HZ);
    if seconds < SHORTEST_S {
        bail!(Data, "{seconds:.3} s of sound are too short");
    }
    let mut labels = labels::read(&source.labels, seconds)?;
    labels.move_by(-f64::from(late_ms) * 1e-3, seconds);
    let named_sentence = labels == Labels::default() && source.labels.is_empty();
    let named = named_sentence
        .then(|| transcript::of_grid_name(&source.stem))
        .flatten();
    let named_sentence = named.is_some();
    if let Some(words) = named {
        labels.words = words;
    }
    let mut from = BTreeMap::new();
    let words = labels
        .words
        .iter()
        .map(|word| spoken(word, &labelling.pronouncer, &mut from))
        .collect::<Result<_>>()?;
    let phones = labels.phones.iter().map(|(start, end, phone)| PhoneLabel {
        phone: phone.name().to_owned(),
        start: *start as f32,
        end: *end as f32,
    });
    let statics = reference::live_statics(&samples);
    let mut clip = Clip {
        id: source.id.clone(),
        speaker: source.speaker.clone(),
        split: source.split,
        audio_frames: statics.nrows(),
        video_frames: 0,
        phones_from: PhonesFrom::Labels,
        video_hz: 0.0,
        words,
        phones: phones.filter(|p| p.end > p.start).collect(),
    };
    let heard = labelling.listener.hear(&mut clip, &samples)?;
    if heard == Heard::Otherwise && labelling.only_what_fits {
        let words: Vec<&str> = clip.words.iter().map(|w| w.text.as_str()).collect();
        bail!(
            Data,
            "its words do not fit what is heard in it: {}",
            words.join(" ")
        );
    }
    let prepared = Prepared {
        source: source.clone(),
        clip,
        words: from,
        named_sentence,
        heard,
        seconds,
        sound_stamp,
    };
    Ok((prepared, statics))
}

/// A word with its pronunciations; `from` learns where they came from.
fn spoken(
    word: &SpokenWord,
    pronouncer: &Pronouncer,
    from: &mut BTreeMap<String, pronounce::Origin>,
) -> Result<Word> {
    let (spoken, source) = pronouncer.spoken(word)?;
    from.insert(word.text.clone(), source);
    Ok(spoken)
}

/// The clip's sound, 16 kHz mono, from `wav/` if an earlier run has put it there, else decoded and put there.
fn sound(source: &ClipFiles, late_ms: f32, out: &Path, sound_stamp: &str) -> Result<Vec<i16>> {
    let path = out.join("wav").join(format!("{}.wav", source.id));
    let notes = Notes::new(out, &source.id);
    if notes.vouched("sound", sound_stamp, &path).is_some() {
        return Ok(sound::read(&path).map_err(Error::other)?.samples);
    }
    notes.forget("sound");
    let from = source.sound_path();
    let mut samples = if is_read_here(from) {
        sound::read(from).map_err(Error::other)?.samples
    } else {
        sound::decode(&video::decode_sound(from).map_err(Error::other)?)
            .map_err(Error::other)?
            .samples
    };
    mend::moved(&mut samples, late_ms);
    sound::write(&path, &samples).map_err(Error::other)?;
    notes.note("sound", sound_stamp)?;
    Ok(samples)
}

/// Whether sound is read without ffmpeg; that of video files never is.
fn is_read_here(path: &Path) -> bool {
    let ending = path.extension().unwrap_or_default().to_ascii_lowercase();
    ending.to_str().is_some_and(|e| discover::SOUND.contains(&e)) && sound::knows(path)
}

/// Second pass: audio observations from `wav/` to `audio/`.
fn observe(
    clips: &[Prepared],
    out: &Path,
    start_mean: [f32; lipstream_core::N_STATIC],
    progress: &dyn Progress,
) -> Result<()> {
    let steps = Steps::begin(progress, "audio features", clips.len());
    let mean: Vec<String> = start_mean
        .iter()
        .map(|v| format!("{:08x}", v.to_bits()))
        .collect();
    let normalisation = Normalisation::Causal { start_mean };
    clips.par_iter().try_for_each(|prepared| {
        observe_one(prepared, out, &mean.concat(), normalisation)
            .with_context(|| format!("audio features of {}", prepared.source.sound_path().display()))?;
        steps.made();
        Ok::<(), Error>(())
    })?;
    Ok(())
}

fn observe_one(prepared: &Prepared, out: &Path, mean: &str, normalisation: Normalisation) -> Result<()> {
    let id = &prepared.clip.id;
    let path = out.join("audio").join(format!("{id}.npy"));
    let stamp = format!("{} {mean}", prepared.sound_stamp);
    let notes = Notes::new(out, id);
    if notes.vouched("audio", &stamp, &path).is_some() {
        return Ok(());
    }
    notes.forget("audio");
    let samples = sound::read(&out.join("wav").join(format!("{id}.wav")))
        .map_err(Error::other)?
        .samples;
    npy::write_npy(&path, &reference::observations(&samples, normalisation)).map_err(Error::other)?;
    notes.note("audio", &stamp)
}

/// Removes what earlier runs made for clips that are no longer there.
fn sweep(settings: &PrepareSettings, manifest: &Manifest) -> Result<()> {
    let out = settings.out.as_path();
    let ids: BTreeSet<&str> = manifest.clips.iter().map(|c| c.id.as_str()).collect();
    let seen: BTreeSet<&str> = manifest
        .clips
        .iter()
        .filter(|c| c.video_frames > 0)
        .map(|c| c.id.as_str())
        .collect();
    for (folder, extensions, keep) in [
        ("wav", &["wav"][..], &ids),
        ("audio", &["npy"], &ids),
        ("visual", &["npy"], &seen),
        // Dear to make: a run without pictures leaves them for the next one with.
        ("mouths", &["npy"], if settings.audio_only { &ids } else { &seen }),
        ("overlay", &["mp4"], &seen),
        ("cache", &["sound", "audio", "mouths", "visual", "overlay"], &ids),
    ] {
        let Ok(entries) = std::fs::read_dir(out.join(folder)) else {
            continue;
        };
        for entry in entries {
            let path = entry?.path();
            let ours = path
                .extension()
                .and_then(|e| e.to_str())
                .is_some_and(|e| extensions.contains(&e));
            let stem = path.file_stem().and_then(|s| s.to_str()).unwrap_or_default();
            if ours && !keep.contains(stem) {
                std::fs::remove_file(&path).with_context(|| format!("cannot remove {}", path.display()))?;
            }
        }
    }
    let mouth = FeatureFolder {
        root: out.to_owned(),
        manifest: manifest.clone(),
    }
    .mouth_path();
    if manifest.visual_size == 0 && mouth.is_file() {
        std::fs::remove_file(&mouth).with_context(|| format!("cannot remove {}", mouth.display()))?;
    }
    Ok(())
}
