//! The floor of what is heard: what a room's hiss adds to the energy and to the mel channels of every window.
use lipstream_core::frontend::floor::{self, LEVEL};

use super::mel::{Filterbank, N_MEL};
use super::preemphasis::COEFFICIENT;

/// What is added to the energy of a window.
pub const ENERGY: f64 = floor::ENERGY as f64;

/// What is added to each channel of `mel`: the mean magnitudes of white noise in a window weighed by `window`. The magnitude of a complex
/// Gaussian is √(π/4) of the root of its power in the mean.
pub fn channels(mel: &Filterbank, window: &[f64]) -> [f64; N_MEL] {
    let power: f64 = window.iter().map(|w| w * w).sum();
    let level = LEVEL as f64 * (std::f64::consts::FRAC_PI_4 * power).sqrt();
    let points = mel.points();
    let magnitudes: Vec<f64> = (0..=points / 2)
        .map(|k| {
            let angle = std::f64::consts::TAU * k as f64 / points as f64;
            let c = COEFFICIENT;
            level * (1.0 - 2.0 * c * angle.cos() + c * c).sqrt()
        })
        .collect();
    mel.apply(&magnitudes)
}
