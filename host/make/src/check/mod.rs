//! `check`: whether a take is fit to be trained on, before anything is trained: light, framing, sharpness, sound, sync, whose mouth it is,
//! its rest in pauses, and the phones that are said. `docs/check.md` says what each figure means.
//!
//! Sound is heard whole; of the pictures some stretches with speech are looked at, as many seconds as the settings allow, and never more than some
//! seconds of them are in memory.
pub(crate) mod looks;
pub mod phones;
pub mod picture;
pub(crate) mod series;
pub mod sound;
pub mod stillness;
pub mod sync;
pub mod verdict;
pub(crate) mod watch;

use std::path::Path;

use lipstream_core::{HOP_SAMPLES, SAMPLE_RATE_HZ};
use lipstream_media::video::{self, Part};
use serde::Serialize;

use self::phones::PhoneReport;
use self::picture::{FramingReport, LightReport, SharpnessReport};
use self::sound::{Activity, SoundReport};
use self::stillness::StillnessReport;
use self::sync::Ear;
pub use self::sync::SyncReport;
pub use self::verdict::{Grade, NO_OFFSET_MS, Verdict};
use crate::corpus::take;
use crate::error::{Error, Result, bail};
use lipstream::progress::Progress;
use lipstream_media::sound as sound_files;

/// How closely to look.
#[derive(Clone, Copy, Debug)]
pub struct CheckSettings {
    /// Seconds of pictures that are looked at, at most; they are spread over the take.
    pub look_s: f64,
}

impl Default for CheckSettings {
    fn default() -> Self {
        Self { look_s: 60.0 }
    }
}

/// What was found in one video.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// The video's path.
    pub video: String,
    /// Seconds of pictures that were looked at.
    pub looked_seconds: f64,
    /// None, as framing and sharpness, where no face is seen.
    pub light: Option<LightReport>,
    /// Where the face is.
    pub framing: Option<FramingReport>,
    /// How sharp the mouth is.
    pub sharpness: Option<SharpnessReport>,
    /// What is heard.
    pub sound: SoundReport,
    /// None where no stretch has both speech and a face.
    pub sync: Option<SyncReport>,
    /// None where there are no pauses in which a face is tracked.
    pub stillness: Option<StillnessReport>,
    /// None where nothing tells what is said.
    pub phones: Option<PhoneReport>,
    /// What it means, line by line.
    pub verdicts: Vec<Verdict>,
    /// The worst of the lines.
    pub overall: Grade,
}

/// Checks one video.
///
/// # Errors
///
/// That `ffmpeg` is not there, that the video cannot be read, that it has no sound, and that nobody speaks in it.
pub fn check(path: &Path, settings: &CheckSettings, progress: &dyn Progress) -> Result<Report> {
    video::available().map_err(Error::other)?;
    let facts = video::facts(path).map_err(Error::other)?;
    let bytes = video::decode_sound(path).map_err(Error::other)?;
    let samples = sound_files::decode(&bytes).map_err(Error::other)?.samples;
    drop(bytes);
    let levels = take::levels(&samples);
    let activity = Activity::of(&levels);
    let parts = chosen(&samples, settings.look_s);
    if parts.is_empty() {
        bail!(
            Data,
            "no speech is heard in {}: nothing in it is louder than the rest",
            path.display()
        );
    }
    let watched = watch::watch(path, facts, &parts, progress)?;
    let picture = picture::measure(&watched, facts.reduction, facts.rate_hz);
    let (light, framing, sharpness) =
        picture.map_or((None, None, None), |(l, f, s)| (Some(l), Some(f), Some(s)));
    let sync = sync::estimate(&sync::blocks(&watched, &samples, &Ear::new()?)?);
    let stillness = match &framing {
        Some(framing) => {
            let pictures: Vec<_> = parts
                .iter()
                .map(|part| watch::in_pictures(*part, facts.rate_hz))
                .collect();
            let face_width = framing.face_width / facts.reduction;
            stillness::measure(path, facts, &pictures, &activity, face_width)?
        }
        None => None,
    };
    let sound = sound::measure(&samples, &levels, &activity);
    let mut report = Report {
        video: path.display().to_string(),
        looked_seconds: parts.iter().map(|part| part.seconds).sum(),
        light,
        framing,
        sharpness,
        phones: match PhoneReport::beside(path, sound.seconds)? {
            Some(said) => Some(said),
            None => PhoneReport::heard(&samples)?,
        },
        sound,
        sync,
        stillness,
        verdicts: Vec::new(),
        overall: Grade::Good,
    };
    (report.verdicts, report.overall) = verdict::judge(&report);
    Ok(report)
}

/// The offset of sound against pictures over several videos of one speaker, each with its sound or that of a file beside it; None where nothing can
/// be said. Videos that cannot be read are left out: whoever wants their pictures will say why.
///
/// # Errors
///
/// None, as long as the program is whole.
pub fn offset_of(videos: &[(&Path, Option<&Path>)], progress: &dyn Progress) -> Result<Option<SyncReport>> {
    let look_s = CheckSettings::default().look_s;
    let read = |video: &Path, sound: Option<&Path>| -> Result<_> {
        let facts = video::facts(video).map_err(Error::other)?;
        let bytes = video::decode_sound(sound.unwrap_or(video)).map_err(Error::other)?;
        let samples = sound_files::decode(&bytes).map_err(Error::other)?.samples;
        let parts = chosen(&samples, look_s / videos.len() as f64);
        Ok((facts, samples, parts))
    };
    let read = videos.iter().filter_map(|(video, sound)| {
        let (facts, samples, parts) = read(video, *sound).ok()?;
        Some((*video, facts, samples, parts))
    });
    let read: Vec<_> = read.collect();
    let all_s: f64 = read
        .iter()
        .flat_map(|(.., parts)| parts)
        .map(|part| part.seconds)
        .sum();
    if all_s < f64::from(sync::SURE_SECONDS) {
        return Ok(None);
    }
    let ear = Ear::new()?;
    let mut blocks = Vec::new();
    for (video, facts, samples, parts) in read {
        if let Ok(watched) = watch::watch(video, facts, &parts, progress) {
            blocks.extend(sync::blocks(&watched, &samples, &ear)?);
        }
    }
    Ok(sync::estimate(&blocks))
}

/// Stretches with speech, spread over the take, that last `look_s` together at most (one of them always).
fn chosen(samples: &[i16], look_s: f64) -> Vec<Part> {
    let seconds = |hops: usize| hops as f64 * HOP_SAMPLES as f64 / f64::from(SAMPLE_RATE_HZ);
    let spoken: Vec<_> = take::pieces(samples)
        .into_iter()
        .filter(|piece| piece.speech)
        .collect();
    let all: f64 = spoken.iter().map(|piece| seconds(piece.to - piece.from)).sum();
    let count = match all <= look_s {
        true => spoken.len(),
        false => ((spoken.len() as f64 * look_s / all) as usize).clamp(1, spoken.len()),
    };
    let mut parts: Vec<Part> = Vec::new();
    for n in 0..count {
        let piece = spoken[(2 * n + 1) * spoken.len() / (2 * count)];
        parts.push(Part {
            begins_s: seconds(piece.from),
            seconds: seconds(piece.to - piece.from),
        });
    }
    parts
}
