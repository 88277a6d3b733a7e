//! What systems of different parameters have in common: how far the lips are apart, and what the mouth looks like.
//!
//! The gap between the inner lips is measured in landmarks of the test clips' pictures, in pixels. A system's gap is read off its eigenmouth weights by one linear map for all systems,
//! fitted to true weights and landmarks of training clips; the true weights themselves stand in the first row, for what this reading loses. The mouth is drawn from the weights onto the clip's own mean
//! picture, since weights carry no light, and held against the recorded mouth images.
use ndarray::{Array1, Array2, ArrayView2, Axis, s};
use rayon::prelude::*;
use serde::Serialize;

use super::Truth;
use super::pictures::PictureScore;
use crate::error::{Context as _, Error, Result, ensure};
use crate::features::{Clip, FeatureFolder, Split, read_mouths};
use crate::hierarchical::Landmarks;
use crate::hierarchical::pictures::lip_gap;
use crate::train::local_linear::MapSums;
use lipstream::kinds::likelihood::local_linear;
use lipstream::mouth::MouthSpace;
use lipstream::tensors::Tensors;

/// Ridge penalty of the read-out: enough to keep it solvable.
const PENALTY: f64 = 1.0;

/// What a system is like in the common space.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Common {
    /// Root mean square error of the lip gap, in pixels of the video.
    pub gap_error: f64,
    /// Correlation of the lip gap with that of the landmarks, over all pictures.
    pub gap_correlation: f64,
    /// Peak signal-to-noise ratio of the drawn mouths, in decibels.
    pub psnr_db: f64,
    /// Structural similarity of the drawn mouths, at most 1.
    pub ssim: f64,
}

/// Sums over the pictures of clips.
#[derive(Clone, Debug, Default)]
struct Sums {
    /// Number, then sums of said, true, their squares and their product.
    gap: [f64; 6],
    pictures: PictureScore,
}

impl Sums {
    fn merge(&mut self, other: &Sums) {
        std::iter::zip(&mut self.gap, other.gap).for_each(|(sum, more)| *sum += more);
        self.pictures.merge(&other.pictures);
    }

    fn gap(&mut self, said: f32, truth: f32) {
        let (said, truth) = (f64::from(said), f64::from(truth));
        let more = [1.0, said, truth, said * said, truth * truth, said * truth];
        std::iter::zip(&mut self.gap, more).for_each(|(sum, more)| *sum += more);
    }

    fn common(&self) -> Common {
        let [n, said, truth, said_squares, true_squares, products] = self.gap;
        let n = n.max(1.0);
        let off = (said_squares - 2.0 * products + true_squares) / n;
        let covariance = products / n - said * truth / (n * n);
        // What rounding leaves of numbers that are all the same is no variance.
        let variance = |squares: f64, sum: f64| match squares / n - (sum / n).powi(2) {
            small if small <= 1e-9 * squares / n => 0.0,
            variance => variance,
        };
        let scale = (variance(said_squares, said) * variance(true_squares, truth)).sqrt();
        Common {
            gap_error: off.max(0.0).sqrt(),
            // A mouth that does not move follows nothing.
            gap_correlation: if scale > 0.0 { covariance / scale } else { 0.0 },
            psnr_db: self.pictures.psnr_db(),
            ssim: self.pictures.ssim(),
        }
    }
}

/// A test clip.
struct Seen {
    /// Lip gap of each picture in pixels; not finite where there are no landmarks.
    gaps: Vec<f32>,
    /// Mouth images, rows of interleaved R, G, B.
    mouths: Array2<f32>,
    mean: Array1<f32>,
    rate_hz: f32,
}

/// Judges systems on some clips.
pub(super) struct Judge {
    space: MouthSpace,
    /// Gap of \[weights; 1\].
    reading: Array1<f32>,
    clips: Vec<Seen>,
}

/// The lip gap of every picture of a clip.
fn gaps(clip: &Clip, landmarks: &Landmarks, inner: &[usize]) -> Result<Vec<f32>> {
    let points = landmarks
        .of(&clip.id)
        .ok_or_else(|| Error::Data(format!("there are no landmarks of clip {}", clip.id)))?;
    let of_picture = |shape: ArrayView2<f32>| lip_gap(shape.flatten().view(), inner);
    let mut gaps: Vec<f32> = points.outer_iter().map(of_picture).collect();
    gaps.resize(clip.video_frames, f32::NAN);
    Ok(gaps)
}

impl Judge {
    pub(super) fn of(folder: &FeatureFolder, truths: &[Truth], landmarks: &Landmarks) -> Result<Self> {
        let inner: Vec<usize> = landmarks.inner_lips().map(Iterator::collect).unwrap_or_default();
        ensure!(
            inner.len() >= 4,
            Data,
            "the landmark file does not say which landmarks are the inner lips (a group `lips_inner`)"
        );
        let tensors = Tensors::read(&folder.mouth_path()).map_err(Error::other)?;
        let space = MouthSpace::load(&tensors).map_err(Error::other)?;
        let mut sums = MapSums::new(space.size(), 1, 0);
        for clip in folder.split(Split::Train).filter(|clip| clip.video_frames > 0) {
            let gaps = gaps(clip, landmarks, &inner)?;
            let visual = folder.visual(clip)?;
            let rows: Vec<usize> = (0..visual.nrows()).filter(|t| gaps[*t].is_finite()).collect();
            let gaps = Array2::from_shape_fn((rows.len(), 1), |(n, _)| gaps[rows[n]]);
            sums.add(
                &visual.select(Axis(0), &rows),
                &gaps,
                &Array2::zeros((rows.len(), 0)),
            );
        }
        let reading = sums.solve(PENALTY, 1.0)?.global.row(0).to_owned();
        let clips = truths
            .par_iter()
            .map(|truth| {
                let images = read_mouths(&folder.mouths_path(&truth.clip.id))?;
                let n = images.dim().0;
                let mouths = images
                    .mapv(f32::from)
                    .into_shape_with_order((n, space.mean.len()))?;
                Ok(Seen {
                    gaps: gaps(truth.clip, landmarks, &inner)?,
                    mean: mouths.mean_axis(Axis(0)).unwrap_or_else(|| space.mean.clone()),
                    mouths,
                    rate_hz: truth.clip.video_hz,
                })
            })
            .collect::<Result<_>>()
            .context("mouths and landmarks of the clips that are measured")?;
        Ok(Self {
            space,
            reading,
            clips,
        })
    }

    /// What mouth parameters `[frames, D]` of all clips, 100 a second, are like.
    pub(super) fn common<'p>(&self, parameters: impl Iterator<Item = &'p Array2<f32>>) -> Common {
        let parameters: Vec<&Array2<f32>> = parameters.collect();
        let of_clips = parameters
            .into_par_iter()
            .enumerate()
            .map(|(n, said)| self.score(n, said));
        let of_clips: Vec<Sums> = of_clips.collect();
        let mut all = Sums::default();
        of_clips.iter().for_each(|sums| all.merge(sums));
        all.common()
    }

    /// How mouth parameters `[frames, D]`, 100 a second, compare with clip `n`.
    fn score(&self, n: usize, parameters: &Array2<f32>) -> Sums {
        let clip = &self.clips[n];
        let weights = at_pictures(parameters, clip.rate_hz, clip.mouths.nrows());
        let mut sums = Sums::default();
        let read = local_linear::with_bias(&weights).dot(&self.reading);
        for (said, truth) in read.iter().zip(&clip.gaps).filter(|(_, truth)| truth.is_finite()) {
            sums.gap(*said, *truth);
        }
        let drawn = weights.dot(&self.space.basis) + &clip.mean;
        sums.pictures.add(
            drawn.view(),
            clip.mouths.view(),
            (self.space.width, self.space.height),
        );
        sums
    }
}

/// Rows of frames, 100 a second, in the middles of pictures: linear between frames, held beyond the first and the last.
fn at_pictures(frames: &Array2<f32>, rate_hz: f32, pictures: usize) -> Array2<f32> {
    let mut out = Array2::zeros((pictures, frames.ncols()));
    let last = frames.nrows().saturating_sub(1);
    for (n, mut row) in out
        .outer_iter_mut()
        .enumerate()
        .take(if frames.is_empty() { 0 } else { pictures })
    {
        let place = lipstream::time::frame_at((n as f64 + 0.5) / f64::from(rate_hz)).clamp(0.0, last as f64);
        let (before, share) = (place as usize, place.fract() as f32);
        let after = (before + 1).min(last);
        let mixed = &frames.row(before) * (1.0 - share) + &frames.slice(s![after, ..]) * share;
        row.assign(&mixed);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn gap_error_and_correlation_are_those_of_the_definition() {
        let mut sums = Sums::default();
        let pairs = [(1.0f32, 2.0f32), (3.0, 2.5), (4.0, 6.0), (0.0, 1.0)];
        let (first, rest) = pairs.split_at(2);
        first.iter().for_each(|(said, truth)| sums.gap(*said, *truth));
        let mut other = Sums::default();
        rest.iter().for_each(|(said, truth)| other.gap(*said, *truth));
        sums.merge(&other);
        let found = sums.common();
        let error: f32 = (pairs.iter().map(|(a, b)| (a - b).powi(2)).sum::<f32>() / 4.0).sqrt();
        assert!((found.gap_error - f64::from(error)).abs() < 1e-6);
        // Means 2 and 2.875.
        let sum = |f: &dyn Fn(f64, f64) -> f64| -> f64 {
            pairs
                .iter()
                .map(|(a, b)| f(f64::from(*a) - 2.0, f64::from(*b) - 2.875))
                .sum()
        };
        let wanted = sum(&|a, b| a * b) / (sum(&|a, _| a * a) * sum(&|_, b| b * b)).sqrt();
        assert!((found.gap_correlation - wanted).abs() < 1e-9);
        let mut still = Sums::default();
        pairs.iter().for_each(|(_, truth)| still.gap(3.1, *truth));
        assert_eq!(still.common().gap_correlation, 0.0);
    }

    #[test]
    fn frames_are_read_in_the_middles_of_pictures() {
        let frames = Array2::from_shape_fn((12, 1), |(t, _)| t as f32);
        let at = at_pictures(&frames, 25.0, 4);
        // The middle of the first picture is at 20 ms, frame t's at 10·t + 12.5 ms.
        assert!(
            (&at - &array![[0.75], [4.75], [8.75], [11.0]])
                .iter()
                .all(|d| d.abs() < 1e-4)
        );
        assert_eq!(
            at_pictures(&Array2::zeros((0, 2)), 25.0, 3),
            Array2::<f32>::zeros((3, 2))
        );
    }
}
