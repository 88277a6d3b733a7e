//! How still the mouth is where nobody speaks: what moves there is the tracker's own unrest, or a mouth that is not at rest.
use std::path::Path;

use lipstream_media::video::Facts;
use serde::Serialize;

use super::sound::Activity;
use super::watch;
use crate::error::Result;
use crate::vision::shift::{luminance, mean, shift};
use crate::vision::{MouthTrack, Tracker};

/// Windows of the take that are tracked, and how long each is, seconds: those with the longest pauses.
const WINDOWS: usize = 3;
const WINDOW_S: f64 = 4.0;
/// Pictures of each that the face is learnt from.
const REFERENCE_PICTURES: usize = 24;
/// Fewer pictures in a row are no pause.
const LEAST_PICTURES: usize = 6;

/// How far the registered mouth moves in pauses, as shares of the face's width.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StillnessReport {
    /// Pauses that were looked at.
    pub pauses: usize,
    /// Pictures in them.
    pub pictures: usize,
    /// Root mean square of the distance from the pause's mean place.
    pub deviation: f32,
    /// Its 95th percentile.
    pub percentile_95: f32,
}

/// Tracks windows of the pictures `parts` (first, count) as `prepare` would and registers the mouth images of each pause to their mean; None where
/// there are no pauses, or no face that can be tracked.
pub(crate) fn measure(
    path: &Path,
    facts: Facts,
    parts: &[(usize, usize)],
    activity: &Activity,
    face_width: f32,
) -> Result<Option<StillnessReport>> {
    let rate = f64::from(facts.rate_hz);
    let paused = |picture: usize| activity.is_pause((picture as f64 + 0.5) / rate);
    let long = (WINDOW_S * rate) as usize;
    let mut windows: Vec<(usize, usize, usize)> = parts
        .iter()
        .flat_map(|(first, count)| {
            let windows = (0..*count).step_by(long.max(1));
            windows.map(move |from| (first + from, long.min(count - from)))
        })
        .map(|(first, count)| {
            (
                (first..first + count).filter(|k| paused(*k)).count(),
                first,
                count,
            )
        })
        .filter(|(pictures, ..)| *pictures >= LEAST_PICTURES)
        .collect();
    windows.sort_by_key(|(pictures, ..)| std::cmp::Reverse(*pictures));
    windows.truncate(WINDOWS);
    let mut reference = Vec::new();
    for (_, first, count) in &windows {
        let frames = watch::decode(path, facts, *first, *count)?;
        reference.push(frames.thinned((frames.len() / REFERENCE_PICTURES).max(1)));
    }
    let Some(tracker) = (!reference.is_empty())
        .then(|| Tracker::reference(&reference).ok())
        .flatten()
    else {
        return Ok(None);
    };
    let mut pauses = 0;
    let mut distances: Vec<f32> = Vec::new();
    for (_, first, count) in windows {
        let frames = watch::decode(path, facts, first, count)?;
        // A window whose face is lost is said elsewhere.
        let Ok(track) = tracker.track(&frames) else {
            continue;
        };
        let still: Vec<bool> = (first..first + track.len()).map(paused).collect();
        let mut from = 0;
        for run in still.chunk_by(|a, b| a == b) {
            if run[0] && run.len() >= LEAST_PICTURES {
                pauses += 1;
                distances.extend(distances_of(&track, from..from + run.len(), face_width));
            }
            from += run.len();
        }
    }
    distances.sort_by(f32::total_cmp);
    let squares = distances.iter().map(|d| d * d).sum::<f32>();
    let Some(percentile_95) = distances.get(distances.len() * 19 / 20).copied() else {
        return Ok(None);
    };
    Ok(Some(StillnessReport {
        pauses,
        pictures: distances.len(),
        deviation: (squares / distances.len() as f32).sqrt(),
        percentile_95,
    }))
}

/// How far each mouth of a pause lies from their mean, as shares of the face's width.
fn distances_of(track: &MouthTrack, pause: std::ops::Range<usize>, face_width: f32) -> Vec<f32> {
    let images: Vec<_> = pause
        .clone()
        .map(|index| luminance(track.image(index), track.width, track.height))
        .collect();
    let Some(mean) = mean(&images) else {
        return Vec::new();
    };
    let scale = |index: usize| {
        let [a, _, _, d, ..] = track.transforms[index].0;
        a.hypot(d)
    };
    let found = pause.zip(&images).filter_map(|(index, image)| {
        let (dx, dy) = shift(image, &mean)?;
        Some(dx.hypot(dy) * scale(index) / face_width)
    });
    found.collect()
}
