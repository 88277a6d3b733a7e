//! Sound that is late or early against its pictures by a constant time, put in its place before anything is learnt from it.
//!
//! Sound is moved, and with it the labels that tell its times; pictures are not. Nothing is done unless the offset is sure, the same in all
//! thirds of what was looked at, and large enough to matter (`docs/check.md`).
use std::collections::BTreeMap;
use std::path::Path;

use lipstream_core::SAMPLE_RATE_HZ;

use super::discover::{ClipFiles, safe};
use super::prepare::PrepareSettings;
use super::stamp::{self, Notes};
use crate::check::{self, NO_OFFSET_MS, SyncReport};
use crate::error::Result;
use lipstream::progress::Progress;

/// Clips of a speaker that are looked at.
const CLIPS: usize = 20;

/// Changes when the same videos are found to have another offset.
const VERSION: u32 = 1;

/// Samples that come `late_ms` earlier than they did (later, where it is negative); as many as before, silence where nothing is known.
pub(super) fn moved(samples: &mut Vec<i16>, late_ms: f32) {
    let length = samples.len();
    let by = (f64::from(late_ms) * 1e-3 * f64::from(SAMPLE_RATE_HZ)).round();
    let count = (by.abs() as usize).min(length);
    if by >= 0.0 {
        samples.drain(..count);
        samples.resize(length, 0);
    } else {
        samples.splice(..0, std::iter::repeat_n(0, count));
        samples.truncate(length);
    }
}

/// What a stamp says of an offset: nothing where there is none, so that what was prepared before still holds.
pub(super) fn stamp_of(late_ms: f32) -> String {
    match late_ms == 0.0 {
        true => String::new(),
        false => format!(" late {late_ms:.1}"),
    }
}

/// By how many milliseconds the sound of one long video is late; 0 where that is nothing, or nothing that can be mended.
pub(super) fn of_take(take: &Path, settings: &PrepareSettings, progress: &dyn Progress) -> Result<f32> {
    if let Some(late_ms) = settings.sync_offset_ms {
        return Ok(late_ms);
    }
    let name = take
        .file_stem()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    late_ms(&name, &[(take, None)], settings, progress)
}

/// The same for every speaker of a corpus, over some of his clips together.
pub(super) fn of_speakers(
    clips: &[ClipFiles],
    settings: &PrepareSettings,
    progress: &dyn Progress,
) -> Result<BTreeMap<String, f32>> {
    let mut speakers: BTreeMap<&str, Vec<(&Path, Option<&Path>)>> = BTreeMap::new();
    for clip in clips {
        if let Some(video) = &clip.video {
            speakers
                .entry(&clip.speaker)
                .or_default()
                .push((video, clip.sound.as_deref()));
        }
    }
    let mut late = BTreeMap::new();
    for (speaker, all) in speakers {
        let ms = match settings.sync_offset_ms {
            Some(ms) => ms,
            None => {
                let count = all.len().min(CLIPS);
                let some: Vec<_> = (0..count)
                    .map(|n| all[(2 * n + 1) * all.len() / (2 * count)])
                    .collect();
                late_ms(speaker, &some, settings, progress)?
            }
        };
        late.insert(speaker.to_owned(), ms);
    }
    Ok(late)
}

/// Estimates, or takes over what an earlier run has estimated of the same files.
fn late_ms(
    speaker: &str,
    videos: &[(&Path, Option<&Path>)],
    settings: &PrepareSettings,
    progress: &dyn Progress,
) -> Result<f32> {
    if settings.audio_only {
        return Ok(0.0);
    }
    let mut inputs = Vec::new();
    for (video, sound) in videos {
        inputs.push(stamp::of_file(video)?);
        if let Some(sound) = sound {
            inputs.push(stamp::of_file(sound)?);
        }
    }
    let stamp = format!("{VERSION} {:016x}", stamp::digest(&inputs.join("\n")));
    let notes = Notes::new(&settings.out, &safe(speaker));
    if let Some(noted) = notes.noted("sync", &stamp)
        && let Ok(late_ms) = noted.parse()
    {
        return Ok(late_ms);
    }
    let found = check::offset_of(videos, progress)?;
    let (late_ms, words) = found.map_or((0.0, None), |found| judged(&found));
    if let Some(words) = words {
        progress.say(&format!("{speaker}: {words}"));
    }
    notes.note_with("sync", &stamp, &late_ms.to_string())?;
    Ok(late_ms)
}

/// What to do about an offset, and what to say.
fn judged(found: &SyncReport) -> (f32, Option<String>) {
    let offset = found.offset_ms.round();
    let side = if offset > 0.0 { "late" } else { "early" };
    if !found.is_sure() || offset.abs() < NO_OFFSET_MS {
        return (0.0, None);
    }
    if found.is_constant() == Some(false) {
        let words = format!(
            "sound is {:.0} ms {side}, and not by the same time everywhere: not mended",
            offset.abs()
        );
        return (0.0, Some(words));
    }
    (
        offset,
        Some(format!("sound is {:.0} ms {side}: mended", offset.abs())),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sound_is_moved_and_keeps_its_length() {
        let made: Vec<i16> = (1..=100).collect();
        let by = |late_ms: f32| {
            let mut samples = made.clone();
            moved(&mut samples, late_ms);
            assert_eq!(samples.len(), 100);
            samples
        };
        assert_eq!(by(0.0), made);
        // 1 ms is 16 samples.
        assert_eq!(by(1.0)[..84], made[16..]);
        assert_eq!(by(1.0)[84..], [0; 16]);
        assert_eq!(by(-1.0)[16..], made[..84]);
        assert_eq!(by(-1.0)[..16], [0; 16]);
        assert_eq!((by(1e4), by(-1e4)), (vec![0; 100], vec![0; 100]));
        assert!(stamp_of(0.0).is_empty() && stamp_of(40.0) != stamp_of(80.0));
    }

    #[test]
    fn only_sure_and_constant_offsets_are_mended() {
        let sure = SyncReport {
            offset_ms: 119.7,
            spread_ms: 5.0,
            borne_out: 1.0,
            above_chance: Some(20.0),
            second_peak: 0.1,
            correlation: 0.8,
            energy_correlation: 0.5,
            parts_ms: vec![118.0, 121.0, 122.0],
            seconds: 60.0,
        };
        let (late, words) = judged(&sure);
        assert_eq!(
            (late, words.as_deref()),
            (120.0, Some("sound is 120 ms late: mended"))
        );
        let with = |change: &dyn Fn(&mut SyncReport)| {
            let mut other = sure.clone();
            change(&mut other);
            judged(&other).0
        };
        assert_eq!(with(&|sync| sync.offset_ms = -80.0), -80.0);
        assert_eq!(with(&|sync| sync.offset_ms = 20.0), 0.0);
        assert_eq!(with(&|sync| sync.borne_out = 0.5), 0.0);
        assert_eq!(with(&|sync| sync.above_chance = Some(2.0)), 0.0);
        assert_eq!(with(&|sync| sync.seconds = 3.0), 0.0);
        assert_eq!(with(&|sync| sync.parts_ms = vec![60.0, 120.0, 180.0]), 0.0);
    }
}
