//! Every narrowing, rounding and saturating operation of the core.
//!
//! Q formats are written `Qi.f`: i integer bits besides the sign, f fraction bits; `Qf` alone says only the
//! fraction. Products and shifts compile to one instruction each where the target has one (SMMUL, SMMULR, SSAT).

/// ⌊a·b / 2³²⌋: the high word of the product. Of Qf and Q31 it is Q(f − 1).
#[inline(always)]
pub fn mul_high(a: i32, b: i32) -> i32 {
    ((i64::from(a) * i64::from(b)) >> 32) as i32
}

/// ⌊c − a·b / 2³²⌋: one SMMLS.
#[inline(always)]
pub fn mul_high_subtract(c: i32, a: i32, b: i32) -> i32 {
    (((i64::from(c) << 32) - i64::from(a) * i64::from(b)) >> 32) as i32
}

/// a·b / 2³², rounded to nearest, halves up.
#[inline(always)]
pub fn mul_high_rounded(a: i32, b: i32) -> i32 {
    ((i64::from(a) * i64::from(b) + (1 << 31)) >> 32) as i32
}

/// ⌊a·b / 2³²⌋ of unsigned numbers.
#[inline(always)]
pub fn mul_high_u32(a: u32, b: u32) -> u32 {
    ((u64::from(a) * u64::from(b)) >> 32) as u32
}

/// Two halfwords as a word, for [`mul_halves`].
#[inline(always)]
pub fn halves(low: i16, high: i16) -> u32 {
    u32::from(low as u16) | u32::from(high as u16) << 16
}

/// sum + low·low + high·high of signed halfwords, modulo 2³²: one SMLAD where the target has it (`build.rs`).
#[inline(always)]
pub fn mul_halves(sum: i32, a: u32, b: u32) -> i32 {
    #[cfg(smlad)]
    return smlad(sum, a, b);
    #[cfg(not(smlad))]
    return mul_halves_plain(sum, a, b);
}

/// [`mul_halves`] for every target: what the instruction has to agree with.
#[inline(always)]
pub fn mul_halves_plain(sum: i32, a: u32, b: u32) -> i32 {
    let low = i32::from(a as i16).wrapping_mul(i32::from(b as i16));
    let high = ((a as i32) >> 16).wrapping_mul((b as i32) >> 16);
    sum.wrapping_add(low).wrapping_add(high)
}

/// The compiler has no pattern for it, and the intrinsic is not stable.
#[cfg(smlad)]
#[inline(always)]
#[allow(unsafe_code)]
fn smlad(mut sum: i32, a: u32, b: u32) -> i32 {
    // SAFETY: reads and writes these registers and the Q flag. Not `pure`: the order in which the kernels write their products
    // keeps them in registers.
    unsafe {
        core::arch::asm!("smlad {0}, {1}, {2}, {0}", inout(reg) sum, in(reg) a, in(reg) b, options(nomem, nostack));
    }
    sum
}

/// x / 2^shift, rounded to nearest, halves up; |x| must leave room for half a step.
#[inline(always)]
pub fn round_shift(x: i32, shift: u32) -> i32 {
    (x + ((1 << shift) >> 1)) >> shift
}

/// [`round_shift`] of 64 bits.
#[inline(always)]
pub fn round_shift_i64(x: i64, shift: u32) -> i64 {
    (x + ((1 << shift) >> 1)) >> shift
}

/// The nearest `i16`.
#[inline(always)]
pub fn saturate_i16(x: i32) -> i16 {
    x.clamp(i32::from(i16::MIN), i32::from(i16::MAX)) as i16
}

/// The nearest `i32`.
#[inline(always)]
pub fn saturate_i32(x: i64) -> i32 {
    x.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_goes_to_the_nearest() {
        for x in -4096..4096 {
            let exact = f64::from(x) / 16.0;
            assert_eq!(f64::from(round_shift(x, 4)), (exact + 0.5).floor());
            assert_eq!(round_shift(x, 0), x);
            assert_eq!(round_shift_i64(i64::from(x), 4), i64::from(round_shift(x, 4)));
        }
    }

    #[test]
    fn products_keep_the_high_word_at_the_extremes() {
        for a in [i32::MIN, -1, 0, 1, i32::MAX] {
            for b in [i32::MIN, -1, 0, 1, i32::MAX] {
                let exact = i128::from(a) * i128::from(b);
                assert_eq!(i128::from(mul_high(a, b)), exact >> 32);
                let less = ((i128::from(7) << 32) - exact) >> 32;
                assert_eq!(i128::from(mul_high_subtract(7, a, b)), less);
                assert_eq!(i128::from(mul_high_rounded(a, b)), (exact + (1 << 31)) >> 32);
            }
        }
        assert_eq!(mul_high_u32(u32::MAX, u32::MAX), u32::MAX - 1);
    }

    #[test]
    fn narrowing_saturates() {
        assert_eq!(saturate_i16(40_000), i16::MAX);
        assert_eq!(saturate_i16(-40_000), i16::MIN);
        assert_eq!(saturate_i16(-5), -5);
        assert_eq!(saturate_i32(1 << 40), i32::MAX);
        assert_eq!(saturate_i32(-(1 << 40)), i32::MIN);
        assert_eq!(saturate_i32(-7), -7);
    }
}
