//! Mel filterbank: 26 half-overlapping triangles over 0 Hz to 8 kHz, linear in mel (1127·ln(1 + f/700)).
//!
//! A bin between the centres of two channels gives its share to the lower and the rest to the upper one. Shares are
//! Q16, sums exact. |error| of a sum ≤ 2⁻¹⁷ of the sum.
use crate::frontend::fft::FFT_HALF;
use crate::tables::mel::{EDGES, SHARES};

/// Channels.
pub const N_MEL: usize = 26;

/// Channel sums in Q(f + 16) of magnitudes in Qf, bins 1..=255; at most 2³¹·2¹⁶·21 bins < 2⁵².
pub fn filterbank(magnitudes: &[u32; FFT_HALF], out: &mut [u64; N_MEL]) {
    let mut rising = 0;
    for (channel, edges) in EDGES.windows(2).enumerate() {
        let (from, to) = (usize::from(edges[0]), usize::from(edges[1]));
        let mut falling = 0u64;
        let mut total = 0u64;
        for (&magnitude, &share) in magnitudes[from..to].iter().zip(&SHARES[from..to]) {
            falling += u64::from(magnitude) * u64::from(share);
            total += u64::from(magnitude);
        }
        if channel > 0 {
            out[channel - 1] = rising + falling;
        }
        rising = (total << 16) - falling;
    }
}
