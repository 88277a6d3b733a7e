//! Cepstra c1..c12: DCT-II scaled by √(2/26), lifter 1 + 11·sin(πn/22), and ln 2 for the base-2 logarithm.
//!
//! cos(πn(j + ½)/26) is even in the channels' mirror for even n and odd for odd n, so 13 sums and 13 differences
//! carry everything: 156 products. |error| ≤ 0.008 for log sums of up to 16 octaves (half an LSB and the table's).
use crate::N_CEPSTRA;
use crate::fixed::{mul_long, round_shift_i64, saturate_i16, saturate_i32};
use crate::frontend::mel::N_MEL;
use crate::tables::dct::COSINES;

/// Liftered c1..c12 in Q7.8, saturating, of log₂ sums in Q5.16.
pub fn cepstra(log_mel: &[i32; N_MEL], out: &mut [i16; N_CEPSTRA]) {
    let mut sums = [0i32; N_MEL / 2];
    let mut differences = [0i32; N_MEL / 2];
    let (low, high) = log_mel.split_at(N_MEL / 2);
    for (j, (&a, &b)) in low.iter().zip(high.iter().rev()).enumerate() {
        sums[j] = a + b;
        differences[j] = a - b;
    }
    for (rows, c) in COSINES.chunks_exact(2).zip(out.chunks_exact_mut(2)) {
        c[0] = row(&rows[0], &differences);
        c[1] = row(&rows[1], &sums);
    }
}

#[inline(always)]
fn row(cosines: &[i16; N_MEL / 2], values: &[i32; N_MEL / 2]) -> i16 {
    // Q13 × Q16 = Q29; 13 terms of at most 2¹⁵·2²² < 2⁴¹.
    let sum: i64 = cosines
        .iter()
        .zip(values)
        .map(|(&c, &v)| mul_long(i32::from(c), v))
        .sum();
    saturate_i16(saturate_i32(round_shift_i64(sum, 21)))
}
