//! Probabilities as base-2 logarithms in fixed point: product, sum, and the way back to plain numbers.
//!
//! log2(a + b) = max + log2(1 + 2^−d), d = |log2 a − log2 b|, from a table over d in steps of 1/8 with straight
//! lines between; 2^−d from a table in steps of 1/32. Both tables are computed by the compiler, in integers.

/// A probability or a likelihood: log2, Q19.12 (LSB 2⁻¹²), larger is better.
///
/// Live values stay within ±2²⁸ (±65536 bits); everything at or below [`LogProb::FLOOR`] counts as "never".
/// The floor is sized so that four times [`LogProb::NEVER`] does not overflow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LogProb(i32);

/// Fraction bits of [`LogProb`].
pub const FRACTION_BITS: u32 = 12;
/// Fraction bits of log probabilities in the model's tables (i16, [−32, 0]).
pub const TABLE_FRACTION_BITS: u32 = 10;
/// Fraction bits of the scores that tokens and windows keep (i16, [−128, 0]).
pub const SCORE_FRACTION_BITS: u32 = 8;
/// Stands for log2 0 in 16-bit tables.
pub const NEVER_I16: i16 = i16::MIN;

/// Fraction bits of what [`LogProb::exp2`] gives.
pub const LINEAR_FRACTION_BITS: u32 = 16;

impl LogProb {
    /// log2 1
    pub const ONE: Self = Self(0);
    /// log2 0
    pub const NEVER: Self = Self(i32::MIN / 4);
    /// At or below this a value stands for log2 0.
    pub const FLOOR: Self = Self(i32::MIN / 8);

    /// From LSBs of 2⁻¹².
    pub const fn from_q12(value: i32) -> Self {
        Self(value)
    }

    /// In LSBs of 2⁻¹².
    pub const fn q12(self) -> i32 {
        self.0
    }

    /// From a number of the model's tables, Q5.10; [`NEVER_I16`] is log2 0.
    #[inline]
    pub const fn from_table(value: i16) -> Self {
        if value == NEVER_I16 {
            Self::NEVER
        } else {
            Self((value as i32) << (FRACTION_BITS - TABLE_FRACTION_BITS))
        }
    }

    /// From a token's score, Q7.8; [`NEVER_I16`] is log2 0.
    #[inline]
    pub const fn from_score(value: i16) -> Self {
        if value == NEVER_I16 {
            Self::NEVER
        } else {
            Self((value as i32) << (FRACTION_BITS - SCORE_FRACTION_BITS))
        }
    }

    /// To a token's score, Q7.8, rounded: [−127.996, 0]. What lies below is raised to −127.996, except "never".
    #[inline]
    pub const fn to_score(self) -> i16 {
        if self.is_never() {
            return NEVER_I16;
        }
        let shift = FRACTION_BITS - SCORE_FRACTION_BITS;
        let rounded = (self.0 + (1 << (shift - 1))) >> shift;
        if rounded > 0 {
            0
        } else if rounded <= NEVER_I16 as i32 {
            NEVER_I16 + 1
        } else {
            rounded as i16
        }
    }

    /// Whether this stands for log2 0.
    #[inline]
    pub const fn is_never(self) -> bool {
        self.0 <= Self::FLOOR.0
    }

    /// Product of two probabilities.
    #[inline]
    pub const fn times(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }

    /// Quotient of two probabilities; "never" stays "never", and so does anything divided by it.
    #[inline]
    pub const fn over(self, other: Self) -> Self {
        if self.is_never() || other.is_never() {
            Self::NEVER
        } else {
            Self(self.0.saturating_sub(other.0))
        }
    }

    /// Sum of two probabilities. Error ≤ 3 LSB (`sum_is_close`).
    #[inline]
    pub fn plus(self, other: Self) -> Self {
        let (high, low) = if self.0 >= other.0 {
            (self.0, other.0)
        } else {
            (other.0, self.0)
        };
        let distance = high.saturating_sub(low) as u32;
        if distance >= SUM_RANGE << FRACTION_BITS {
            return Self(high);
        }
        let index = (distance >> SUM_STEP_BITS) as usize;
        let fraction = (distance & ((1 << SUM_STEP_BITS) - 1)) as i32;
        // The mask only tells the compiler what the test above has shown: index < 104.
        let left = i32::from(SUM_TABLE[index & 127]);
        let right = i32::from(SUM_TABLE[(index + 1) & 127]);
        // (left − right) ≤ 2⁸, fraction < 2⁹.
        Self(high.saturating_add(left - (((left - right) * fraction) >> SUM_STEP_BITS)))
    }

    /// 2^self for self ≤ 0, Q0.16 (65536 = 1); larger values give 1. Error ≤ 5 LSB (`exp2_is_close`).
    #[inline]
    pub fn exp2(self) -> u32 {
        if self.0 >= 0 {
            return 1 << LINEAR_FRACTION_BITS;
        }
        let down = self.0.unsigned_abs();
        let whole = down >> FRACTION_BITS;
        if whole > LINEAR_FRACTION_BITS {
            return 0;
        }
        let part = down & ((1 << FRACTION_BITS) - 1);
        let index = (part >> EXP_STEP_BITS) as usize;
        let fraction = part & ((1 << EXP_STEP_BITS) - 1);
        let left = EXP_TABLE[index & 63];
        let right = EXP_TABLE[(index + 1) & 63];
        // (left − right) < 2¹¹, fraction < 2⁷.
        (left - (((left - right) * fraction) >> EXP_STEP_BITS)) >> whole
    }
}

/// From this many bits of distance on the smaller term of a sum is lost: log2(1 + 2⁻¹³) < 2⁻¹².
const SUM_RANGE: u32 = 13;
/// One step of [`SUM_TABLE`] is 2⁹ LSBs, 1/8 bit.
const SUM_STEP_BITS: u32 = 9;
/// One step of [`EXP_TABLE`] is 2⁷ LSBs, 1/32 bit.
const EXP_STEP_BITS: u32 = 7;

/// log2(1 + 2^(−i/8)), Q12; entries from 105 on are never read.
static SUM_TABLE: [u16; 128] = sum_table();
/// 2^(−i/32), Q16; entries from 33 on are never read.
static EXP_TABLE: [u32; 64] = exp_table();

/// 2^(−1/2^k) in Q62: k square roots of 1/2.
const fn root_of_half(k: u32) -> u128 {
    let mut root: u128 = 1 << 61;
    let mut i = 0;
    while i < k {
        root = (root << 62).isqrt();
        i += 1;
    }
    root
}

const fn exp_table() -> [u32; 64] {
    let step = root_of_half(5);
    let mut table = [0; 64];
    let mut value: u128 = 1 << 62;
    let mut i = 0;
    while i <= 32 {
        table[i] = ((value + (1 << 45)) >> 46) as u32;
        value = (value * step) >> 62;
        i += 1;
    }
    table
}

const fn sum_table() -> [u16; 128] {
    let step = root_of_half(3);
    let mut table = [0; 128];
    let mut power: u128 = 1 << 62;
    let mut i = 0;
    while i <= 105 {
        // 24 binary digits of log2 y, 1 < y ≤ 2, by squaring.
        let mut y = (1u128 << 62) + power;
        let mut digits: u32 = 0;
        let mut n = 0;
        if y == 1 << 63 {
            digits = 1 << 24;
        } else {
            while n < 24 {
                y = (y * y) >> 62;
                digits <<= 1;
                if y >= 1 << 63 {
                    y >>= 1;
                    digits |= 1;
                }
                n += 1;
            }
        }
        table[i] = ((digits + (1 << 11)) >> 12) as u16;
        power = (power * step) >> 62;
        i += 1;
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    extern crate std;

    fn real(p: LogProb) -> f64 {
        f64::from(p.q12()) / 4096.0
    }

    #[test]
    fn sum_is_close() {
        let mut worst = 0f64;
        for distance in 0..(15 << FRACTION_BITS) {
            let got = real(LogProb::ONE.plus(LogProb::from_q12(-distance)));
            let want = (1.0 + (-f64::from(distance) / 4096.0).exp2()).log2();
            worst = worst.max((got - want).abs());
        }
        assert!(worst <= 3.0 / 4096.0, "{worst}");
    }

    #[test]
    fn sum_does_not_depend_on_the_order() {
        for a in (-200_000..200_000).step_by(1777) {
            for b in (-200_000..200_000).step_by(1999) {
                let (a, b) = (LogProb::from_q12(a), LogProb::from_q12(b));
                assert_eq!(a.plus(b), b.plus(a));
                assert!(a.plus(b) >= a.max(b));
            }
        }
    }

    #[test]
    fn exp2_is_close() {
        let mut worst = 0f64;
        for down in 0..(18 << FRACTION_BITS) {
            let got = f64::from(LogProb::from_q12(-down).exp2());
            let want = 65536.0 * (-f64::from(down) / 4096.0).exp2();
            worst = worst.max((got - want).abs());
        }
        assert!(worst <= 5.0, "{worst}");
        assert_eq!(LogProb::from_q12(5).exp2(), 65536);
        assert_eq!(LogProb::NEVER.exp2(), 0);
    }

    #[test]
    fn never_stays_never() {
        let never = LogProb::NEVER;
        assert!(never.times(never).times(never).times(never).is_never());
        assert!(never.plus(never).is_never());
        assert_eq!(never.plus(LogProb::ONE), LogProb::ONE);
        assert!(never.over(LogProb::from_q12(-9)).is_never());
        assert_eq!(LogProb::from_score(never.to_score()), never);
        assert_eq!(LogProb::from_table(NEVER_I16), never);
    }

    #[test]
    fn scores_are_rounded_and_held_in_range() {
        assert_eq!(LogProb::from_q12(-8).to_score(), 0);
        assert_eq!(LogProb::from_q12(-9).to_score(), -1);
        assert_eq!(LogProb::from_q12(77).to_score(), 0);
        assert_eq!(LogProb::from_q12(-(200 << 12)).to_score(), -32767);
    }
}
