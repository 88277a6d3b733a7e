//! Eigenmouths from training images (X&L section 5, eq. 11-13): principal components of colour mouth images.
//!
//! With n images of P numbers, n ≪ P, the components come from the n × n Gram matrix X·Xᵀ = U Λ Uᵀ (Turk & Pentland's
//! trick): eigenmouth k is Xᵀu_k / √λ_k.
use anyhow::{Result, bail};
use nalgebra::{DMatrix, SymmetricEigen};
use ndarray::{Array1, Array2, ArrayView1, Axis};

use super::tracker::MouthTrack;
use crate::mouth::MouthSpace;

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

    pub fn is_empty(&self) -> bool {
        self.differences.is_empty()
    }

    /// Adds `keep` images of a clip, evenly spread over it.
    ///
    /// Clips must be added in a fixed order for the same result bit by bit.
    pub fn add_clip(&mut self, track: &MouthTrack, keep: usize) -> Result<()> {
        if (track.width, track.height) != (self.width, self.height) {
            bail!(
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
    let count = samples.len();
    if size == 0 || count <= size {
        bail!("{size} eigenmouths need more than {size} images; there are {count}");
    }
    let pixels = samples.mean.len();
    let mut rows = Array2::from_shape_vec((count, pixels), samples.differences.clone())?;
    let centre = rows.mean_axis(Axis(0)).unwrap_or_else(|| Array1::zeros(pixels));
    rows -= &centre;
    let gram = rows.dot(&rows.t());
    let total: f64 = gram.diag().iter().map(|v| f64::from(*v)).sum();
    if total <= 0.0 {
        bail!("the mouth images do not differ from each other");
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
            bail!("the mouth images span only {k} dimensions, {size} eigenmouths are wanted");
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
    let mean = samples
        .mean
        .iter()
        .map(|s| (s / samples.clips as f64) as f32)
        .collect();
    let space = MouthSpace {
        width: samples.width,
        height: samples.height,
        mean,
        basis,
        deviation,
    };
    Ok((space, (carried / total) as f32))
}

fn largest(values: ArrayView1<f32>) -> f32 {
    values
        .iter()
        .copied()
        .fold(0.0, |best, v| if v.abs() > f32::abs(best) { v } else { best })
}
