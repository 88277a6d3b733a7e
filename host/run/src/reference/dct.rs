//! Cepstra: DCT-II scaled by √(2/26), c1..c12, then the lifter 1 + 11·sin(πn/22).
//!
//! c_n = (1 + 11·sin(πn/22))·√(2/26)·Σ_j m_j·cos(πn(j − ½)/26), j = 1..26.
use std::f64::consts::PI;

use lipstream_core::N_CEPSTRA;

use super::mel::N_MEL;

/// HTK's `CEPLIFTER`.
pub const LIFTER: f64 = 22.0;

/// The lifter at n.
pub fn lifter(n: usize) -> f64 {
    1.0 + LIFTER / 2.0 * (PI * n as f64 / LIFTER).sin()
}

/// Lifter and cosines in one matrix, `[12][26]`.
pub struct Cosines([[f64; N_MEL]; N_CEPSTRA]);

impl Default for Cosines {
    fn default() -> Self {
        let scale = (2.0 / N_MEL as f64).sqrt();
        Self(std::array::from_fn(|row| {
            let n = row + 1;
            std::array::from_fn(|j| {
                scale * lifter(n) * (PI * n as f64 * (j as f64 + 0.5) / N_MEL as f64).cos()
            })
        }))
    }
}

impl Cosines {
    /// Liftered c1..c12 of 26 log channel sums.
    pub fn cepstra(&self, log_mel: &[f64; N_MEL]) -> [f64; N_CEPSTRA] {
        self.0
            .map(|row| row.iter().zip(log_mel).map(|(c, m)| c * m).sum())
    }
}
