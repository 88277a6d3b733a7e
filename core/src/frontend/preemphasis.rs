//! Pre-emphasis inside the window: s\[i\] −= 0.97·s\[i−1\], s\[0\] ×= 0.03.
//!
//! Exact but for the coefficient, 31785/32768 = 0.9700012. The first sample follows the same rule with itself
//! as its predecessor.

/// 0.97 in Q15.
const COEFFICIENT: i32 = 31_785;

/// x − 0.97·previous, Q15. |result| ≤ 2¹⁵·(32768 + 31785) < 2³¹.
#[inline(always)]
pub fn emphasise(x: i16, previous: i16) -> i32 {
    (i32::from(x) << 15) - COEFFICIENT * i32::from(previous)
}
