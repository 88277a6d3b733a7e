//! Pre-emphasis and Hamming window in one pass: z\[i\] = w\[i\]·(x\[i\] − 0.97·x\[i−1\]).
//!
//! w is Q31 and the pre-emphasised sample Q15, so their high word is Q14; it is stored in Q(9 + s), s being the
//! headroom that the energy allows. |error| ≤ 2 LSB, that is 2^(−8−s) of a sample, and 1.3e-6 of the loudest sample for
//! the rounded 0.97.
use crate::FRAME_SAMPLES;
use crate::fixed::mul_high;
use crate::frontend::fft::{Complex, FFT_HALF};
use crate::frontend::preemphasis::emphasise;
use crate::tables::window::WINDOW;

/// Fills the first 200 points of the transform's input: even samples in `re`, odd ones in `im`. `headroom` ≤ 5.
pub fn load(samples: &[i16; FRAME_SAMPLES], headroom: u32, out: &mut [Complex; FFT_HALF]) {
    let shift = 5 - headroom;
    pairs(samples.as_chunks().0, WINDOW.as_chunks().0, shift, out);
}

/// Kept apart from the number of samples, lest it be unrolled beyond what the registers hold.
#[inline(never)]
fn pairs(samples: &[[i16; 2]], weights: &[[i32; 2]], shift: u32, out: &mut [Complex]) {
    let mut previous = samples.first().map_or(0, |x| x[0]);
    for ((z, x), w) in out.iter_mut().zip(samples).zip(weights) {
        z.re = mul_high(emphasise(x[0], previous), w[0]) >> shift;
        z.im = mul_high(emphasise(x[1], x[0]), w[1]) >> shift;
        previous = x[1];
    }
}
