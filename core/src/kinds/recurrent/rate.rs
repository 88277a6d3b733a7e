//! Rates Λ in (0, 1) from 8-bit codes: the logistic function of (code − 128) / 16.

/// 1 / (1 + e^−x), Q0.16, for x = (code − 128) / 16.
#[inline]
pub fn rate(code: u8) -> u32 {
    u32::from(RATE[usize::from(code)])
}

/// 22 for x = −8 … 65514 for x = 7.94.
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
}
