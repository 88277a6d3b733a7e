//! Labels that grow: the picture that the model is least sure of is shown with the points found in it, a person corrects them, and the model learns anew (COS section 6.1).
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use lipstream::progress::Progress;
use lipstream_media::video::Frames;

use super::label::{self, Labels};
use super::labeller::UNSURE;
use crate::corpus::discover::ClipFiles;
use crate::error::{Result, bail, ensure};
use crate::hierarchical::Landmarks;

/// A picture that is to be looked at.
#[derive(Clone, Debug)]
pub struct Proposal {
    /// The clip.
    pub clip: String,
    /// Its picture, counted from 0.
    pub picture: usize,
    /// x and y in pixels of the video.
    pub points: Vec<[f32; 2]>,
    /// How sure the points are, from 0 to 1; 0 where no face was found, and the points are those of the nearest picture that has some.
    pub confidence: f32,
    /// Pixels of the video, across and down.
    pub size: [usize; 2],
    /// The picture alone, not larger than what is looked at.
    pub frames: Frames,
}

/// Labels, what a model of them finds, and which picture is to be looked at next.
pub struct Growth {
    clips: Vec<ClipFiles>,
    labelled: Landmarks,
    /// The table that has the labels.
    table: PathBuf,
    found: Labels,
    expected: Option<f32>,
    skipped: BTreeSet<(String, usize)>,
    proposal: Option<Proposal>,
}

impl Growth {
    /// Learns from `labelled` and looks at all pictures. What is accepted later goes into `table`, together with `labelled`.
    ///
    /// # Errors
    ///
    /// As [`label::learn`] and [`label::label`], and a table whose name does not end in `.csv`.
    pub fn begin(
        clips: Vec<ClipFiles>,
        labelled: Landmarks,
        table: &Path,
        progress: &dyn Progress,
    ) -> Result<Self> {
        ensure!(
            table.extension().is_some_and(|ending| ending == "csv"),
            Choice,
            "{}: labels are kept in a table; give it the ending .csv",
            table.display()
        );
        let (found, expected) = look(&clips, &labelled, progress)?;
        let mut growth = Self {
            clips,
            labelled,
            table: table.to_owned(),
            found,
            expected,
            skipped: BTreeSet::new(),
            proposal: None,
        };
        growth.propose()?;
        Ok(growth)
    }

    /// The picture that is to be looked at; None when all are labelled or skipped.
    pub fn proposal(&self) -> Option<&Proposal> {
        self.proposal.as_ref()
    }

    /// What the newest model finds in all pictures.
    pub fn found(&self) -> &Labels {
        &self.found
    }

    /// The labels.
    pub fn labelled(&self) -> &Landmarks {
        &self.labelled
    }

    /// Median distance that may be expected of a point, in shares of the face's width; None of a single labelled picture.
    pub fn expected(&self) -> Option<f32> {
        self.expected
    }

    /// Takes `points` for those of the proposed picture: writes the table, learns anew and proposes the next picture.
    ///
    /// # Errors
    ///
    /// Points that cannot be this picture's; then nothing has changed. What the disk says; then neither. What looking at the videos again says: then the label is kept.
    pub fn accept(&mut self, points: &[[f32; 2]], progress: &dyn Progress) -> Result<()> {
        let Some(now) = &self.proposal else {
            bail!(Choice, "no picture is left to be labelled");
        };
        ensure!(
            points.len() == self.labelled.count(),
            Data,
            "{} points; a picture has {}",
            points.len(),
            self.labelled.count()
        );
        for (number, [x, y]) in points.iter().enumerate() {
            // A face may be cut off, and then its points lie outside; further out than a picture's size is a slip.
            let near = |v: f32, size: usize| {
                let size = size as f32;
                v.is_finite() && (-size..=2.0 * size).contains(&v)
            };
            ensure!(
                near(*x, now.size[0]) && near(*y, now.size[1]),
                Data,
                "point {number} at {x}, {y} is far outside the picture of {} x {} pixels",
                now.size[0],
                now.size[1]
            );
        }
        let mut labelled = self.labelled.clone();
        labelled.put_picture(&now.clip, now.picture, points)?;
        Labels::known(labelled.clone()).write(&self.table)?;
        self.labelled = labelled;
        (self.found, self.expected) = look(&self.clips, &self.labelled, progress)?;
        self.propose()
    }

    /// Does not propose the proposed picture any more; what the model finds in it stays.
    ///
    /// # Errors
    ///
    /// A video that cannot be decoded.
    pub fn skip(&mut self) -> Result<()> {
        if let Some(now) = self.proposal.take() {
            self.skipped.insert((now.clip, now.picture));
        }
        self.propose()
    }

    /// Proposes the least sure picture. One without a face stands behind the unsure ones: it may have none. Of equally sure ones, as all are while there are too few labels to find a face by, the furthest from those
    /// that a person has seen tells most that is new.
    fn propose(&mut self) -> Result<()> {
        let sure = |confidence: f32| match confidence {
            0.0 => UNSURE,
            found => found,
        };
        let labelled = self.labelled.labelled().into_iter();
        let skipped = self
            .skipped
            .iter()
            .map(|(clip, picture)| (clip.as_str(), *picture));
        let mut seen: BTreeMap<&str, BTreeSet<usize>> = BTreeMap::new();
        for (clip, picture) in labelled.chain(skipped) {
            seen.entry(clip).or_default().insert(picture);
        }
        let apart = |clip: &str, picture: usize| {
            let seen = seen.get(clip).into_iter().flatten();
            seen.map(|of| of.abs_diff(picture)).min().unwrap_or(usize::MAX)
        };
        let left = self.clips.iter().flat_map(|files| {
            let of_clip = self.found.confidence(&files.id).iter().enumerate();
            of_clip.map(move |(picture, confidence)| (files, picture, *confidence))
        });
        let left =
            left.map(|(files, picture, confidence)| (files, picture, confidence, apart(&files.id, picture)));
        let next = left
            .filter(|(.., apart)| *apart > 0)
            .min_by(|a, b| sure(a.2).total_cmp(&sure(b.2)).then(b.3.cmp(&a.3)));
        self.proposal = match next {
            Some((files, picture, confidence, _)) => Some(self.shown(files, picture, confidence)?),
            None => None,
        };
        Ok(())
    }

    fn shown(&self, files: &ClipFiles, picture: usize, confidence: f32) -> Result<Proposal> {
        let mut shown = None;
        label::each(files, |number, frames, reduction| {
            if number == picture {
                shown = Some((frames.clone(), reduction));
            }
            Ok(())
        })?;
        let Some((frames, reduction)) = shown else {
            bail!(Data, "clip {} has lost its picture {picture}", files.id);
        };
        let pixels = |of_picture: usize| (of_picture as f32 * reduction).round() as usize;
        Ok(Proposal {
            clip: files.id.clone(),
            picture,
            points: self.near(&files.id, picture),
            confidence,
            size: [pixels(frames.width), pixels(frames.height)],
            frames,
        })
    }

    /// The points of a picture, or of the nearest one of its clip that has some, or of one that is labelled.
    fn near(&self, clip: &str, picture: usize) -> Vec<[f32; 2]> {
        let found = &self.found.landmarks;
        let all = found.of(clip).map_or(0, |points| points.dim().0);
        let mut order: Vec<usize> = (0..all).collect();
        order.sort_by_key(|t| t.abs_diff(picture));
        let in_clip = order.into_iter().find_map(|t| found.picture(clip, t));
        let anywhere = || {
            let labelled = self.labelled.labelled();
            labelled
                .first()
                .and_then(|(clip, t)| self.labelled.picture(clip, *t))
        };
        let points = in_clip.or_else(anywhere).unwrap_or_default();
        let (points, _) = points.as_slice().unwrap_or_default().as_chunks::<2>();
        points.to_vec()
    }
}

/// What a model of the labels finds, and what may be expected of it.
fn look(clips: &[ClipFiles], labelled: &Landmarks, progress: &dyn Progress) -> Result<(Labels, Option<f32>)> {
    let labeller = label::learn(clips, labelled, progress)?;
    let found = label::label(clips, labelled, &labeller, progress)?;
    Ok((found, labeller.expected()))
}
