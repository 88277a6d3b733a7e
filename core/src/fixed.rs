//! Every narrowing, rounding and saturating operation of the core.
//!
//! Q formats are written `Qi.f`: i integer bits besides the sign, f fraction bits; `Qf` alone says only the
//! fraction. Products and shifts compile to one instruction each where the target has one (SMMUL, SMMULR, SSAT).

/// ⌊a·b / 2³²⌋: the high word of the product. Of Qf and Q31 it is Q(f − 1).
#[inline(always)]
pub fn mul_high(a: i32, b: i32) -> i32 {
    if cfg!(short_products) {
        return mul_high_short(a, b);
    }
    ((i64::from(a) * i64::from(b)) >> 32) as i32
}

/// [`mul_high`] of four products of halves, for processors that multiply 32 by 32 bits to 32: a quarter of what the compiler's routine for
/// 64 bits takes there.
#[inline(always)]
pub fn mul_high_short(a: i32, b: i32) -> i32 {
    let (a_low, a_high) = (a & 0xffff, a >> 16);
    let (b_low, b_high) = (b & 0xffff, b >> 16);
    let low = (a_low as u32).wrapping_mul(b_low as u32);
    // In size at most 2¹⁵·(2¹⁶ − 1), and 2¹⁶ − 1 more: below 2³¹.
    let middle = a_high * b_low + (low >> 16) as i32;
    let other = a_low * b_high + (middle & 0xffff);
    // The sum of three is the high word itself.
    a_high * b_high + (middle >> 16) + (other >> 16)
}

/// ⌊c − a·b / 2³²⌋: one SMMLS.
#[inline(always)]
pub fn mul_high_subtract(c: i32, a: i32, b: i32) -> i32 {
    if cfg!(short_products) {
        let low = a.wrapping_mul(b);
        return c - mul_high_short(a, b) - i32::from(low != 0);
    }
    (((i64::from(c) << 32) - i64::from(a) * i64::from(b)) >> 32) as i32
}

/// a·b / 2³², rounded to nearest, halves up.
#[inline(always)]
pub fn mul_high_rounded(a: i32, b: i32) -> i32 {
    if cfg!(short_products) {
        let low = a.wrapping_mul(b) as u32;
        return mul_high_short(a, b) + (low >> 31) as i32;
    }
    ((i64::from(a) * i64::from(b) + (1 << 31)) >> 32) as i32
}

/// ⌊a·b / 2³²⌋ of unsigned numbers.
#[inline(always)]
pub fn mul_high_u32(a: u32, b: u32) -> u32 {
    ((u64::from(a) * u64::from(b)) >> 32) as u32
}

/// a·b, all of it.
#[inline(always)]
pub fn mul_long(a: i32, b: i32) -> i64 {
    if cfg!(short_products) {
        let low = a.wrapping_mul(b) as u32;
        return i64::from(mul_high_short(a, b)) << 32 | i64::from(low);
    }
    i64::from(a) * i64::from(b)
}

/// a·b, all 48 bits of it.
#[inline(always)]
pub fn mul_long_half(a: u32, b: u16) -> u64 {
    if cfg!(short_products) {
        let low = (a & 0xffff) * u32::from(b);
        let high = (a >> 16) * u32::from(b);
        return (u64::from(high) << 16) + u64::from(low);
    }
    u64::from(a) * u64::from(b)
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
        // The assembler has to be told of a processor that has it, where the target's least does not.
        #[cfg(smlad_of_m33)]
        core::arch::asm!(".cpu cortex-m33", "smlad {0}, {1}, {2}, {0}", inout(reg) sum, in(reg) a, in(reg) b, options(nomem, nostack));
        #[cfg(not(smlad_of_m33))]
        core::arch::asm!("smlad {0}, {1}, {2}, {0}", inout(reg) sum, in(reg) a, in(reg) b, options(nomem, nostack));
    }
    sum
}

/// The words that these bytes are, where they lie as words do and are a whole number of them. For processors that cannot load a word from any
/// address, and would put it together byte by byte.
#[inline(always)]
#[allow(unsafe_code)]
pub fn aligned_words(bytes: &[u8]) -> Option<&[u32]> {
    // SAFETY: every four bytes are a word.
    match unsafe { bytes.align_to() } {
        ([], words, []) if cfg!(target_endian = "little") => Some(words),
        _ => None,
    }
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
                assert_eq!(i128::from(mul_high_short(a, b)), exact >> 32);
                assert_eq!(i128::from(mul_long(a, b)), exact);
                let less = ((i128::from(7) << 32) - exact) >> 32;
                assert_eq!(i128::from(mul_high_subtract(7, a, b)), less);
                assert_eq!(i128::from(mul_high_rounded(a, b)), (exact + (1 << 31)) >> 32);
            }
        }
        assert_eq!(mul_high_u32(u32::MAX, u32::MAX), u32::MAX - 1);
    }

    #[test]
    fn words_are_those_of_the_bytes() {
        let words = [0x0403_0201, 0x8877_6655_u32];
        let mut bytes = [0; 12];
        // One of four places in a row is a word's.
        let mut aligned = 0;
        for place in 0..4 {
            for (to, from) in bytes[place..]
                .iter_mut()
                .zip(words.iter().flat_map(|word| word.to_le_bytes()))
            {
                *to = from;
            }
            if let Some(found) = aligned_words(&bytes[place..][..8]) {
                assert_eq!(found, words);
                aligned += 1;
                assert_eq!(aligned_words(&bytes[place..][..7]), None);
            }
        }
        assert_eq!(aligned, 1);
    }

    #[test]
    fn halfwords_by_words() {
        for a in [0, 1, 0xffff, 0x10000, u32::MAX] {
            for b in [0, 1, u16::MAX] {
                assert_eq!(mul_long_half(a, b), u64::from(a) * u64::from(b));
            }
        }
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
