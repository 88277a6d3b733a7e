//! The logistic function: rates Λ in (0, 1) from 8-bit codes, of (code − 128) / 16, and between the codes for the gates of the
//! second memory ([`super::gated`]).

/// 1 / (1 + e^−x), Q0.16, for x = (code − 128) / 16.
#[inline]
pub fn rate(code: u8) -> u32 {
    u32::from(RATE[usize::from(code)])
}

/// Fraction bits of what [`logistic`] is taken of.
pub const LOGISTIC_FRACTION_BITS: u32 = 12;
/// Fraction bits of a sixteenth.
const BETWEEN_BITS: u32 = LOGISTIC_FRACTION_BITS - 4;
/// 8 in the LSB of what [`logistic`] is taken of: beyond it the function stays as it is.
const FAR: i32 = 8 << LOGISTIC_FRACTION_BITS;

/// 1 / (1 + e^−x), Q0.16, for x in LSBs of 2⁻¹²: straight between sixteenths, off by less than 7·10⁻⁵ within ±8; what lies beyond
/// counts as ±8 (off by 3.4·10⁻⁴).
#[inline]
pub fn logistic(x: i32) -> u32 {
    let x = (x.clamp(-FAR, FAR - 1) + FAR) as u32;
    let code = (x >> BETWEEN_BITS) as usize & 0xff;
    let low = i32::from(RATE[code]);
    let high = RATE.get(code + 1).map_or(i32::from(LAST), |r| i32::from(*r));
    let share = (x & ((1 << BETWEEN_BITS) - 1)) as i32;
    (low + (((high - low) * share) >> BETWEEN_BITS)) as u32
}

/// The function of 8, Q0.16.
const LAST: u16 = (65536 - RATE_AT_MINUS_8) as u16;
const RATE_AT_MINUS_8: u32 = table()[0] as u32;

/// 22 for x = −8 … 65513 for x = 7.94.
static RATE: [u16; 256] = table();

const fn table() -> [u16; 256] {
    // e^(1/16) by its series in Q62: 12 terms are more than 62 bits.
    let mut e: u128 = 0;
    let mut term: u128 = 1 << 62;
    let mut n: u128 = 1;
    while n <= 13 {
        e += term;
        term /= 16 * n;
        n += 1;
    }
    let shrink = (1u128 << 124) / e;
    let mut table = [0; 256];
    let mut power: u128 = 1 << 62;
    let mut k = 0;
    while k <= 128 {
        // power = e^(−k/16).
        let value = ((1u128 << 78) + ((1 << 62) + power) / 2) / ((1 << 62) + power);
        if k < 128 {
            table[128 + k] = value as u16;
        }
        table[128 - k] = (65536 - value) as u16;
        power = (power * shrink) >> 62;
        k += 1;
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    extern crate std;

    #[test]
    fn the_table_is_the_logistic_function() {
        for code in 0..=255u8 {
            let x = (f64::from(code) - 128.0) / 16.0;
            let want = 65536.0 / (1.0 + (-x).exp());
            assert!((f64::from(rate(code)) - want).abs() <= 0.51, "{code}");
        }
    }

    #[test]
    fn between_the_codes_it_is_nearly_straight() {
        for x in (-40_000..40_000).step_by(7) {
            let at = (f64::from(x) / 4096.0).clamp(-8.0, 8.0);
            let want = 1.0 / (1.0 + (-at).exp());
            let have = f64::from(logistic(x)) / 65536.0;
            assert!((have - want).abs() < 7e-5, "{at}: {have}, {want}");
        }
        assert_eq!(logistic(i32::MIN), rate(0));
        assert!(logistic(i32::MAX) < 1 << 16);
    }
}
