//! A new voice brought to the training voice's distribution of speech parameters (COS section 7: the offset and the shape of the distribution are what breaks lip-sync of other speakers).
//!
//! A few seconds of the new voice are enough, of which nothing need be known. Training speech has mean 0 and a diagonal covariance Λ, since s are principal components;
//! the new voice's m and C are measured. By level, each number is moved and scaled: s' = Λ^½·diag(C)^-½·(s − m). By a linear transform the covariance becomes Λ as a whole:
//! s' = Λ^½·L⁻¹·(s − m), with C = L·Lᵀ, L lower triangular, so that the first number is only scaled and every other one is freed of those before it.
use ndarray::{Array1, Array2, ArrayView2, Axis};

use super::Linear;

/// What of a new voice is brought to the training voice's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Adaptation {
    /// Mean and variance of each speech parameter.
    Level,
    /// Mean and covariance.
    Linear,
}

/// The map of one voice's speech parameters onto the training voice's.
#[derive(Clone, Debug, PartialEq)]
pub struct Voice {
    mean: Array1<f32>,
    /// `[S, S]`.
    map: Array2<f32>,
}

impl Voice {
    /// Learns the map from speech parameters `[pictures, S]` of a voice, which [`HierarchicalModel::speech_parameters`](super::HierarchicalModel::speech_parameters) gives.
    ///
    /// Covariances between numbers are shrunk by S / (S + pictures): of few pictures they are mostly chance. Without a picture, and in a number that the voice never changes,
    /// nothing is scaled.
    pub fn learn(training: &Linear, speech: ArrayView2<f32>, adaptation: Adaptation) -> Self {
        let size = training.modes();
        let Some(mean) = speech.mean_axis(Axis(0)) else {
            return Self {
                mean: Array1::zeros(size),
                map: Array2::eye(size),
            };
        };
        let centred = (&speech - &mean).mapv(f64::from);
        let n = centred.nrows() as f64;
        let mut covariance = centred.t().dot(&centred) / n;
        let shrink = match adaptation {
            Adaptation::Level => 0.0,
            Adaptation::Linear => n / (n + size as f64),
        };
        for ((a, b), value) in covariance.indexed_iter_mut() {
            if a != b {
                *value *= shrink;
            }
        }
        let wanted = training.variances.mapv(|v| f64::from(v).sqrt());
        Self {
            mean,
            map: whitened(&covariance, &wanted).mapv(|v| v as f32),
        }
    }

    /// Speech parameters `[pictures, S]` as the training voice would have said them.
    pub fn apply(&self, speech: &Array2<f32>) -> Array2<f32> {
        (speech - &self.mean).dot(&self.map.t())
    }
}

/// diag(wanted)·L⁻¹ for a covariance L·Lᵀ, row after row: row k of L⁻¹ makes of a number what those before it do not tell, at variance 1. A number of which nothing is left stays as it is.
fn whitened(covariance: &Array2<f64>, wanted: &Array1<f64>) -> Array2<f64> {
    let size = wanted.len();
    let mut inverse = Array2::<f64>::zeros((size, size));
    for k in 0..size {
        // What is left of number k without its projections onto the whitened numbers before it.
        let mut row = Array1::<f64>::zeros(size);
        row[k] = 1.0;
        for before in 0..k {
            let along = inverse.row(before).dot(&covariance.row(k));
            row.scaled_add(-along, &inverse.row(before));
        }
        let variance = row.dot(&covariance.dot(&row));
        if variance > 1e-6 * covariance[(k, k)].max(1e-12) {
            row /= variance.sqrt();
            inverse.row_mut(k).assign(&row);
        }
    }
    let mut map = inverse;
    for (k, mut row) in map.outer_iter_mut().enumerate() {
        if row.iter().all(|v| *v == 0.0) {
            row[k] = 1.0;
        } else {
            row *= wanted[k];
        }
    }
    map
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    fn training() -> Linear {
        Linear {
            mean: Array1::zeros(12),
            components: Array2::zeros((3, 12)),
            variances: array![9.0, 4.0, 1.0],
        }
    }

    /// The training distribution, and what another voice makes of it.
    fn voices() -> (Array2<f32>, Array2<f32>) {
        let mut state = 7u32;
        let mut drawn = || {
            // Sums of four even numbers are nearly normal.
            let mut sum = 0.0f32;
            for _ in 0..4 {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                sum += (state >> 8) as f32 / (1 << 24) as f32 - 0.5;
            }
            sum * 3.0f32.sqrt()
        };
        let own = Array2::from_shape_fn((4000, 3), |(_, k)| [3.0, 2.0, 1.0][k] * drawn());
        let other =
            own.dot(&array![[1.5, 0.4, 0.0], [0.0, 0.7, -0.5], [0.0, 0.0, 2.0]]) + array![5.0, -3.0, 1.0];
        (own, other)
    }

    fn covariance(rows: &Array2<f32>) -> Array2<f32> {
        let centred = rows - &rows.mean_axis(Axis(0)).unwrap();
        centred.t().dot(&centred) / rows.nrows() as f32
    }

    #[test]
    fn levels_and_covariances_become_the_training_voices() {
        let (_, other) = voices();
        for adaptation in [Adaptation::Level, Adaptation::Linear] {
            let said = Voice::learn(&training(), other.view(), adaptation).apply(&other);
            assert!(said.mean_axis(Axis(0)).unwrap().iter().all(|m| m.abs() < 1e-3));
            let found = covariance(&said);
            for k in 0..3 {
                assert!(
                    (found[(k, k)] / training().variances[k] - 1.0).abs() < 0.02,
                    "{found}"
                );
            }
            let between = found[(1, 2)].abs().max(found[(0, 1)].abs());
            assert_eq!(between < 0.05, adaptation == Adaptation::Linear, "{found}");
        }
    }

    #[test]
    fn a_triangular_change_of_the_voice_is_undone() {
        let (own, other) = voices();
        let said = Voice::learn(&training(), other.view(), Adaptation::Linear).apply(&other);
        // The drawn voice's own moments differ a little from those of the distribution that it was drawn from.
        let off = &said - &own;
        let rest = off.mapv(|v| v * v).mean().unwrap().sqrt();
        assert!(rest < 0.15, "{rest}");
    }

    #[test]
    fn few_pictures_and_numbers_that_never_change_are_no_trouble() {
        let none = Voice::learn(&training(), Array2::zeros((0, 3)).view(), Adaptation::Linear);
        let speech = array![[1.0f32, 2.0, 3.0]];
        assert_eq!(none.apply(&speech), speech);
        let one = Voice::learn(&training(), speech.view(), Adaptation::Linear).apply(&speech);
        assert_eq!(one, array![[0.0, 0.0, 0.0]]);
        let still = array![[1.0, 5.0, 0.0], [3.0, 5.0, 1.0], [2.0, 5.0, 5.0]];
        let said = Voice::learn(&training(), still.view(), Adaptation::Linear).apply(&still);
        assert!(said.iter().all(|v| v.is_finite()) && said.column(1).iter().all(|v| *v == 0.0));
    }
}
