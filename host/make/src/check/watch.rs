//! Goes through stretches of a take and looks at the face in their pictures.
use std::path::Path;

use lipstream_media::video::{self, Facts, Frames, Part};
use rayon::prelude::*;

use super::looks::{Look, look};
use crate::error::{Error, Result};
use crate::vision::{Detector, LandmarkFinder, Walk};
use lipstream::progress::{Progress, Steps};

/// So much is decoded at once, seconds: pictures are large.
const AT_ONCE_S: f64 = 4.0;
/// A video that is as short as this is decoded whole, without looking for a place in it.
const SHORT_S: f64 = 8.5;
/// Of faster videos every second, third … picture is looked at.
const MOST_HZ: f32 = 31.0;
/// A second face counts from this share of the largest one's width.
const LARGE: f32 = 0.5;

/// The pictures of one stretch.
#[derive(Clone, Debug, Default)]
pub(crate) struct Watched {
    /// Where it begins in the video, seconds.
    pub(crate) begins_s: f64,
    /// Looks a second; look `k` is of the picture that is shown from `begins_s + k / rate_hz`.
    pub(crate) rate_hz: f32,
    /// None where no face is seen.
    pub(crate) looks: Vec<Option<Look>>,
    /// Faces in pictures that were searched for all of them.
    pub(crate) faces: Vec<usize>,
}

/// A stretch brought to whole pictures, so that a picture's number says when it is shown: first picture, number of pictures.
pub(crate) fn in_pictures(part: Part, rate_hz: f32) -> (usize, usize) {
    let rate = f64::from(rate_hz);
    let first = (part.begins_s * rate).round();
    let last = ((part.begins_s + part.seconds) * rate).floor();
    (first as usize, (last - first).max(0.0) as usize)
}

/// Decodes pictures by their numbers. What is asked for begins and ends between two pictures: none is lost or shifted by rounding.
pub(crate) fn decode(path: &Path, facts: Facts, first: usize, count: usize) -> Result<Frames> {
    let rate = f64::from(facts.rate_hz);
    let part = Part {
        begins_s: ((first as f64 - 0.25) / rate).max(0.0),
        seconds: (count as f64 - if first == 0 { 0.5 } else { 0.25 }) / rate,
    };
    video::decode_part(path, Some(part)).map_err(Error::other)
}

/// Looks at the pictures of `parts`, on all cores.
pub(crate) fn watch(
    path: &Path,
    facts: Facts,
    parts: &[Part],
    progress: &dyn Progress,
) -> Result<Vec<Watched>> {
    let per_part: Vec<Vec<(usize, usize)>> = parts
        .iter()
        .map(|part| pieces(in_pictures(*part, facts.rate_hz), facts.rate_hz, part))
        .collect();
    let steps = Steps::begin(progress, "pictures", per_part.iter().map(Vec::len).sum());
    let watched: Vec<Vec<Result<Watched>>> = per_part
        .par_iter()
        .map(|pieces| {
            pieces
                .par_iter()
                .map(|piece| {
                    let watched = watch_piece(path, facts, *piece);
                    steps.made();
                    watched
                })
                .collect()
        })
        .collect();
    watched
        .into_iter()
        .map(|pieces| {
            let mut joined: Option<Watched> = None;
            for piece in pieces {
                let piece = piece?;
                match &mut joined {
                    None => joined = Some(piece),
                    Some(joined) => {
                        joined.looks.extend(piece.looks);
                        joined.faces.extend(piece.faces);
                    }
                }
            }
            Ok(joined.unwrap_or_default())
        })
        .collect()
}

/// What is decoded at once. Pieces are whole numbers of looks, so that these stay evenly spaced.
fn pieces((first, count): (usize, usize), rate_hz: f32, part: &Part) -> Vec<(usize, usize)> {
    if part.begins_s == 0.0 && part.seconds <= SHORT_S {
        return vec![(0, count)];
    }
    let step = step(rate_hz);
    let most = ((AT_ONCE_S * f64::from(rate_hz)) as usize / step * step).max(step);
    (0..count)
        .step_by(most)
        .map(|from| (first + from, most.min(count - from)))
        .collect()
}

fn step(rate_hz: f32) -> usize {
    (rate_hz / MOST_HZ).ceil().max(1.0) as usize
}

fn watch_piece(path: &Path, facts: Facts, (first, count): (usize, usize)) -> Result<Watched> {
    let frames = decode(path, facts, first, count)?;
    let count = count.min(frames.len());
    let mut detector = Detector::new()?;
    let mut walk = Walk::new(LandmarkFinder::new()?, &frames);
    let step = step(facts.rate_hz);
    let looks = (0..count)
        .step_by(step)
        .map(|index| {
            let detected = std::iter::once_with(|| detector.find(&frames, index));
            let found = walk.at(index, detected.flatten())?;
            Some(look(&frames, index, &found))
        })
        .collect();
    let faces = [count / 4, 3 * count / 4]
        .into_iter()
        .filter(|index| *index < count)
        .map(|index| {
            let faces = detector.find_all(&frames, index);
            let largest = faces.first().map_or(0.0, |face| face.side);
            faces.iter().filter(|face| face.side >= LARGE * largest).count()
        })
        .collect();
    Ok(Watched {
        begins_s: first as f64 / f64::from(facts.rate_hz),
        rate_hz: facts.rate_hz / step as f32,
        looks,
        faces,
    })
}
