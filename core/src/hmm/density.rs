//! Log likelihoods of audio states: mixtures of Gaussians with diagonal covariances.
//!
//! log2 Σ_k w_k·N(o; μ_k, σ_k²) = log2 Σ_k 2^(c_k − ½ log2 e · Σ_d ((o_d − μ_kd)/σ_kd)²), from i8 means and u8
//! inverse deviations. The result, to the power of the acoustic scale, is what the forward pass sees: diagonal
//! Gaussians over overlapping windows are overconfident at scale 1.
use crate::N_OBSERVATION;
use crate::fixed::saturate_i32;
use crate::logmath::LogProb;
use crate::model::Model;
use crate::model::field::{DISTANCE_SHIFT, MEAN_SHIFT, OBSERVATION_LIMIT};

/// Log likelihoods are held to ±2¹⁵ bits.
const LIMIT: i64 = 1 << 27;

/// An observation centred and scaled for the densities: sixteenths of a mean step, ±8191.
#[derive(Clone, Debug)]
pub struct Scaled([i16; N_OBSERVATION]);

impl Scaled {
    /// From the front end's 39 numbers, Q7.8.
    pub fn new(model: &Model, observation: &[i16; N_OBSERVATION]) -> Self {
        let mut scaled = [0; N_OBSERVATION];
        for ((to, from), (centre, gain)) in scaled
            .iter_mut()
            .zip(observation)
            .zip(model.observation_scaling())
        {
            // 17 bits · 30 bits.
            let product = (i64::from(*from) - i64::from(centre)) * i64::from(gain);
            let limit = i64::from(OBSERVATION_LIMIT);
            *to = ((product + (1 << 15)) >> 16).clamp(-limit, limit) as i16;
        }
        Self(scaled)
    }

    /// Σ ((o − μ)/σ)² in units of the model's distance gain; below 2³⁰ whatever the tables hold.
    #[inline]
    fn distance(&self, mean: &[u8; N_OBSERVATION], inverse_deviation: &[u8; N_OBSERVATION]) -> u32 {
        let mut sum = 0;
        for ((o, m), w) in self.0.iter().zip(mean).zip(inverse_deviation) {
            // |o − 16m| ≤ 10239; times 255 < 2²²; shifted ≤ 5100; squared < 2²⁵; 39 of them < 2³⁰.
            let difference = i32::from(*o) - (i32::from(*m as i8) << MEAN_SHIFT);
            let z = (difference * i32::from(*w)) >> DISTANCE_SHIFT;
            sum += (z * z) as u32;
        }
        sum
    }
}

/// Log likelihood of an observation in audio state 5·phone + i, to the power of `acoustic_scale` (Q16.16).
pub fn log_likelihood(model: &Model, state: usize, scaled: &Scaled, acoustic_scale: u32) -> LogProb {
    let gain = u64::from(model.distance_gain());
    let mut sum = LogProb::NEVER;
    for density in model.mixture(state) {
        let Some(constant) = density.constant else {
            continue;
        };
        let distance = scaled.distance(density.mean, density.inverse_deviation);
        // Below 2³⁰ · 2²⁸ = 2⁵⁸.
        let exponent = ((u64::from(distance) * gain) >> 20) as i64;
        let log = (i64::from(constant.q12()) - exponent).max(-LIMIT);
        sum = sum.plus(LogProb::from_q12(log as i32));
    }
    // |sum| ≤ 2²⁷ + 5 bits; a state without a density keeps NEVER = −2²⁹ and is held to −2²⁷.
    let powered = (i64::from(sum.q12()) * i64::from(acoustic_scale)) >> 16;
    LogProb::from_q12(saturate_i32(powered.clamp(-LIMIT, LIMIT)))
}
