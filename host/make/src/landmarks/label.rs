//! Labels every picture of videos, from some of their pictures that are labelled.
use std::collections::BTreeMap;
use std::path::Path;

use lipstream::progress::{Progress, Steps};
use lipstream_media::video::{self, Frames, MAX_LINES};
use ndarray::{Array1, Array3};
use rayon::prelude::*;

use super::labeller::{Labeller, UNSURE};
use super::search::{Example, FaceFinder, Look};
use super::{archive, table};
use crate::corpus::discover::ClipFiles;
use crate::error::{Context as _, Error, Result, bail, ensure};
use crate::hierarchical::Landmarks;

/// Pictures that a model learns from, at most: more add nothing to it, and take memory.
pub const MOST_EXAMPLES: usize = 200;

/// Landmarks of every picture, and how sure they are.
#[derive(Clone, Debug)]
pub struct Labels {
    /// In pixels of the videos; not finite where there is no face.
    pub landmarks: Landmarks,
    confidence: BTreeMap<String, Vec<f32>>,
}

impl Labels {
    /// Of pictures that are known to be right.
    pub fn known(landmarks: Landmarks) -> Self {
        let sure = |points: &Array3<f32>| -> Vec<f32> {
            let whole = |row: ndarray::ArrayView2<f32>| row.iter().all(|v| v.is_finite());
            points.outer_iter().map(|row| f32::from(whole(row))).collect()
        };
        let confidence = landmarks
            .clips()
            .map(|(clip, points)| (clip.to_owned(), sure(points)));
        Self {
            confidence: confidence.collect(),
            landmarks,
        }
    }

    /// Of each picture of a clip: 1 where it is labelled or looks as the labelled ones do, 0 where there is no face.
    pub fn confidence(&self, clip: &str) -> &[f32] {
        self.confidence.get(clip).map_or(&[], Vec::as_slice)
    }

    /// Pictures of each clip that have a face and are to be looked at, the least sure clip first; and how many have no face.
    pub fn unsure(&self) -> (BTreeMap<&str, Vec<usize>>, usize) {
        let mut lost = 0;
        let mut found = BTreeMap::new();
        for (clip, of_clip) in &self.confidence {
            lost += of_clip.iter().filter(|c| **c == 0.0).count();
            let some: Vec<usize> = (0..of_clip.len())
                .filter(|t| of_clip[*t] > 0.0 && of_clip[*t] < UNSURE)
                .collect();
            if !some.is_empty() {
                found.insert(clip.as_str(), some);
            }
        }
        (found, lost)
    }

    /// Writes all of it, as a table where the name ends in `.csv`, as an archive where it ends in `.npz`; a file that is there stays until the new one is whole.
    ///
    /// # Errors
    ///
    /// Another ending, and what the disk says.
    pub fn write(&self, path: &Path) -> Result<()> {
        match form(path)? {
            Form::Table => table::write(path, self),
            Form::Archive => archive::write(path, self),
        }
    }
}

/// What landmarks are written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// `.csv`
    Table,
    /// `.npz`
    Archive,
}

/// What a name's ending asks for.
///
/// # Errors
///
/// Another ending than those two.
pub fn form(path: &Path) -> Result<Form> {
    match path.extension().and_then(|ending| ending.to_str()) {
        Some("csv") => Ok(Form::Table),
        Some("npz") => Ok(Form::Archive),
        _ => bail!(
            Choice,
            "{}: landmarks are written as .npz or .csv; give the output such an ending",
            path.display()
        ),
    }
}

/// A model of the labelled pictures of videos.
///
/// # Errors
///
/// A labelled clip that is not among the videos, a labelled picture that its video does not have, a video that cannot be decoded.
pub fn learn(clips: &[ClipFiles], labelled: &Landmarks, progress: &dyn Progress) -> Result<Labeller> {
    let all = labelled.labelled();
    let video = |clip: &str| {
        clips
            .iter()
            .find(|files| files.id == clip && files.video.is_some())
    };
    if let Some((clip, _)) = all.iter().find(|(clip, _)| video(clip).is_none()) {
        bail!(
            Data,
            "pictures of a clip {clip} are labelled, but there is no such video: {}",
            among(clips)
        );
    }
    let step = all.len().div_ceil(MOST_EXAMPLES).max(1);
    let mut wanted: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (clip, picture) in all.iter().step_by(step) {
        wanted.entry(clip).or_default().push(*picture);
    }
    if step > 1 {
        progress.say(&format!(
            "of {} labelled pictures every {step}th is learnt from: more add nothing",
            all.len()
        ));
    }
    let of_clip = |(clip, pictures): (&&str, &Vec<usize>)| -> Result<Vec<Example>> {
        let Some(files) = video(clip) else {
            return Ok(Vec::new());
        };
        let mut examples = Vec::new();
        let mut finder = FaceFinder::new()?;
        let length = each(files, |number, frames, reduction| {
            if pictures.contains(&number) {
                let points = labelled.picture(clip, number).unwrap_or_default();
                examples.push(Example {
                    look: Look::new(frames, 0, &mut finder),
                    points: reduced(points, reduction),
                });
            }
            Ok(())
        })?;
        ensure!(
            pictures.iter().all(|picture| *picture < length),
            Data,
            "picture {} of clip {clip}, counted from 0, is labelled, but its video has {length} pictures",
            pictures[pictures.len() - 1]
        );
        Ok(examples)
    };
    let of_clips: Vec<Vec<Example>> = wanted.par_iter().map(of_clip).collect::<Result<_>>()?;
    let examples: Vec<&Example> = of_clips.iter().flatten().collect();
    Labeller::learn(&examples, &labelled.starts())
}

/// Finds the points of every picture of the videos; labelled pictures keep theirs.
///
/// # Errors
///
/// A video that cannot be decoded.
pub fn label(
    clips: &[ClipFiles],
    labelled: &Landmarks,
    labeller: &Labeller,
    progress: &dyn Progress,
) -> Result<Labels> {
    let steps = Steps::begin(progress, "clips labelled", clips.len());
    let of_clip = |files: &ClipFiles| -> Result<(Array3<f32>, Vec<f32>)> {
        let mut finder = FaceFinder::new()?;
        let mut before: Option<Array1<f32>> = None;
        let (mut places, mut confidence) = (Vec::new(), Vec::new());
        each(files, |number, frames, reduction| {
            let found = match labelled.picture(&files.id, number) {
                Some(points) => {
                    // Exactly as they were given, not as they come back from reduced pictures.
                    places.extend(&points);
                    Some((reduced(points, reduction), 1.0))
                }
                None => {
                    let near = before.as_ref().map(|points| points.view());
                    let found = labeller.follow(frames, 0, near, &mut finder);
                    match &found {
                        Some((fit, _)) => {
                            places.extend(fit.points.iter().map(|v| (v + 0.5) * reduction - 0.5));
                        }
                        None => places.extend(std::iter::repeat_n(f32::NAN, 2 * labelled.count())),
                    }
                    found.map(|(fit, confidence)| (fit.points, confidence))
                }
            };
            confidence.push(found.as_ref().map_or(0.0, |(_, confidence)| *confidence));
            before = found.map(|(points, _)| points);
            Ok(())
        })?;
        steps.made();
        let points = Array3::from_shape_vec((confidence.len(), labelled.count(), 2), places)?;
        Ok((points, confidence))
    };
    let found: Vec<(Array3<f32>, Vec<f32>)> = clips.par_iter().map(of_clip).collect::<Result<_>>()?;
    let mut labels = Labels {
        landmarks: Landmarks::none(labelled.count(), labelled.groups().clone()),
        confidence: BTreeMap::new(),
    };
    for (files, (points, confidence)) in clips.iter().zip(found) {
        labels.landmarks.put(&files.id, points)?;
        labels.confidence.insert(files.id.clone(), confidence);
    }
    Ok(labels)
}

/// Goes through the pictures of a clip one by one: `each(number, the picture alone, pixels of the video in one of its)`. Gives how many there are.
///
/// # Errors
///
/// A video that cannot be decoded, and what `each` says.
pub fn each(files: &ClipFiles, mut each: impl FnMut(usize, &Frames, f32) -> Result<()>) -> Result<usize> {
    let path = files.video.as_deref().unwrap_or(Path::new(""));
    let reduction = video::facts(path).map_err(Error::other)?.reduction;
    let mut number = 0;
    let read = video::each_picture(path, files.part, MAX_LINES, |width, height, rgb| -> Result<()> {
        let frames = Frames {
            width,
            height,
            rate_hz: 0.0,
            rgb: rgb.to_vec(),
        };
        each(number, &frames, reduction)?;
        number += 1;
        Ok(())
    });
    read.with_context(|| path.display().to_string())?;
    Ok(number)
}

/// Points of a video in pixels of its reduced pictures.
pub(crate) fn reduced(points: Array1<f32>, reduction: f32) -> Array1<f32> {
    points.mapv(|v| (v + 0.5) / reduction - 0.5)
}

/// The first few clips by name, to say what there is.
fn among(clips: &[ClipFiles]) -> String {
    let names: Vec<&str> = clips.iter().take(3).map(|clip| clip.id.as_str()).collect();
    let more = match clips.len() > names.len() {
        true => ", …",
        false => "",
    };
    format!("there is {}{more}", names.join(", "))
}
