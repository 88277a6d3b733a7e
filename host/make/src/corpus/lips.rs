//! `prepare --lips`: how open and how wide mouths are, by landmarks, in place of mouth images and eigenmouths: what the videos of many people have in
//! common, each on a scale of its own.
use lipstream::npy::write_npy;
use lipstream::progress::{Progress, Steps};
use lipstream_media::video::{self, Part};
use ndarray::Array2;

use super::prepare::{PrepareSettings, Prepared, reason};
use super::stamp::{self, Notes};
use crate::check::looks::Look;
use crate::check::{series, watch};
use crate::error::{Error, Result, bail};
use crate::features::Skipped;

/// Numbers in a frame: the gap between the inner lips, in distances of the eyes; the distance of the lips' corners, in widths of the face.
pub(super) const SIZE: usize = 2;
/// Share of a video's pictures that must show a face.
pub(crate) const LEAST_SEEN: f32 = 0.8;

/// Looks at every clip that has video. What shows no face is taken out of `clips` and said.
pub(super) fn see(
    clips: &mut Vec<Prepared>,
    settings: &PrepareSettings,
    progress: &dyn Progress,
    skipped: &mut Vec<Skipped>,
) -> Result<usize> {
    let with_video = clips.iter().filter(|clip| clip.source.video.is_some()).count();
    let steps = Steps::begin(progress, "lips", with_video);
    let mut kept = Vec::with_capacity(clips.len());
    // One after the other: each is looked at on all cores.
    for mut clip in clips.drain(..) {
        if clip.source.video.is_none() {
            kept.push(clip);
            continue;
        }
        match see_one(&clip, settings) {
            Ok((frames, rate_hz)) => {
                (clip.clip.video_frames, clip.clip.video_hz) = (frames, rate_hz);
                kept.push(clip);
            }
            Err(why) => {
                let path = clip.source.sound_path().display().to_string();
                progress.warn(&format!("skipped {path}: {}", reason(&why)));
                skipped.push(Skipped {
                    path,
                    reason: reason(&why),
                });
            }
        }
        steps.made();
    }
    *clips = kept;
    let seen = clips.iter().filter(|clip| clip.clip.video_frames > 0).count();
    if seen == 0 {
        bail!(Data, "no lips are seen in any of {with_video} videos");
    }
    Ok(SIZE)
}

/// Pictures that were looked at, and how many of them a second.
fn see_one(prepared: &Prepared, settings: &PrepareSettings) -> Result<(usize, f32)> {
    let clip = &prepared.clip;
    let Some(path) = &prepared.source.video else {
        bail!(Data, "there is no video")
    };
    let to = settings.out.join("visual").join(format!("{}.npy", clip.id));
    let notes = Notes::new(&settings.out, &clip.id);
    let stamp = stamp::of_file(path)?;
    if let Some(noted) = notes.vouched("lips", &stamp, &to)
        && let Some((frames, rate)) = noted.split_once(' ')
        && let (Ok(frames), Ok(rate)) = (frames.parse(), rate.parse())
    {
        return Ok((frames, rate));
    }
    notes.forget("lips");
    let (lips, rate_hz) = lips_of(path, prepared.seconds)?;
    write_npy(&to, &lips).map_err(Error::other)?;
    notes.note_with("lips", &stamp, &format!("{} {rate_hz}", lips.nrows()))?;
    Ok((lips.nrows(), rate_hz))
}

/// The lips of a whole video `[pictures, 2]`, and pictures a second.
///
/// # Errors
///
/// That the video cannot be read, or that fewer than four fifths of its pictures show a face.
fn lips_of(path: &std::path::Path, seconds: f64) -> Result<(Array2<f32>, f32)> {
    let facts = video::facts(path).map_err(Error::other)?;
    let whole = Part {
        begins_s: 0.0,
        seconds,
    };
    let watched = watch::watch(path, facts, &[whole], &())?;
    let Some(watched) = watched.into_iter().next() else {
        bail!(Data, "the video has no picture")
    };
    let [gap, width] = lips(&watched)?;
    let both = Array2::from_shape_fn((gap.len(), SIZE), |(k, d)| if d == 0 { gap[k] } else { width[k] });
    Ok((both, watched.rate_hz))
}

/// Gap and width of every picture; those without a face lie between their neighbours.
pub(crate) fn lips(watched: &watch::Watched) -> Result<[Vec<f32>; SIZE]> {
    let looks = &watched.looks;
    let seen = looks.iter().flatten().count();
    if looks.is_empty() || (seen as f32) < LEAST_SEEN * looks.len() as f32 {
        bail!(Data, "a face is seen in {seen} of {} pictures", looks.len());
    }
    let of = |value: fn(&Look) -> f32| {
        let values: Vec<Option<f32>> = looks.iter().map(|look| look.as_ref().map(value)).collect();
        series::filled(&values)
    };
    Ok([of(|look| look.gap), of(|look| look.mouth_width / look.face_width)])
}
