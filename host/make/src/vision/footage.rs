//! A video as the background of a face: its pictures, and where mouth and jaw lie in each.
//!
//! The same tracker as for training, learnt from the video itself; it goes over the video in pieces, so that memory does not grow with it.
use std::path::Path;

use lipstream::affine::Affine;
use lipstream::progress::{Progress, Steps};
use lipstream::render::face::{Edge, Footage, Jaw, Pictures, Place};
use lipstream_media::video::{self, Frames, Part};
use rayon::prelude::*;

use super::face::{Detector, median};
use super::landmarks::{LandmarkFinder, Landmarks, Walk};
use super::tracker::Tracker;
use crate::error::{Context as _, Error, Result, bail};

/// Of the video, so much is used, seconds: pictures lie on the disk, and a minute has every motion that a head makes.
pub const LONGEST_S: f64 = 60.0;
/// The shorter side of a background is reduced to this many lines, where it has more.
const MAX_LINES: usize = 1080;
/// Pictures of a piece, and those before and after it that a piece is tracked with, so that its ends are as steady as its middle.
const PIECE: usize = 150;
const MARGIN: usize = 8;
/// Pictures that the face is learnt from.
const REFERENCE_PICTURES: usize = 64;
/// A background is at least so many pictures.
const LEAST_PICTURES: usize = 8;

/// Finds the face in every picture of a video, of at most `longest_s` seconds of it; what is left out is said.
///
/// # Errors
///
/// That the video cannot be read, that no face is found in it, or none for long enough.
pub fn footage(path: &Path, longest_s: f64, progress: &dyn Progress) -> Result<Footage> {
    let (mut pictures, rate_hz) = read(path, longest_s, progress)?;
    let tracker = reference(&mut pictures, rate_hz)
        .with_context(|| format!("the face in {} cannot be learnt", path.display()))?;
    let pieces: Vec<(usize, usize)> = (0..pictures.len())
        .step_by(PIECE)
        .map(|from| (from, (from + PIECE).min(pictures.len())))
        .collect();
    let steps = Steps::begin(progress, "background", pictures.len());
    let mut found: Vec<Option<Seen>> = Vec::with_capacity(pictures.len());
    let mut trouble = None;
    // Two at a time: each holds its pictures.
    for some in pieces.chunks(2) {
        let mut jobs = Vec::new();
        for (from, to) in some {
            jobs.push((*from, *to, with_margin(&mut pictures, rate_hz, *from, *to)?));
        }
        let tracked: Vec<Result<Vec<Seen>>> = jobs
            .par_iter()
            .map(|(from, to, (frames, begins))| {
                let seen = seen(&tracker, frames)?;
                (*from..*to).for_each(|_| steps.made());
                Ok(seen[from - begins..to - begins].to_vec())
            })
            .collect();
        for ((from, to, _), tracked) in jobs.iter().zip(tracked) {
            match tracked {
                Ok(seen) => found.extend(seen.into_iter().map(Some)),
                Err(error) => {
                    progress.say(&format!(
                        "{} from {:.1} to {:.1} s is no background: {error}",
                        path.display(),
                        *from as f32 / rate_hz,
                        *to as f32 / rate_hz
                    ));
                    found.extend((*from..*to).map(|_| None));
                    trouble = Some(error);
                }
            }
        }
    }
    let (from, to) = longest_run(&found);
    if to - from < LEAST_PICTURES.min(found.len()) {
        return Err(trouble.unwrap_or_else(|| Error::Data("it has no picture with a face".into())))
            .with_context(|| format!("{} is no background", path.display()));
    }
    let seen: Vec<Seen> = found.into_iter().skip(from).take(to - from).flatten().collect();
    let kept = match seen.len() == pictures.len() {
        true => pictures,
        false => only(&mut pictures, from, to)?,
    };
    Ok(Footage {
        pictures: kept,
        rate_hz,
        mouth: tracker.mouth_size(),
        jaw: jaw(&seen),
        places: places(seen),
    })
}

/// What is found in one picture.
#[derive(Clone)]
struct Seen {
    mouth: Affine,
    /// Nose's base, chin, left and right edge of the face at the lips' height, in pixels of the mouth's rectangle.
    points: Option<[(f32, f32); 4]>,
    jaw: Option<f32>,
    turned: f32,
    lips: Option<(f32, f32)>,
}

/// The first pictures of a video, and its rate.
fn read(path: &Path, longest_s: f64, progress: &dyn Progress) -> Result<(Pictures, f32)> {
    let part = Part {
        begins_s: 0.0,
        seconds: longest_s,
    };
    let mut pictures: Option<Pictures> = None;
    let each = |width: usize, height: usize, rgb: &[u8]| -> Result<()> {
        let all = match &mut pictures {
            Some(all) => all,
            None => pictures.insert(Pictures::new(width, height).map_err(Error::other)?),
        };
        all.push(rgb).map_err(Error::other)
    };
    let rate_hz = video::each_picture(path, Some(part), MAX_LINES, each)?;
    let Some(pictures) = pictures else {
        bail!(Data, "there is no picture in {}", path.display());
    };
    if pictures.len() as f64 / f64::from(rate_hz) > longest_s - 0.5 {
        progress.say(&format!(
            "{}: its first {longest_s:.0} s are the background",
            path.display()
        ));
    }
    Ok((pictures, rate_hz))
}

/// Pictures `from..to`, as the tracker takes them.
fn frames(pictures: &mut Pictures, rate_hz: f32, which: impl Iterator<Item = usize>) -> Result<Frames> {
    let (width, height) = pictures.size();
    let (mut rgb, mut one) = (Vec::new(), Vec::new());
    for index in which {
        pictures.read(index, &mut one).map_err(Error::other)?;
        rgb.extend_from_slice(&one);
    }
    Ok(Frames {
        width,
        height,
        rate_hz,
        rgb,
    })
}

/// Learns the face from pictures of the whole video.
fn reference(pictures: &mut Pictures, rate_hz: f32) -> Result<Tracker> {
    let step = pictures.len().div_ceil(REFERENCE_PICTURES).max(1);
    let thinned = (0..pictures.len()).step_by(step);
    Tracker::reference(&[frames(pictures, rate_hz / step as f32, thinned)?])
}

/// A piece with some pictures before and after it, and the number of the first of them.
fn with_margin(pictures: &mut Pictures, rate_hz: f32, from: usize, to: usize) -> Result<(Frames, usize)> {
    let begins = from.saturating_sub(MARGIN);
    let ends = (to + MARGIN).min(pictures.len());
    Ok((frames(pictures, rate_hz, begins..ends)?, begins))
}

/// The face in every picture of a piece.
fn seen(tracker: &Tracker, frames: &Frames) -> Result<Vec<Seen>> {
    let track = tracker.track(frames)?;
    let face = Detector::new()?.find_in_clip(frames)?;
    let mut walk = Walk::new(LandmarkFinder::new()?, frames);
    let of = |(index, mouth): (usize, &Affine)| {
        let landmarks = walk.at(index, [face]);
        let in_mouth = mouth.inverse();
        let seen = landmarks.as_ref();
        Seen {
            mouth: *mouth,
            points: seen
                .zip(in_mouth)
                .map(|(landmarks, map)| landmarks.lower_face(&map)),
            jaw: seen.map(Landmarks::jaw),
            turned: seen.map_or(0.0, Landmarks::turned),
            lips: seen.map(Landmarks::opening),
        }
    };
    Ok(track.transforms.iter().enumerate().map(of).collect())
}

/// First and end of the longest run of pictures with a face.
fn longest_run(found: &[Option<Seen>]) -> (usize, usize) {
    let (mut best, mut from) = ((0, 0), 0);
    for at in 0..=found.len() {
        if found.get(at).is_none_or(Option::is_none) {
            if at - from > best.1 - best.0 {
                best = (from, at);
            }
            from = at + 1;
        }
    }
    best
}

/// Some of the pictures.
fn only(pictures: &mut Pictures, from: usize, to: usize) -> Result<Pictures> {
    let (width, height) = pictures.size();
    let mut kept = Pictures::new(width, height).map_err(Error::other)?;
    let mut rgb = Vec::new();
    for index in from..to {
        pictures.read(index, &mut rgb).map_err(Error::other)?;
        kept.push(&rgb).map_err(Error::other)?;
    }
    Ok(kept)
}

/// Where the jaw's outline runs; None where landmarks are seen in less than half of the pictures.
fn jaw(seen: &[Seen]) -> Option<Jaw> {
    let points: Vec<[(f32, f32); 4]> = seen.iter().filter_map(|seen| seen.points).collect();
    if points.is_empty() || 2 * points.len() < seen.len() {
        return None;
    }
    let middle = |of: fn(&[(f32, f32); 4]) -> f32| median(points.iter().map(of));
    // A turned head's cheek is nearer: the region is inside the face in nine of ten pictures.
    let sorted = |of: fn(&[(f32, f32); 4]) -> f32| {
        let mut all: Vec<f32> = points.iter().map(of).collect();
        all.sort_by(f32::total_cmp);
        all
    };
    let (left, right) = (sorted(|p| p[2].0), sorted(|p| p[3].0));
    let tenth = points.len() / 10;
    let lowest = points
        .iter()
        .map(|[_, chin, ..]| chin.1)
        .fold(f32::NEG_INFINITY, f32::max);
    Some(Jaw {
        sides: (left[left.len() - 1 - tenth], right[tenth]),
        top: middle(|p| p[0].1),
        bottom: lowest,
    })
}

/// Places whose jaw is steadied over three pictures: landmarks tremble.
fn places(seen: Vec<Seen>) -> Vec<Place> {
    let steady = |at: usize| {
        let around = &seen[at.saturating_sub(1)..(at + 2).min(seen.len())];
        let jaws: Vec<f32> = around.iter().filter_map(|seen| seen.jaw).collect();
        (!jaws.is_empty()).then(|| jaws.iter().sum::<f32>() / jaws.len() as f32)
    };
    (0..seen.len())
        .map(|at| Place {
            mouth: seen[at].mouth,
            jaw: steady(at),
            turned: seen[at].turned,
            lips: seen[at].lips,
            edge: seen[at]
                .points
                .map(|[_, chin, left, right]| Edge { left, right, chin }),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(jaw: Option<f32>) -> Seen {
        Seen {
            mouth: Affine::IDENTITY,
            points: jaw.map(|jaw| [(30.0, 2.0), (31.0, 60.0 + jaw), (-5.0, 30.0), (70.0, 30.0)]),
            jaw,
            turned: 0.0,
            lips: None,
        }
    }

    #[test]
    fn the_longest_run_is_kept() {
        let of = |marks: &str| -> Vec<Option<Seen>> {
            marks.bytes().map(|m| (m == b'x').then(|| seen(None))).collect()
        };
        assert_eq!(longest_run(&of("xx.xxxx.x")), (3, 7));
        assert_eq!(longest_run(&of("xxxx")), (0, 4));
        assert_eq!(longest_run(&of("...")), (0, 0));
    }

    #[test]
    fn the_jaw_is_steadied_and_its_outline_reaches_the_lowest_chin() {
        let all: Vec<Seen> = [1.0, 1.0, 4.0, 1.0].map(|jaw| seen(Some(jaw))).into();
        let outline = jaw(&all).unwrap();
        assert_eq!(
            (outline.sides, outline.top, outline.bottom),
            ((-5.0, 70.0), 2.0, 64.0)
        );
        let jaws: Vec<f32> = places(all).iter().filter_map(|place| place.jaw).collect();
        assert_eq!(jaws, [1.0, 2.0, 2.0, 2.5]);
        assert_eq!(jaw(&[seen(None), seen(None), seen(Some(1.0))]), None);
    }
}
