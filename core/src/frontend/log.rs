//! Base-2 logarithm of channel sums, floored at 1.0 on int16 scale.
//!
//! |error| ≤ 7e-5: a table at 64 points of the octave, read with linear interpolation, in Q16.
use crate::fixed::mul_high_u32;
use crate::frontend::mel::N_MEL;
use crate::tables::log::LOG2;

/// log₂ x in Q16, x ≥ 1; 0 gives 0.
#[inline(always)]
pub fn log2_q16(x: u64) -> i32 {
    let x = x.max(1);
    let zeros = x.leading_zeros();
    let mantissa = ((x << zeros) >> 32) as u32; // in [2³¹, 2³²)
    let at = ((mantissa >> 25) & 63) as usize;
    let step = LOG2[at + 1] - LOG2[at];
    let fraction = LOG2[at] + mul_high_u32(step, mantissa << 7);
    (((63 - zeros) << 16) + fraction) as i32
}

/// max(log₂ m, 0) in Q5.16 of channel sums m in `fraction_bits`; in [0, 25].
pub fn log_mel(sums: &[u64; N_MEL], fraction_bits: u32) -> [i32; N_MEL] {
    sums.map(|m| (log2_q16(m) - (fraction_bits << 16) as i32).max(0))
}
