//! The visual half of `prepare`: mouth images of every clip, the eigenmouths of the training clips, and their
//! weights.
//!
//! Every speaker has a face of his own to hold on to (video::Tracker), learnt from a dozen of his clips. All mouth
//! images of a folder have the size of the speaker with the most training clips; the others' are resampled to it.
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::OnceLock;

use ndarray::Array4;
use rayon::prelude::*;

use super::discover::ClipFiles;
use super::overlay;
use super::prepare::{PrepareSettings, Prepared, reason};
use super::stamp::{self, Notes};
use super::verdict::{self, Seen};
use crate::error::{Context as _, Error, Result, bail};
use crate::features::{self, Skipped, Split};
use crate::vision::{self, ChannelMap, MouthSamples, MouthTrack, Tracker};
use lipstream::affine::Affine;
use lipstream::mouth::MouthSpace;
use lipstream::npy;
use lipstream::progress::{Progress, Steps};
use lipstream::tensors::{Tensors, TensorsBuilder};
use lipstream_media::files;
use lipstream_media::video::{self, Frames};

/// Changes when the same video gives other mouth images.
const MOUTHS_VERSION: u32 = 2;

/// Clips that a speaker's face is learnt from at most, and pictures of all of them together.
const REFERENCE_CLIPS: usize = 12;
const REFERENCE_PICTURES: usize = 192;

/// Images that the eigenmouths are computed from: their number is what the time and memory depend on.
const MOST_IMAGES: usize = 1200;

/// How far (s) sound and pictures of a clip may differ in length.
const LENGTHS_DIFFER_S: f64 = 1.0;

/// What a clip's mouth images are vouched for by: inputs and settings in one line.
type Stamp = String;

/// A speaker with video: his clips, those that his face is learnt from, and what says so.
struct Face<'a> {
    clips: Vec<usize>,
    reference: Vec<&'a ClipFiles>,
    stamp: Stamp,
    tracker: OnceLock<Result<Tracker, String>>,
}

/// Prepares the pictures of `clips`; those whose pictures cannot be used are taken out and reported.
///
/// Returns the number of eigenmouths, 0 when no clip has video.
pub(super) fn see(
    clips: &mut Vec<Prepared>,
    settings: &PrepareSettings,
    progress: &dyn Progress,
    skipped: &mut Vec<Skipped>,
) -> Result<usize> {
    let out = settings.out.as_path();
    let results = track_all(clips, settings, progress)?;
    if results.iter().all(Option::is_none) {
        return Ok(0);
    }
    let mut stamps = Vec::new();
    let mut lips = Vec::new();
    let mut kept = Vec::with_capacity(clips.len());
    for (mut prepared, result) in clips.drain(..).zip(results) {
        let stamp = match result {
            None => String::new(),
            Some(Ok((seen, stamp))) => {
                prepared.clip.video_frames = seen.frames;
                prepared.clip.video_hz = seen.rate_hz;
                lips.push((prepared.clip.id.clone(), seen));
                stamp
            }
            Some(Err(error)) => {
                skipped.push(Skipped {
                    path: place(&prepared),
                    reason: reason(&error),
                });
                continue;
            }
        };
        stamps.push(stamp);
        kept.push(prepared);
    }
    *clips = kept;
    if clips.iter().all(|c| c.clip.video_frames == 0) {
        bail!(
            Data,
            "no clip's pictures can be used (the last: {})",
            skipped.last().map_or("", |s| s.reason.as_str())
        );
    }
    verdict::show(&lips, out, progress)?;
    let (space, space_stamp) = eigenmouths(clips, &stamps, settings, progress)?;
    weigh(clips, &stamps, &space, &space_stamp, settings, progress)?;
    Ok(space.size())
}

fn video_path(prepared: &Prepared) -> &Path {
    prepared.source.video.as_deref().unwrap_or(Path::new(""))
}

/// The pictures of a clip.
fn decode(source: &ClipFiles) -> Result<Frames> {
    let path = source.video.as_deref().unwrap_or(Path::new(""));
    video::decode_part(path, source.part).map_err(Error::other)
}

/// What vouches for a clip's video: the file, and which part of it.
fn video_stamp(source: &ClipFiles) -> Result<String> {
    let file = stamp::of_file(source.video.as_deref().unwrap_or(Path::new("")))?;
    Ok(match source.part {
        Some(part) => format!("{file} {:.4}+{:.4}", part.begins_s, part.seconds),
        None => file,
    })
}

/// A clip's video, and which part of it, for people.
fn place(prepared: &Prepared) -> String {
    let path = video_path(prepared).display();
    match prepared.source.part {
        None => path.to_string(),
        Some(part) => format!(
            "{path} from {:.1} to {:.1} s",
            part.begins_s,
            part.begins_s + part.seconds
        ),
    }
}

/// Mouth images of every clip with video, and what vouches for them.
type Tracked = Option<Result<(Seen, Stamp)>>;

/// Clips that are tracked between two looks at whose face comes next, for each thread.
const CLIPS_PER_THREAD: usize = 8;

fn track_all(
    clips: &[Prepared],
    settings: &PrepareSettings,
    progress: &dyn Progress,
) -> Result<Vec<Tracked>> {
    let out = settings.out.as_path();
    let mut faces = faces(clips)?;
    // The speaker with the most training clips first: his mouth's size is everyone's.
    faces.sort_by_key(|f| {
        let training = f.clips.iter().filter(|i| clips[**i].clip.split == Split::Train);
        std::cmp::Reverse((training.count(), f.clips.len()))
    });
    let mut results: Vec<Tracked> = clips.iter().map(|_| None).collect();
    let count = faces.iter().map(|f| f.clips.len()).sum();
    let steps = (count > 0).then(|| Steps::begin(progress, "mouths", count));
    let mut size: Option<(usize, usize)> = None;
    let mut faces = std::collections::VecDeque::from(faces);
    while !faces.is_empty() {
        // Until the size is known the speakers come one by one, then as many as keep all threads busy.
        let group = next_group(&mut faces, size.is_none());
        let wanted = Wanted { size, settings };
        learn(&group, clips, wanted);
        let of_group: Vec<(&Face, usize)> = group
            .iter()
            .flat_map(|face| face.clips.iter().map(move |i| (face, *i)))
            .collect();
        let track = |&(face, i): &(&Face, usize)| {
            let result = track_one(&clips[i], face, wanted);
            if let Err(error) = &result {
                progress.warn(&format!("skipped {}: {}", place(&clips[i]), reason(error)));
            }
            steps.iter().for_each(Steps::made);
            (i, result)
        };
        for (i, result) in of_group.par_iter().map(track).collect::<Vec<_>>() {
            if size.is_none() && result.is_ok() {
                let images = features::read_mouths(&mouths_path(out, &clips[i].clip.id))?;
                size = Some((images.dim().2, images.dim().1));
            }
            results[i] = Some(result);
        }
    }
    Ok(results)
}

/// The speakers to look at next: one, or so many that every thread has some clips.
fn next_group<'a>(faces: &mut std::collections::VecDeque<Face<'a>>, one: bool) -> Vec<Face<'a>> {
    let enough = CLIPS_PER_THREAD * rayon::current_num_threads();
    let mut group: Vec<Face> = faces.pop_front().into_iter().collect();
    let mut clips: usize = group.iter().map(|face| face.clips.len()).sum();
    while !one && clips < enough {
        let Some(face) = faces.pop_front() else { break };
        clips += face.clips.len();
        group.push(face);
    }
    group
}

/// Learns the faces of a group whose clips an earlier run has not done.
///
/// Learnt here and not where clips are tracked, where one thread would wait for what it is doing itself. One face is learnt on all threads, of
/// several each on one, so that no more faces are in memory than there are threads.
fn learn(group: &[Face], clips: &[Prepared], wanted: Wanted) {
    let is_done = |face: &Face| {
        let done = |i: &usize| tracked(&clips[*i], face, wanted).is_ok_and(|t| t.1.is_some());
        face.clips.iter().all(done)
    };
    match group {
        // An error is said of every clip that needs the face.
        [face] if !is_done(face) => drop(face.tracker(true)),
        [_] | [] => {}
        several => several
            .par_iter()
            .filter(|face| !is_done(face))
            .for_each(|face| drop(face.tracker(false))),
    }
}

/// What is wanted of every clip.
#[derive(Clone, Copy)]
struct Wanted<'s> {
    /// Width and height of all mouth images, once they are known.
    size: Option<(usize, usize)>,
    settings: &'s PrepareSettings,
}

/// The speakers with video, in the order of their names, and the clips that their faces are learnt from.
fn faces(clips: &[Prepared]) -> Result<Vec<Face<'_>>> {
    let mut by_speaker: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (i, prepared) in clips.iter().enumerate() {
        if prepared.source.video.is_some() {
            by_speaker.entry(&prepared.clip.speaker).or_default().push(i);
        }
    }
    by_speaker
        .into_values()
        .map(|of| {
            let mut training: Vec<usize> = of.clone();
            training.retain(|i| clips[*i].clip.split == Split::Train);
            let from = if training.is_empty() { &of } else { &training };
            let count = from.len().min(REFERENCE_CLIPS);
            let reference: Vec<&ClipFiles> = (0..count)
                .map(|k| &clips[from[(2 * k + 1) * from.len() / (2 * count)]].source)
                .collect();
            let parts: Vec<String> = reference
                .iter()
                .map(|source| video_stamp(source))
                .collect::<Result<_>>()?;
            Ok(Face {
                clips: of,
                reference,
                stamp: format!("{MOUTHS_VERSION} {:016x}", stamp::digest(&parts.join("\n"))),
                tracker: OnceLock::new(),
            })
        })
        .collect()
}

impl Face<'_> {
    /// The speaker's tracker, learnt when it is first asked for, on one thread or on all.
    fn tracker(&self, on_all: bool) -> Result<&Tracker> {
        let learn = || -> Result<Tracker> {
            let thinned = |source: &&ClipFiles| {
                let frames = decode(source)?;
                Ok(frames.thinned((frames.len() * self.reference.len() / REFERENCE_PICTURES).max(1)))
            };
            let mut clips = Vec::new();
            let mut trouble: Option<Error> = None;
            let decoded: Vec<Result<Frames>> = match on_all {
                true => self.reference.par_iter().map(thinned).collect(),
                false => self.reference.iter().map(thinned).collect(),
            };
            for decoded in decoded {
                match decoded {
                    Ok(frames) => clips.push(frames),
                    Err(error) => trouble = Some(error),
                }
            }
            match (clips.is_empty(), trouble) {
                (true, Some(error)) => Err(error),
                _ => Tracker::reference(&clips),
            }
        };
        self.tracker
            .get_or_init(|| learn().map_err(|e| reason(&e)))
            .as_ref()
            .map_err(|e| Error::Data(format!("the speaker's face cannot be learnt: {e}")))
    }
}

pub(super) fn mouths_path(out: &Path, id: &str) -> std::path::PathBuf {
    out.join("mouths").join(format!("{id}.npy"))
}

/// What would vouch for a clip's mouth images, and their number and rate if an earlier run has made them.
fn tracked(prepared: &Prepared, face: &Face, wanted: Wanted) -> Result<(Stamp, Option<Seen>)> {
    let id = &prepared.clip.id;
    let out = wanted.settings.out.as_path();
    let size = wanted.size.map_or("own".into(), |(w, h)| format!("{w}x{h}"));
    let stamp = format!("{} {} {size}", video_stamp(&prepared.source)?, face.stamp);
    let path = mouths_path(out, id);
    let notes = Notes::new(out, id);
    let Some(noted) = notes.vouched("mouths", &stamp, &path) else {
        return Ok((stamp, None));
    };
    if wanted.settings.overlay
        && notes
            .vouched("overlay", &stamp, &overlay::path(out, id))
            .is_none()
    {
        return Ok((stamp, None));
    }
    let images = features::read_mouths(&path)?;
    let seen = Seen::of_note(&noted, images.dim().0);
    let seen = seen.ok_or_else(|| Error::Data("a damaged note in the cache".into()))?;
    Ok((stamp, Some(seen)))
}

/// One clip's mouth images in `mouths/`, from an earlier run or tracked now.
fn track_one(prepared: &Prepared, face: &Face, wanted: Wanted) -> Result<(Seen, Stamp)> {
    let id = &prepared.clip.id;
    let out = wanted.settings.out.as_path();
    let path = mouths_path(out, id);
    let (stamp, done) = tracked(prepared, face, wanted)?;
    if let Some(seen) = done {
        return Ok((seen, stamp));
    }
    let notes = Notes::new(out, id);
    notes.forget("mouths");
    let tracker = face.tracker(false)?;
    let frames = decode(&prepared.source)?;
    let pictures_s = frames.len() as f64 / f64::from(frames.rate_hz);
    if (pictures_s - prepared.seconds).abs() > LENGTHS_DIFFER_S {
        bail!(
            Data,
            "its sound lasts {:.2} s, its pictures {pictures_s:.2} s",
            prepared.seconds
        );
    }
    let track = tracker.track(&frames)?;
    if wanted.settings.overlay {
        let sound = out.join("wav").join(format!("{id}.wav"));
        overlay::write(&overlay::path(out, id), &frames, &track, &sound)
            .with_context(|| format!("cannot write the overlay of {id}"))?;
        notes.note("overlay", &stamp)?;
    }
    drop(frames);
    let seen = Seen {
        frames: track.len(),
        rate_hz: track.rate_hz,
        lips: track.lips,
    };
    let images = Array4::from_shape_vec((seen.frames, track.height, track.width, 3), track.images)?;
    let images = match wanted.size {
        Some(size) if size != (track.width, track.height) => resampled(&images, size),
        _ => images,
    };
    write_mouths(&path, &images)?;
    notes.note_with("mouths", &stamp, &seen.note())?;
    Ok((seen, stamp))
}

fn write_mouths(path: &Path, images: &Array4<u8>) -> Result<()> {
    use ndarray_npy::WriteNpyExt;
    files::write_whole(path, |file| images.write_npy(file)).map_err(Error::other)
}

/// Images brought to another size (width, height), bilinear, pixel centres on pixel centres.
fn resampled(images: &Array4<u8>, (width, height): (usize, usize)) -> Array4<u8> {
    let (count, from_height, from_width, _) = images.dim();
    let place = |to: usize, of: usize, from: usize| {
        let at = ((to as f32 + 0.5) * from as f32 / of as f32 - 0.5).clamp(0.0, (from - 1) as f32);
        (at as usize, ((at as usize) + 1).min(from - 1), at.fract())
    };
    Array4::from_shape_fn((count, height, width, 3), |(n, y, x, c)| {
        let (top, bottom, down) = place(y, height, from_height);
        let (left, right, across) = place(x, width, from_width);
        let at = |y, x| f32::from(images[(n, y, x, c)]);
        let upper = at(top, left) * (1.0 - across) + at(top, right) * across;
        let lower = at(bottom, left) * (1.0 - across) + at(bottom, right) * across;
        (upper * (1.0 - down) + lower * down).round() as u8
    })
}

/// A clip's mouth images as the eigenmouths take them.
fn as_track(images: Array4<u8>, rate_hz: f32) -> MouthTrack {
    let (count, height, width, _) = images.dim();
    MouthTrack {
        width,
        height,
        images: images.into_iter().collect(),
        transforms: vec![Affine::IDENTITY; count],
        scores: vec![1.0; count],
        colour: [ChannelMap::IDENTITY; 3],
        rate_hz,
        lips: None,
        outlines: Vec::new(),
    }
}

/// The eigenmouths of the training clips (of all clips where no training clip has video), in
/// `mouth.safetensors`.
fn eigenmouths(
    clips: &[Prepared],
    stamps: &[Stamp],
    settings: &PrepareSettings,
    progress: &dyn Progress,
) -> Result<(MouthSpace, Stamp)> {
    let seen: Vec<usize> = (0..clips.len())
        .filter(|i| clips[*i].clip.video_frames > 0)
        .collect();
    let mut from = seen.clone();
    from.retain(|i| clips[*i].clip.split == Split::Train);
    if from.is_empty() {
        from = seen;
    }
    let used: Vec<usize> = if from.len() > MOST_IMAGES {
        (0..MOST_IMAGES)
            .map(|k| from[k * from.len() / MOST_IMAGES])
            .collect()
    } else {
        from
    };
    let keep = (MOST_IMAGES / used.len()).max(1);
    let parts: Vec<&str> = used.iter().map(|i| stamps[*i].as_str()).collect();
    let stamp = format!(
        "{}{} {:016x}",
        settings.eigenmouths,
        if settings.by_channel {
            " of each colour"
        } else {
            ""
        },
        stamp::digest(&parts.join("\n"))
    );
    let path = settings.out.join("mouth.safetensors");
    let notes = Notes::new(&settings.out, "~mouth");
    if notes.vouched("space", &stamp, &path).is_some() {
        return Ok((
            MouthSpace::load(&Tensors::read(&path).map_err(Error::other)?).map_err(Error::other)?,
            stamp,
        ));
    }
    notes.forget("space");
    let steps = Steps::begin(progress, "eigenmouths", used.len() + 1);
    let mut samples: Option<MouthSamples> = None;
    for i in used {
        let images = features::read_mouths(&mouths_path(&settings.out, &clips[i].clip.id))?;
        let track = as_track(images, clips[i].clip.video_hz);
        samples
            .get_or_insert_with(|| MouthSamples::new((track.width, track.height)))
            .add_clip(&track, keep)?;
        steps.made();
    }
    let samples = samples.ok_or_else(|| Error::Data("no clip has mouth images".into()))?;
    if samples.len() < 2 {
        bail!(Data, "{} mouth image is too few for eigenmouths", samples.len());
    }
    let size = settings.eigenmouths.min(samples.len() - 1);
    let (space, carried) = match settings.by_channel {
        true => vision::eigenmouths_by_channel(&samples, size)?,
        false => vision::eigenmouths(&samples, size)?,
    };
    steps.made();
    progress.say(&format!(
        "{} eigenmouths of {} images ({}×{} pixels) carry {:.1} % of their variance",
        space.size(),
        samples.len(),
        space.width,
        space.height,
        100.0 * carried
    ));
    let mut tensors = TensorsBuilder::default();
    space.store(&mut tensors);
    tensors.write(&path).map_err(Error::other)?;
    notes.note("space", &stamp)?;
    Ok((space, stamp))
}

/// The weights of every clip's mouths, in `visual/`.
fn weigh(
    clips: &[Prepared],
    stamps: &[Stamp],
    space: &MouthSpace,
    space_stamp: &str,
    settings: &PrepareSettings,
    progress: &dyn Progress,
) -> Result<()> {
    let seen: Vec<usize> = (0..clips.len())
        .filter(|i| clips[*i].clip.video_frames > 0)
        .collect();
    let steps = Steps::begin(progress, "mouth weights", seen.len());
    seen.par_iter().try_for_each(|i| {
        let id = &clips[*i].clip.id;
        let path = settings.out.join("visual").join(format!("{id}.npy"));
        let stamp = format!("{} {space_stamp} {}", stamps[*i], settings.keep_clip_mean);
        let notes = Notes::new(&settings.out, id);
        if notes.vouched("visual", &stamp, &path).is_none() {
            notes.forget("visual");
            let images = features::read_mouths(&mouths_path(&settings.out, id))?;
            let bytes: Vec<u8> = images.into_iter().collect();
            let weights = space
                .project_clip(&bytes, !settings.keep_clip_mean)
                .with_context(|| format!("clip {id}"))?;
            npy::write_npy(&path, &weights).map_err(Error::other)?;
            notes.note("visual", &stamp)?;
        }
        steps.made();
        Ok::<(), Error>(())
    })?;
    Ok(())
}

#[cfg(test)]
mod tests;
