//! Log likelihoods of audio states: mixtures of Gaussians with diagonal covariances.
//!
//! log2 Σ_k w_k·N(o; μ_k, σ_k²) = log2 Σ_k 2^(c_k − ½ log2 e · Σ_d ((o_d − μ_kd)/σ_kd)²), from i8 means and u8
//! inverse deviations. The result, to the power of the acoustic scale, is what the forward pass sees: diagonal
//! Gaussians over overlapping windows are overconfident at scale 1.
use super::tables::{DISTANCE_SHIFT, MEAN_SHIFT, MixtureTables, OBSERVATION_LIMIT};
use crate::N_OBSERVATION;
use crate::fixed::saturate_i32;
use crate::logmath::LogProb;

/// Log likelihoods are held to ±2¹⁵ bits.
const LIMIT: i64 = 1 << 27;

/// An observation centred and scaled for the densities: sixteenths of a mean step, ±8191.
#[derive(Clone, Debug)]
pub struct Scaled([i16; N_OBSERVATION]);

impl Scaled {
    /// From the front end's 39 numbers, Q7.8.
    pub fn new(audio: &MixtureTables, observation: &[i16; N_OBSERVATION]) -> Self {
        let mut scaled = [0; N_OBSERVATION];
        for ((to, from), (centre, gain)) in scaled.iter_mut().zip(observation).zip(audio.scaling()) {
            *to = place(*from, centre, gain);
        }
        Self(scaled)
    }
}

/// A number centred and scaled: sixteenths of a mean step, ±8191.
#[inline(always)]
pub(super) fn place(value: i16, centre: i16, gain: u32) -> i16 {
    // 17 bits · 30 bits.
    let product = (i64::from(value) - i64::from(centre)) * i64::from(gain);
    let limit = i64::from(OBSERVATION_LIMIT);
    ((product + (1 << 15)) >> 16).clamp(-limit, limit) as i16
}

/// Σ ((o − μ)/σ)² over at most 64 numbers in units of the distance gain; below 2³¹ whatever the tables hold.
#[inline(always)]
pub(super) fn squared_distance(placed: &[i16], mean: &[u8], inverse_deviation: &[u8]) -> u32 {
    let mut sum = 0;
    for ((o, m), w) in placed.iter().zip(mean).zip(inverse_deviation) {
        // |o − 16m| ≤ 10239; times 255 < 2²²; shifted ≤ 5100; squared < 1.6·2²⁴; 64 of them < 2³¹.
        let difference = i32::from(*o) - (i32::from(*m as i8) << MEAN_SHIFT);
        let z = (difference * i32::from(*w)) >> DISTANCE_SHIFT;
        sum += (z * z) as u32;
    }
    sum
}

/// Log of weight times likelihood from a density's constant and squared distance.
#[inline(always)]
pub(super) fn log_of(constant: LogProb, distance: u32, gain: u32) -> LogProb {
    // Below 2³¹ · 2²⁸ = 2⁵⁹.
    let exponent = ((u64::from(distance) * u64::from(gain)) >> 20) as i64;
    LogProb::from_q12((i64::from(constant.q12()) - exponent).max(-LIMIT) as i32)
}

/// A likelihood to the power of `exponent` (Q16.16, at most 4).
#[inline(always)]
pub(super) fn powered(log: LogProb, exponent: u32) -> LogProb {
    // |log| ≤ 2²⁷ + 5 bits; a state without a density keeps NEVER = −2²⁹ and is held to −2²⁷.
    let powered = (i64::from(log.q12()) * i64::from(exponent)) >> 16;
    LogProb::from_q12(saturate_i32(powered.clamp(-LIMIT, LIMIT)))
}

/// Log likelihood of an observation in audio state 5·phone + i, to the power of `acoustic_scale` (Q16.16).
pub fn log_likelihood(audio: &MixtureTables, state: usize, scaled: &Scaled, acoustic_scale: u32) -> LogProb {
    let gain = audio.distance_gain();
    let mut sum = LogProb::NEVER;
    for density in audio.of(state) {
        let Some(constant) = density.constant else {
            continue;
        };
        let distance = squared_distance(&scaled.0, density.mean, density.inverse_deviation);
        sum = sum.plus(log_of(constant, distance, gain));
    }
    powered(sum, acoustic_scale)
}
