//! A linear model of vectors by principal components: v ≈ v̄ + Pᵀ·b, b = P·(v − v̄), with the variance of each b.
//!
//! Every step of the hierarchical model is one: shapes and textures (eq. 1 and 2), their joint parameters (eq. 3), speech (eq. 4 and 5), and the
//! appearance and speech of a cluster (eq. 7).
use ndarray::{Array1, Array2, ArrayView1};

use crate::error::{Result, bail};
use crate::tensors::{Tensors, TensorsBuilder};

/// Components and the variance along each.
#[derive(Clone, Debug, PartialEq)]
pub struct Linear {
    /// v̄ `[D]`.
    pub mean: Array1<f32>,
    /// Orthonormal rows, largest variance first, `[modes, D]`; no row where nothing varies.
    pub components: Array2<f32>,
    /// Variance of each parameter b, `[modes]`.
    pub variances: Array1<f32>,
}

impl Linear {
    /// Parameters of a vector.
    pub fn project(&self, vector: ArrayView1<f32>) -> Array1<f32> {
        self.components.dot(&(&vector - &self.mean))
    }

    /// The vector that parameters stand for.
    pub fn expand(&self, parameters: ArrayView1<f32>) -> Array1<f32> {
        parameters.dot(&self.components) + &self.mean
    }

    /// Number of parameters.
    pub fn modes(&self) -> usize {
        self.variances.len()
    }

    /// Length of a vector.
    pub fn size(&self) -> usize {
        self.mean.len()
    }

    /// Holds parameters within `deviations` standard deviations of their mean.
    pub fn hold(&self, parameters: &mut Array1<f32>, deviations: f32) {
        for (b, variance) in parameters.iter_mut().zip(&self.variances) {
            let most = deviations * variance.max(0.0).sqrt();
            *b = b.clamp(-most, most);
        }
    }

    pub(super) fn put(&self, out: &mut TensorsBuilder, name: &str) {
        out.put(&format!("{name}.mean"), &self.mean);
        out.put(&format!("{name}.components"), &self.components);
        out.put(&format!("{name}.variances"), &self.variances);
    }

    pub(super) fn read(from: &Tensors, name: &str) -> Result<Self> {
        let found = Self {
            mean: from.array(&format!("{name}.mean"))?,
            components: from.array(&format!("{name}.components"))?,
            variances: from.array(&format!("{name}.variances"))?,
        };
        if found.components.dim() != (found.modes(), found.size()) || found.variances.iter().any(|v| *v < 0.0)
        {
            bail!(
                File,
                "{name}: the sizes of mean, components and variances do not fit each other, or a variance is negative"
            );
        }
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn what_lies_in_the_plane_comes_back_and_limits_hold() {
        let model = Linear {
            mean: array![1.0, 2.0, 3.0],
            components: array![[0.6, 0.8, 0.0], [0.0, 0.0, 1.0]],
            variances: array![4.0, 1.0],
        };
        let vector = model.expand(array![2.0, -0.5].view());
        let back = model.project(vector.view());
        assert!((&back - &array![2.0, -0.5]).iter().all(|d| d.abs() < 1e-6));
        // What lies at a right angle to the plane leaves no trace.
        let off = &vector + &array![-0.8, 0.6, 0.0];
        assert!((model.project(off.view()) - back).iter().all(|d| d.abs() < 1e-6));
        let mut far = array![-9.0, 9.0];
        model.hold(&mut far, 3.0);
        assert_eq!(far, array![-6.0, 3.0]);
    }
}
