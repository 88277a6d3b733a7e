//! Gaussian mixtures of all states of a chain, as tensors.
use ndarray::{Array2, Array3};

/// Gaussian mixtures with diagonal covariance, one per state.
#[derive(Clone, Debug, PartialEq)]
pub struct Mixtures {
    /// `[states, K, dimensions]`
    pub mean: Array3<f32>,
    /// `[states, K, dimensions]`, positive.
    pub variance: Array3<f32>,
    /// Natural log of the weights, `[states, K]`; [`Mixtures::NO_WEIGHT`] for a component that is not used.
    pub log_weight: Array2<f32>,
}

impl Mixtures {
    /// Stands for ln 0 in a file that holds finite numbers only.
    pub const NO_WEIGHT: f32 = -1e9;
}
