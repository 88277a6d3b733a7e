//! Registration of a face to a template: inverse-compositional Lucas-Kanade (Baker & Matthews 2004) on a pyramid.
//!
//! The template T is a weighted set of pixels with zero weighted mean and unit weighted norm. For a picture I and a map M
//! from template to picture, the picture's samples i = I(M·x) are explained as g·T + b + error, whatever the gain g and the
//! level b. With the steepest-descent images made orthogonal to T and to 1 beforehand (J), the step is
//! Δp = (JᵀwJ)⁻¹ Jᵀw i / g and the update M ← M·W(Δp)⁻¹.
use lipstream::affine::Affine;
use nalgebra::{SMatrix, SVector};

use super::image::{Plane, Pyramid};

/// Levels of the pyramid: the coarsest sees a face of some 30 pixels.
pub(crate) const LEVELS: usize = 3;
const MAX_STEPS: usize = 40;
/// A step that moves no template pixel by more than this is the last. Pixels of the level.
const STILL: f32 = 0.01;

/// A template prepared for registration at every level.
pub(crate) struct Template {
    levels: Vec<Level>,
    centre: (f32, f32),
    radius: f32,
    side: f32,
}

struct Level {
    /// Template coordinates of the pixels used.
    points: Vec<(f32, f32)>,
    weights: Vec<f32>,
    /// Zero weighted mean, unit weighted norm.
    values: Vec<f32>,
    affine: Descent<6>,
    similarity: Descent<4>,
}

/// Projected steepest-descent images, already multiplied by the weights, and the inverse of their Gauss-Newton matrix.
struct Descent<const N: usize> {
    images: Vec<[f32; N]>,
    inverse: SMatrix<f32, N, N>,
}

/// Where a registration ended.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Registration {
    /// Template to picture.
    pub map: Affine,
    /// Weighted correlation of the picture, sampled through `map`, with the template: −1..1.
    pub score: f32,
}

impl Template {
    /// From values and weights (≥ 0) on a grid whose pixel (0, 0) lies at `origin` of the template's coordinates.
    ///
    /// Nothing when there is no structure to hold on to.
    pub(crate) fn new(image: &Plane, weights: &Plane, origin: (f32, f32), side: f32) -> Option<Self> {
        let centre = (
            origin.0 + 0.5 * (image.width - 1) as f32,
            origin.1 + 0.5 * (image.height - 1) as f32,
        );
        let radius = 0.5 * image.width.max(image.height) as f32;
        let mut levels = Vec::new();
        let (mut image, mut weights) = (image.clone(), weights.clone());
        for index in 0..LEVELS {
            if index > 0 {
                image = image.half();
                weights = weights.half();
            }
            levels.push(Level::new(&image, &weights, index, origin, centre, radius)?);
        }
        Some(Self {
            levels,
            centre,
            radius,
            side,
        })
    }

    /// Side of the face box in template pixels; the box's left upper corner is the origin.
    pub(crate) fn side(&self) -> f32 {
        self.side
    }

    /// Registers a picture, from `start` (template to picture): similarity on the coarse levels, affine on the finest.
    pub(crate) fn register(&self, picture: &Pyramid, start: Affine) -> Option<Registration> {
        let mut found = Registration {
            map: start,
            score: -1.0,
        };
        for index in (0..LEVELS).rev() {
            let level = &self.levels[index];
            let plane = &picture.levels[index];
            found = if index > 0 {
                self.descend(level, &level.similarity, plane, index, found.map, similarity_step)?
            } else {
                self.descend(level, &level.affine, plane, index, found.map, affine_step)?
            };
        }
        Some(found)
    }

    fn descend<const N: usize>(
        &self,
        level: &Level,
        descent: &Descent<N>,
        plane: &Plane,
        index: usize,
        start: Affine,
        step: fn(&SVector<f32, N>) -> [f32; 6],
    ) -> Option<Registration> {
        let mut map = start;
        let mut samples = vec![0.0f32; level.points.len()];
        let scale = (1u32 << index) as f32;
        let mut score = -1.0;
        for _ in 0..MAX_STEPS {
            // To the level's own pixels.
            let to_level = Affine::scaled(1.0 / scale, 0.5 / scale - 0.5, 0.5 / scale - 0.5).after(&map);
            for (sample, &(x, y)) in samples.iter_mut().zip(&level.points) {
                let (x, y) = to_level.apply(x, y);
                *sample = plane.sample(x, y);
            }
            let (gain, norm) = level.gain_and_norm(&samples);
            if norm <= 0.0 || gain <= 0.0 {
                return None;
            }
            score = gain / norm;
            let mut right = SVector::<f32, N>::zeros();
            for (image, &sample) in descent.images.iter().zip(&samples) {
                for (r, d) in right.iter_mut().zip(image) {
                    *r += d * sample;
                }
            }
            let parameters = descent.inverse * right / gain;
            let [p0, p1, p2, p3, p4, p5] = step(&parameters);
            // x + (p0·u + p1·v + p2, p3·u + p4·v + p5) with u, v in −1..1 about the centre.
            let (r, (cx, cy)) = (self.radius, self.centre);
            let warp = Affine([
                1.0 + p0 / r,
                p1 / r,
                p2 - (p0 * cx + p1 * cy) / r,
                p3 / r,
                1.0 + p4 / r,
                p5 - (p3 * cx + p4 * cy) / r,
            ]);
            map = map.after(&warp.inverse()?);
            if !map.0.iter().all(|v| v.is_finite()) {
                return None;
            }
            let reach = (p0.abs() + p1.abs() + p2.abs()).max(p3.abs() + p4.abs() + p5.abs());
            if reach < STILL * scale {
                break;
            }
        }
        Some(Registration { map, score })
    }
}

fn affine_step(p: &SVector<f32, 6>) -> [f32; 6] {
    [p[0], p[1], p[2], p[3], p[4], p[5]]
}

/// Parameters: scale, turn, x, y.
fn similarity_step(p: &SVector<f32, 4>) -> [f32; 6] {
    [p[0], -p[1], p[2], p[1], p[0], p[3]]
}

impl Level {
    fn new(
        image: &Plane,
        weights: &Plane,
        index: usize,
        origin: (f32, f32),
        centre: (f32, f32),
        radius: f32,
    ) -> Option<Self> {
        let scale = (1u32 << index) as f32;
        let largest = weights.data.iter().copied().fold(0.0, f32::max);
        let (mut points, mut used, mut values, mut gradients) = (vec![], vec![], vec![], vec![]);
        for y in 0..image.height {
            for x in 0..image.width {
                let weight = weights.data[y * image.width + x];
                if weight <= 1e-3 * largest {
                    continue;
                }
                let (gx, gy) = image.gradient(x, y);
                points.push((
                    origin.0 + scale * (x as f32 + 0.5) - 0.5,
                    origin.1 + scale * (y as f32 + 0.5) - 0.5,
                ));
                used.push(weight);
                values.push(image.data[y * image.width + x]);
                gradients.push((gx / scale, gy / scale));
            }
        }
        let total: f32 = used.iter().sum();
        if points.len() < 64 || total <= 0.0 {
            return None;
        }
        used.iter_mut().for_each(|w| *w /= total);
        let mean: f32 = values.iter().zip(&used).map(|(v, w)| v * w).sum();
        values.iter_mut().for_each(|v| *v -= mean);
        let norm = values
            .iter()
            .zip(&used)
            .map(|(v, w)| v * v * w)
            .sum::<f32>()
            .sqrt();
        if norm <= 1e-3 {
            return None;
        }
        values.iter_mut().for_each(|v| *v /= norm);
        // Gradients of the normalised template.
        gradients.iter_mut().for_each(|g| *g = (g.0 / norm, g.1 / norm));
        let unit = |&(x, y): &(f32, f32)| ((x - centre.0) / radius, (y - centre.1) / radius);
        let affine = points.iter().zip(&gradients).map(|(p, &(gx, gy))| {
            let (u, v) = unit(p);
            [gx * u, gx * v, gx, gy * u, gy * v, gy]
        });
        let affine = Descent::new(affine.collect(), &used, &values)?;
        let similarity = points.iter().zip(&gradients).map(|(p, &(gx, gy))| {
            let (u, v) = unit(p);
            [gx * u + gy * v, gy * u - gx * v, gx, gy]
        });
        let similarity = Descent::new(similarity.collect(), &used, &values)?;
        Some(Self {
            points,
            weights: used,
            values,
            affine,
            similarity,
        })
    }

    /// Σ w·T·i and the weighted norm of i about its weighted mean.
    fn gain_and_norm(&self, samples: &[f32]) -> (f32, f32) {
        let (mut mean, mut square, mut gain) = (0.0f32, 0.0f32, 0.0f32);
        for ((&s, &w), &v) in samples.iter().zip(&self.weights).zip(&self.values) {
            mean += w * s;
            square += w * s * s;
            gain += w * s * v;
        }
        (gain, (square - mean * mean).max(0.0).sqrt())
    }
}

impl<const N: usize> Descent<N> {
    fn new(mut images: Vec<[f32; N]>, weights: &[f32], values: &[f32]) -> Option<Self> {
        for k in 0..N {
            let (mut mean, mut along) = (0.0f64, 0.0f64);
            for ((image, &w), &v) in images.iter().zip(weights).zip(values) {
                mean += f64::from(w * image[k]);
                along += f64::from(w * image[k] * v);
            }
            for (image, &v) in images.iter_mut().zip(values) {
                image[k] -= mean as f32 + along as f32 * v;
            }
        }
        let mut matrix = SMatrix::<f64, N, N>::zeros();
        for (image, &w) in images.iter().zip(weights) {
            for a in 0..N {
                for b in 0..N {
                    matrix[(a, b)] += f64::from(w) * f64::from(image[a]) * f64::from(image[b]);
                }
            }
        }
        let inverse = matrix.try_inverse()?.map(|v| v as f32);
        if !inverse.iter().all(|v| v.is_finite()) {
            return None;
        }
        for (image, &w) in images.iter_mut().zip(weights) {
            image.iter_mut().for_each(|v| *v *= w);
        }
        Some(Self { images, inverse })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pattern without repetition, smooth on the scale of some pixels.
    fn pattern(x: f32, y: f32) -> f32 {
        let blob =
            |cx: f32, cy: f32, r: f32, v: f32| v * (-((x - cx).powi(2) + (y - cy).powi(2)) / (r * r)).exp();
        blob(22.0, 20.0, 7.0, -60.0)
            + blob(60.0, 21.0, 7.0, -55.0)
            + blob(41.0, 40.0, 9.0, 40.0)
            + blob(22.0, 8.0, 6.0, -30.0)
            + blob(62.0, 9.0, 6.0, -35.0)
            + blob(10.0, 45.0, 8.0, 20.0)
            + blob(74.0, 48.0, 10.0, -20.0)
    }

    fn template() -> Template {
        let image = Plane::from_fn(84, 60, |x, y| pattern(x as f32, y as f32));
        let weights = Plane::from_fn(84, 60, |_, _| 1.0);
        Template::new(&image, &weights, (0.0, 0.0), 84.0).unwrap()
    }

    /// The pattern as seen through `map`, with a gain and a level.
    fn picture(map: &Affine, gain: f32, level: f32) -> Pyramid {
        let back = map.inverse().unwrap();
        let plane = Plane::from_fn(200, 160, |x, y| {
            let (x, y) = back.apply(x as f32, y as f32);
            gain * pattern(x, y) + level
        });
        Pyramid::new(plane, LEVELS)
    }

    fn worst_corner(a: &Affine, b: &Affine) -> f32 {
        [(0.0, 0.0), (83.0, 0.0), (0.0, 59.0), (83.0, 59.0)]
            .iter()
            .map(|&(x, y)| {
                let (p, q) = (a.apply(x, y), b.apply(x, y));
                (p.0 - q.0).hypot(p.1 - q.1)
            })
            .fold(0.0, f32::max)
    }

    #[test]
    fn known_maps_are_found_whatever_the_exposure() {
        let template = template();
        let start = Affine::scaled(1.0, 50.0, 40.0);
        for (map, gain, level) in [
            (Affine::scaled(1.0, 50.0, 40.0), 1.0, 0.0),
            (Affine::scaled(1.0, 55.3, 36.6), 1.0, 0.0),
            (Affine([1.04, -0.06, 48.0, 0.06, 1.04, 41.5]), 0.5, 30.0),
            (Affine([0.95, 0.03, 53.0, -0.02, 1.05, 38.0]), 1.8, -20.0),
        ] {
            let found = template.register(&picture(&map, gain, level), start).unwrap();
            let error = worst_corner(&found.map, &map);
            assert!(error < 0.1, "{error} px, {map:?}");
            assert!(found.score > 0.995, "{}", found.score);
        }
    }

    #[test]
    fn nothing_to_hold_on_to_is_no_template_and_no_match() {
        let flat = Plane::from_fn(84, 60, |_, _| 7.0);
        let weights = Plane::from_fn(84, 60, |_, _| 1.0);
        assert!(Template::new(&flat, &weights, (0.0, 0.0), 84.0).is_none());
        let blank = Pyramid::new(Plane::new(200, 160), LEVELS);
        assert!(template().register(&blank, Affine::IDENTITY).is_none());
        // Another pattern may be matched, but not well.
        let other = Plane::from_fn(200, 160, |x, y| ((x * 7919 + y * 104_729) % 251) as f32);
        let found = template().register(&Pyramid::new(other, LEVELS), Affine::scaled(1.0, 50.0, 40.0));
        assert!(found.is_none_or(|f| f.score < 0.5));
    }
}
