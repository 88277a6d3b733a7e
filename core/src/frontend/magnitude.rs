//! |a + jb| / 4 of two `i32` by a normalised sum of squares and a table of roots.
//!
//! Relative error below 0.2 % (0.1 % rms), plus 1 LSB of the result: the table is read without interpolation, √ of the
//! middle of each of its 896 steps. The errors of the bins are as good as random and average out in the channels: with
//! interpolation c1..c12 gained 3 to 5 dB and a hop cost 1,300 instructions more.
use crate::fixed::mul_high;
use crate::tables::root::ROOT;

/// Bits that a magnitude loses against its parts, so that channel sums fit into 32 bits.
pub const MAGNITUDE_SHIFT: u32 = 2;

/// √(a² + b²) / 4, at most 2^29.5.
#[inline(always)]
pub fn magnitude(a: i32, b: i32) -> u32 {
    // One's complement for negative numbers: 1 LSB off, and no overflow at −2³¹.
    let a = a ^ (a >> 31);
    let b = b ^ (b >> 31);
    let shift = ((a | b).leading_zeros() - 1) & 31;
    let (a, b) = (a << shift, b << shift);
    // The larger lies in [2³⁰, 2³¹), so the sum in [2²⁸, 2³¹); both zero gives zero.
    let square = (mul_high(a, a) + mul_high(b, b)) as u32;
    // The root of the middle of a step, in 16 bits of the normalised magnitude's 32.
    let root = u32::from(ROOT[(square >> 21) as usize & 1023]);
    (root << (16 - MAGNITUDE_SHIFT)) >> shift
}
