//! What a picture looks like across a contour: grey levels along the normal of a point, at one of several resolutions (Cootes and Taylor 1993).
//!
//! A profile holds differences of neighbouring levels over the sum of their sizes, so that neither exposure nor contrast counts. A point's mean profile and the covariance say how unlike it another is:
//! the Mahalanobis distance. Covariances of few pictures are drawn towards a multiple of the identity, the more the fewer there are (Ledoit and Wolf's form, with the weight d / (n + d)).
use nalgebra::{DMatrix, DVector};

use crate::vision::{Plane, Pyramid};

/// Differences on each side of the point.
const REACH: usize = 5;
/// Numbers of a profile.
pub const LENGTH: usize = 2 * REACH + 1;
/// Contrast of a flat stretch, in grey levels: below it, noise would be taken for an edge.
const FLAT: f32 = 4.0;

/// Grey levels along a line through a picture.
pub(crate) struct Line<'a> {
    plane: &'a Plane,
    /// Pixels of the picture for one of the plane.
    reduced: f32,
    at: [f32; 2],
    step: [f32; 2],
}

impl<'a> Line<'a> {
    /// Through `at`, along `normal`, whose steps are `spacing` pixels of the picture; read from the level of the pyramid whose pixels are about that large.
    pub(crate) fn new(pyramid: &'a Pyramid, at: [f32; 2], normal: [f32; 2], spacing: f32) -> Self {
        let (plane, reduced) = pyramid.at_spacing(spacing);
        Self {
            plane,
            reduced,
            at,
            step: normal.map(|n| n * spacing),
        }
    }

    /// The grey level `steps` from the point.
    fn level(&self, steps: f32) -> f32 {
        let [x, y] = [0, 1].map(|axis| {
            let place = self.at[axis] + steps * self.step[axis];
            (place + 0.5) / self.reduced - 0.5
        });
        self.plane.sample(x, y)
    }

    /// Differences along the line, from `reach` steps before the point to `reach` behind it.
    pub(crate) fn differences(&self, reach: usize) -> Vec<f32> {
        let reach = reach as i32;
        let levels: Vec<f32> = (-reach..=reach + 1).map(|k| self.level(k as f32 - 0.5)).collect();
        levels.windows(2).map(|pair| pair[1] - pair[0]).collect()
    }
}

/// A profile, whose sizes sum to 1 where there is any contrast.
fn sized(differences: &[f32]) -> DVector<f32> {
    let sum: f32 = differences.iter().map(|d| d.abs()).sum();
    DVector::from_iterator(LENGTH, differences.iter().map(|d| d / sum.max(FLAT)))
}

/// A point's profile at one resolution: its mean, and the inverse of its covariance.
#[derive(Clone, Debug)]
pub struct Profile {
    mean: DVector<f32>,
    precision: DMatrix<f32>,
}

impl Profile {
    /// Learns from the lines through the point in labelled pictures; there is one at least.
    pub(crate) fn learn(lines: &[Line<'_>]) -> Self {
        let seen: Vec<DVector<f32>> = lines.iter().map(|line| sized(&line.differences(REACH))).collect();
        let count = seen.len() as f32;
        let mean = seen.iter().fold(DVector::zeros(LENGTH), |sum, g| sum + g) / count;
        let mut covariance = DMatrix::<f32>::zeros(LENGTH, LENGTH);
        for g in &seen {
            let off = g - &mean;
            covariance += &off * off.transpose() / count;
        }
        let drawn = LENGTH as f32 / (LENGTH as f32 + count);
        // Profiles that never vary, as of one picture, still are not known better than a hundredth.
        let level = (covariance.trace() / LENGTH as f32).max(1e-4);
        let mixed = covariance * (1.0 - drawn) + DMatrix::identity(LENGTH, LENGTH) * (drawn * level);
        let precision = mixed
            .try_inverse()
            .unwrap_or_else(|| DMatrix::identity(LENGTH, LENGTH) / level);
        Self { mean, precision }
    }

    /// How unlike the mean profile is to what lies `0, 1, …` steps from the one end of the search to the other: squared Mahalanobis distances over the number of dimensions, at
    /// −`search`..=`search` steps.
    pub(crate) fn distances(&self, line: &Line<'_>, search: usize) -> Vec<f32> {
        let differences = line.differences(REACH + search);
        differences
            .windows(LENGTH)
            .map(|window| {
                let off = sized(window) - &self.mean;
                off.dot(&(&self.precision * &off)) / LENGTH as f32
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An edge at x = `at`, with a ramp of two pixels.
    fn edge(at: f32, dark: f32, light: f32) -> Pyramid {
        let plane = Plane::from_fn(96, 64, |x, _| {
            dark + (light - dark) * ((x as f32 - at) / 2.0 + 0.5).clamp(0.0, 1.0)
        });
        Pyramid::new(plane, 4)
    }

    #[test]
    fn an_edge_is_found_where_it_lies_whatever_the_light() {
        for spacing in [1.0, 2.0, 4.0] {
            let seen: Vec<Pyramid> = (0..6).map(|n| edge(48.0, 20.0 + 5.0 * n as f32, 120.0)).collect();
            let lines: Vec<Line<'_>> = seen
                .iter()
                .map(|pyramid| Line::new(pyramid, [48.0, 30.0], [1.0, 0.0], spacing))
                .collect();
            let profile = Profile::learn(&lines);
            let other = edge(48.0 + 2.0 * spacing, 60.0, 220.0);
            let line = Line::new(&other, [48.0, 30.0], [1.0, 0.0], spacing);
            let distances = profile.distances(&line, 4);
            assert_eq!(distances.len(), 9);
            let best = (0..9)
                .min_by(|a, b| distances[*a].total_cmp(&distances[*b]))
                .unwrap();
            assert_eq!(best, 6, "two steps from the middle: {distances:?}");
            // Looked at from the other side it is no such edge.
            let turned = Line::new(&other, [48.0, 30.0], [-1.0, 0.0], spacing);
            assert!(profile.distances(&turned, 4).iter().all(|d| *d > distances[best]));
        }
    }

    #[test]
    fn one_flat_picture_gives_finite_distances() {
        let flat = Pyramid::new(Plane::new(40, 40), 2);
        let line = Line::new(&flat, [20.0, 20.0], [0.0, 1.0], 1.0);
        let profile = Profile::learn(&[line]);
        let line = Line::new(&flat, [-9.0, 20.0], [0.0, 1.0], 1.0);
        assert!(profile.distances(&line, 3).iter().all(|d| d.abs() < 1e-6));
    }
}
