//! Natural logarithm of the channel sums, floored at 1.0 on int16 scale.
use super::mel::N_MEL;

/// ln max(m, 1) of 26 channels, in [0, 17].
pub fn log_mel(sums: &[f64; N_MEL]) -> [f64; N_MEL] {
    sums.map(|m| m.max(1.0).ln())
}
