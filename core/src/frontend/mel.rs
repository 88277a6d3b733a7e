//! Mel filterbank: 26 half-overlapping triangles over 0 Hz to 8 kHz, linear in mel (1127·ln(1 + f/700)).
//!
//! A bin between the centres of two channels gives its share to the lower and the rest to the upper one. Shares are
//! Q16, sums exact. |error| of a sum ≤ 2e-5 of it.
use crate::fixed::mul_long_half;
use crate::frontend::fft::FFT_HALF;
use crate::tables::mel::{SHARES, WIDTHS};

/// Channels.
pub const N_MEL: usize = 26;

/// Channel sums in Q(f + 16) of magnitudes in Qf, bins 1..=255.
///
/// By Parseval the magnitudes of m bins sum to at most √m·16·√(Σ z²) < √24·16·2^20.48 samples (see `fft`), so that with
/// magnitudes in Q(4 + s) the totals stay below 2^30.8.
pub fn filterbank(magnitudes: &[u32; FFT_HALF], out: &mut [u64; N_MEL]) {
    let mut bins = magnitudes[1..].iter().zip(&SHARES);
    // What the bins between two centres give to the channel above. Those below the first centre give nothing else,
    // those above the last one only to the channel below.
    let mut rise = 0;
    for (between, &width) in WIDTHS.iter().enumerate() {
        let (mut fall, mut total) = (0u64, 0u32);
        for (&magnitude, &share) in bins.by_ref().take(usize::from(width)) {
            fall += mul_long_half(magnitude, share);
            total = total.wrapping_add(magnitude);
        }
        if between > 0 {
            out[between - 1] = rise + fall;
        }
        rise = (u64::from(total) << 16) - fall;
    }
}
