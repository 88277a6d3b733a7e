//! Eigenmouths from training images (X&L section 5, eq. 11-13): principal components of colour mouth images.
//!
//! With n images of P numbers, n ≪ P, the components come from the n × n Gram matrix X·Xᵀ = U Λ Uᵀ (Turk & Pentland's
//! trick): eigenmouth k is Xᵀu_k / √λ_k.
use nalgebra::{DMatrix, SymmetricEigen};
use ndarray::{Array1, Array2, ArrayView1, Axis, s};

use super::tracker::MouthTrack;
use crate::error::{Result, bail};
use lipstream::mouth::MouthSpace;

/// Training images of one speaker, each as its difference from the mean of its clip.
///
/// What differs between clips for a whole clip (light, beard) is no speech, and is to cost no eigenmouth.
pub struct MouthSamples {
    width: usize,
    height: usize,
    differences: Vec<f32>,
    /// Sum of the clips' mean images, and how many.
    mean: Vec<f64>,
    clips: usize,
}

impl MouthSamples {
    /// For images of `size` = (width, height).
    pub fn new(size: (usize, usize)) -> Self {
        Self {
            width: size.0,
            height: size.1,
            differences: Vec::new(),
            mean: vec![0.0; size.0 * size.1 * 3],
            clips: 0,
        }
    }

    /// Number of images.
    pub fn len(&self) -> usize {
        self.differences.len() / self.mean.len().max(1)
    }

    /// Whether no image has been added.
    pub fn is_empty(&self) -> bool {
        self.differences.is_empty()
    }

    /// Adds `keep` images of a clip, evenly spread over it.
    ///
    /// Clips must be added in a fixed order for the same result bit by bit.
    pub fn add_clip(&mut self, track: &MouthTrack, keep: usize) -> Result<()> {
        if (track.width, track.height) != (self.width, self.height) {
            bail!(
                Data,
                "mouths of {}×{} pixels among mouths of {}×{}",
                track.width,
                track.height,
                self.width,
                self.height
            );
        }
        let count = track.len();
        if count == 0 {
            return Ok(());
        }
        let mut mean = vec![0.0f64; self.mean.len()];
        for index in 0..count {
            for (m, v) in mean.iter_mut().zip(track.image(index)) {
                *m += f64::from(*v);
            }
        }
        mean.iter_mut().for_each(|m| *m /= count as f64);
        let keep = keep.min(count);
        for i in 0..keep {
            let image = track.image((2 * i + 1) * count / (2 * keep));
            self.differences
                .extend(image.iter().zip(&mean).map(|(v, m)| (f64::from(*v) - m) as f32));
        }
        self.mean.iter_mut().zip(&mean).for_each(|(s, m)| *s += m);
        self.clips += 1;
        Ok(())
    }
}

/// The mean mouth and the first `size` eigenmouths; the share of the images' variance that they carry.
pub fn eigenmouths(samples: &MouthSamples, size: usize) -> Result<(MouthSpace, f32)> {
    let found = Components::of(samples.centred()?, size)?;
    Ok((
        samples.space(found.basis, found.deviation),
        (found.carried / found.total) as f32,
    ))
}

/// The mean mouth and `size` eigenmouths of each colour, as the paper has them (X&L section 5: 30 of each, 90 numbers): those of red, of green, of blue; the share
/// of the images' variance that they carry.
pub fn eigenmouths_by_channel(samples: &MouthSamples, size: usize) -> Result<(MouthSpace, f32)> {
    let rows = samples.centred()?;
    let mut basis = Array2::<f32>::zeros((3 * size, rows.ncols()));
    let mut deviation = Array1::<f32>::zeros(3 * size);
    let (mut carried, mut total) = (0.0, 0.0);
    for channel in 0..3 {
        let found = Components::of(rows.slice(s![.., channel..;3]).to_owned(), size)?;
        let of_channel = channel * size..(channel + 1) * size;
        basis
            .slice_mut(s![of_channel.clone(), channel..;3])
            .assign(&found.basis);
        deviation.slice_mut(s![of_channel]).assign(&found.deviation);
        carried += found.carried;
        total += found.total;
    }
    Ok((samples.space(basis, deviation), (carried / total) as f32))
}

impl MouthSamples {
    /// The differences without their mean, `[n, P]`.
    fn centred(&self) -> Result<Array2<f32>> {
        let pixels = self.mean.len();
        let mut rows = Array2::from_shape_vec((self.len(), pixels), self.differences.clone())?;
        let centre = rows.mean_axis(Axis(0)).unwrap_or_else(|| Array1::zeros(pixels));
        rows -= &centre;
        Ok(rows)
    }

    fn space(&self, basis: Array2<f32>, deviation: Array1<f32>) -> MouthSpace {
        let mean = self.mean.iter().map(|s| (s / self.clips as f64) as f32).collect();
        MouthSpace {
            width: self.width,
            height: self.height,
            mean,
            basis,
            deviation,
        }
    }
}

/// Principal components of rows without a mean.
struct Components {
    /// Orthonormal, `[size, P]`, largest variance first.
    basis: Array2<f32>,
    deviation: Array1<f32>,
    /// Variance that they carry, and all of it.
    carried: f64,
    total: f64,
}

impl Components {
    fn of(rows: Array2<f32>, size: usize) -> Result<Self> {
        let (count, pixels) = rows.dim();
        if size == 0 || count <= size {
            bail!(
                Choice,
                "{size} eigenmouths need more than {size} images; there are {count}"
            );
        }
        let gram = rows.dot(&rows.t());
        let total: f64 = gram.diag().iter().map(|v| f64::from(*v)).sum();
        if total <= 0.0 {
            bail!(Numbers, "the mouth images do not differ from each other");
        }
        let gram = DMatrix::from_fn(count, count, |a, b| f64::from(gram[(a, b)]));
        let eigen = SymmetricEigen::new(gram);
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        let mut basis = Array2::<f32>::zeros((size, pixels));
        let mut deviation = Array1::<f32>::zeros(size);
        let mut carried = 0.0;
        for (k, &index) in order.iter().take(size).enumerate() {
            let value = eigen.eigenvalues[index];
            if value < 1e-9 * total {
                bail!(
                    Numbers,
                    "the mouth images span only {k} dimensions, {size} eigenmouths are wanted"
                );
            }
            carried += value;
            let weights: Array1<f32> = eigen
                .eigenvectors
                .column(index)
                .iter()
                .map(|v| *v as f32)
                .collect();
            let mut mouth = weights.dot(&rows);
            // Rounding left it not quite at a right angle to the ones before.
            for before in 0..k {
                let along = basis.row(before).dot(&mouth);
                mouth.scaled_add(-along, &basis.row(before));
            }
            let norm = mouth.dot(&mouth).sqrt();
            // The sign is arbitrary: the largest pixel is positive, so that results can be compared.
            let sign = if largest(mouth.view()) < 0.0 { -1.0 } else { 1.0 };
            basis.row_mut(k).assign(&(mouth * (sign / norm)));
            deviation[k] = (value / count as f64).sqrt() as f32;
        }
        Ok(Self {
            basis,
            deviation,
            carried,
            total,
        })
    }
}

fn largest(values: ArrayView1<f32>) -> f32 {
    values
        .iter()
        .copied()
        .fold(0.0, |best, v| if v.abs() > f32::abs(best) { v } else { best })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vision::ChannelMap;
    use lipstream::affine::Affine;

    const SIZE: (usize, usize) = (8, 6);
    const PIXELS: usize = 8 * 6 * 3;

    /// Two patterns at right angles, of unit length, and how strong each is in image `t`.
    fn patterns() -> [Vec<f32>; 2] {
        let raw: [Vec<f32>; 2] = [
            (0..PIXELS).map(|p| if p % 2 == 0 { 1.0 } else { -1.0 }).collect(),
            (0..PIXELS)
                .map(|p| if p / 2 % 2 == 0 { 1.0 } else { -1.0 })
                .collect(),
        ];
        raw.map(|v| v.iter().map(|x| x / (PIXELS as f32).sqrt()).collect())
    }

    fn strengths(t: usize) -> [f32; 2] {
        let t = t as f32;
        [300.0 * (0.7 * t).sin(), 120.0 * (1.9 * t + 0.4).cos()]
    }

    fn clip(level: f32, count: usize) -> MouthTrack {
        let [a, b] = patterns();
        let images = (0..count)
            .flat_map(|t| {
                let [x, y] = strengths(t);
                let (a, b) = (a.clone(), b.clone());
                (0..PIXELS).map(move |p| (level + x * a[p] + y * b[p]).round() as u8)
            })
            .collect();
        MouthTrack {
            width: SIZE.0,
            height: SIZE.1,
            images,
            transforms: vec![Affine::IDENTITY; count],
            scores: vec![1.0; count],
            colour: [ChannelMap::IDENTITY; 3],
            rate_hz: 25.0,
            lips: None,
            outlines: Vec::new(),
        }
    }

    #[test]
    fn a_known_subspace_is_found() {
        let mut samples = MouthSamples::new(SIZE);
        // The clips' own levels are no part of the subspace.
        for level in [100.0, 128.0, 156.0] {
            samples.add_clip(&clip(level, 60), 40).unwrap();
        }
        assert_eq!(samples.len(), 120);
        let (space, share) = eigenmouths(&samples, 2).unwrap();
        assert!(share > 0.995, "{share}");
        for (k, pattern) in patterns().iter().enumerate() {
            let along: f32 = space.basis.row(k).iter().zip(pattern).map(|(a, b)| a * b).sum();
            assert!(along.abs() > 0.999, "{k}: {along}");
            for other in 0..2 {
                let product = space.basis.row(k).dot(&space.basis.row(other));
                assert!((product - f32::from(u8::from(k == other))).abs() < 1e-5);
            }
        }
        // Standard deviation of 300·sin and 120·cos.
        assert!((space.deviation[0] - 212.0).abs() < 15.0 && (space.deviation[1] - 85.0).abs() < 8.0);
        assert!(space.mean.iter().all(|m| (m - 128.0).abs() < 6.0));
    }

    #[test]
    fn each_colour_has_its_own() {
        let mut samples = MouthSamples::new(SIZE);
        for level in [100.0, 156.0] {
            samples.add_clip(&clip(level, 60), 40).unwrap();
        }
        let (joint, _) = eigenmouths(&samples, 2).unwrap();
        let (space, share) = eigenmouths_by_channel(&samples, 2).unwrap();
        assert!(space.size() == 6 && share > 0.995, "{share}");
        assert_eq!(space.mean, joint.mean);
        for (k, row) in space.basis.outer_iter().enumerate() {
            assert!((row.dot(&row) - 1.0).abs() < 1e-4);
            // Nothing of the other colours.
            let others = row.iter().enumerate().filter(|(p, _)| p % 3 != k / 2);
            assert!(others.into_iter().all(|(_, v)| *v == 0.0), "{k}");
        }
        assert!(eigenmouths_by_channel(&samples, 200).is_err());
    }

    #[test]
    fn weights_of_a_clip_carry_its_movement_and_not_its_light() {
        let mut samples = MouthSamples::new(SIZE);
        samples.add_clip(&clip(128.0, 60), 60).unwrap();
        let (space, _) = eigenmouths(&samples, 2).unwrap();
        let dark = space.project_clip(&clip(110.0, 60).images, true).unwrap();
        let light = space.project_clip(&clip(140.0, 60).images, true).unwrap();
        assert!((&dark - &light).iter().all(|d| d.abs() < 4.0));
        assert!(dark.mean_axis(Axis(0)).unwrap().iter().all(|m| m.abs() < 1e-3));
        // Not taken off, the mean stays.
        let whole = space.project_clip(&clip(128.0, 60).images, false).unwrap();
        for (t, row) in whole.rows().into_iter().enumerate() {
            let image: Vec<f32> = clip(128.0, 60).image(t).iter().map(|v| f32::from(*v)).collect();
            let back = space.expand(row);
            assert!(back.iter().zip(&image).all(|(b, i)| (b - i).abs() < 2.0));
        }
        assert!(space.project_clip(&[0; 100], true).is_err());
    }

    #[test]
    fn too_few_or_equal_images_are_refused() {
        let mut samples = MouthSamples::new(SIZE);
        assert!(eigenmouths(&samples, 2).is_err());
        samples.add_clip(&clip(100.0, 2), 2).unwrap();
        assert!(eigenmouths(&samples, 2).is_err());
        let mut still = clip(100.0, 1);
        still.images = still.images.repeat(9);
        still.transforms = vec![Affine::IDENTITY; 9];
        let mut samples = MouthSamples::new(SIZE);
        samples.add_clip(&still, 9).unwrap();
        assert!(eigenmouths(&samples, 2).is_err());
        assert!(MouthSamples::new((6, 8)).add_clip(&still, 9).is_err());
    }
}
