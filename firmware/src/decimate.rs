//! From a converter that runs at eight times the rate of sound to sound: 128 kHz of 12 bits become 16 kHz of 16 bits.
//!
//! ```text
//! v[n] = u[2n] + 4u[2n−1] + 6u[2n−2] + 4u[2n−3] + u[2n−4]     u: the converter's count − 2048; to 64 kHz, and to 16 bits by its gain of 16
//! y[n] = Σ h[k]·v[4n−k], k = 0..64                            to 16 kHz
//! ```
//!
//! The first is what a cascaded integrator-comb of order four leaves for a factor of two, with the zeros of its response at 64 kHz; the second a low
//! pass of linear phase. Together, by the tests below: 0.5 dB down at 6.5 kHz, 1.1 dB at 7 kHz, and whatever lies from 9.5 kHz up to the
//! converter's 64 kHz comes through 51 dB down or more. What lies between 8 and 9.5 kHz folds onto 6.5 to 8 kHz, as it fades. The count of silence
//! goes through with a gain of 1; the front end takes it off.

/// The converter's samples for one of sound.
pub const FACTOR: usize = 8;
/// Where the converter's range has its middle.
const MIDDLE: i32 = 1 << 11;
/// Set beside a count that the converter itself does not trust.
const ERROR: u16 = 1 << 15;
/// The low pass's length at 64 kHz: a millisecond.
const TAPS: usize = 64;

/// The first half of h, Q15; the other is the same backwards. A Kaiser window (side lobes of −50 dB: β = 4.53) over sin(x)/x with its edge at
/// 8 kHz, scaled to a sum of 1; `the_taps_are_the_formulas` makes them.
#[rustfmt::skip]
const HALF: [i32; TAPS / 2] = [
    -7, -24, -32, -17, 21, 64, 78, 39, -47, -134, -157, -76, 88, 247, 284, 135,
    -155, -427, -487, -231, 264, 732, 844, 406, -475, -1362, -1650, -852, 1114, 3810, 6402, 7989,
];

/// Sums stay within 31 bits: two of v, below 2¹⁶ together, times what the taps' magnitudes add up to.
const _: () = {
    let (mut sum, mut k) = (0, 0);
    while k < HALF.len() {
        sum += HALF[k].unsigned_abs();
        k += 1;
    }
    assert!(sum < 1 << 15);
};

/// v in a sample of sound.
const STEP: usize = 4;
const STEPS: usize = TAPS / STEP;

/// The filters and what they remember.
#[derive(Clone, Debug)]
pub struct Decimator {
    /// The last three u, oldest first.
    before: [i32; 3],
    /// The last v, twice: from `place` on stand all of them in order. Words, since a Cortex-M0+ reads those with the fewest instructions.
    recent: [[i32; STEP]; 2 * STEPS],
    place: usize,
}

impl Default for Decimator {
    fn default() -> Self {
        Self::new()
    }
}

impl Decimator {
    /// As after a long time at the middle of the converter's range.
    pub const fn new() -> Self {
        Self {
            before: [0; 3],
            recent: [[0; STEP]; 2 * STEPS],
            place: 0,
        }
    }

    /// A sample for the next counts of the converter, each 0 to 4095. One with the converter's error flag (bit 15) is left out: the one before it
    /// stands in. A function of its own, for a board that runs it from RAM.
    #[inline(never)]
    pub fn push(&mut self, counts: [u16; FACTOR]) -> i16 {
        let [x, y, z] = self.before;
        let mut last = z;
        let [a, b, c, d, e, f, g, h] = counts.map(|count| {
            if count & ERROR == 0 {
                last = i32::from(count & 0xfff) - MIDDLE;
            }
            last
        });
        self.before = [f, g, h];
        // Within 16 bits: weights add up to 16, and −2048 ≤ u ≤ 2047.
        let smooth = |u: [i32; 5]| u[0] + u[4] + 4 * (u[1] + u[3]) + 6 * u[2];
        let v = [[x, y, z, a, b], [z, a, b, c, d], [b, c, d, e, f], [d, e, f, g, h]].map(smooth);
        let place = self.place % STEPS;
        self.recent[place] = v;
        self.recent[place + STEPS] = v;
        self.place = (place + 1) % STEPS;
        let recent = self.recent[self.place..][..STEPS].as_flattened();
        let (older, newer) = recent.split_at(TAPS / 2);
        let mut sum = 0;
        // Eight at a time: addresses within a load's reach, and less of a loop.
        let eights = older
            .as_chunks::<8>()
            .0
            .iter()
            .zip(newer.as_chunks::<8>().0.iter().rev());
        for ((older, newer), taps) in eights.zip(HALF.as_chunks::<8>().0) {
            for k in 0..8 {
                sum += (older[k] + newer[7 - k]) * taps[k];
            }
        }
        lipstream_core::fixed::saturate_i16(lipstream_core::fixed::round_shift(sum, 15))
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, TAU};
    use std::vec::Vec;

    use super::*;

    const RATE: f64 = 128_000.0;

    fn decimated(counts: impl Iterator<Item = u16>) -> Vec<i16> {
        let mut decimator = Decimator::new();
        let counts: Vec<u16> = counts.collect();
        let eights = counts.as_chunks().0.iter();
        eights.map(|counts| decimator.push(*counts)).collect()
    }

    /// The amplitude of what a tone of 1,800 counts leaves behind at the frequency onto which it folds, as a gain in dB.
    fn gain_db(hz: f64) -> f64 {
        let tone =
            (0..64_000).map(|n| (2048.0 + 1800.0 * (TAU * hz / RATE * f64::from(n)).sin()).round() as u16);
        let sound = &decimated(tone)[100..];
        let [mut re, mut im] = [0.0; 2];
        for (n, y) in sound.iter().enumerate() {
            let (sin, cos) = (TAU * hz / 16_000.0 * n as f64).sin_cos();
            re += f64::from(*y) * cos;
            im += f64::from(*y) * sin;
        }
        let amplitude = 2.0 * re.hypot(im) / sound.len() as f64;
        20.0 * (amplitude / (16.0 * 1800.0)).log10()
    }

    #[test]
    fn speech_passes() {
        for hz in [
            110.0, 430.0, 1010.0, 2030.0, 3010.0, 4030.0, 5010.0, 6010.0, 6490.0,
        ] {
            let gain = gain_db(hz);
            assert!((-0.5..0.05).contains(&gain), "{hz} Hz: {gain} dB");
        }
        let gain = gain_db(7010.0);
        assert!((-1.2..-1.0).contains(&gain), "{gain} dB");
    }

    /// Where the first stage is weakest (around 32 kHz) and where the second folds onto itself (56 kHz and more) too.
    #[test]
    fn what_would_fold_onto_speech_does_not_come_through() {
        let mut hz = 9510.0;
        while hz < 64_000.0 {
            let gain = gain_db(hz);
            assert!(gain < -51.0, "{hz} Hz: {gain} dB");
            hz += 370.0;
        }
    }

    /// Every count, held: 16 times its distance from the middle, to the last bit.
    #[test]
    fn a_count_that_stands_still_comes_through_as_it_is() {
        for count in [0, 1, 1551, 2047, 2048, 2049, 4095] {
            let sound = decimated(core::iter::repeat_n(count, 8 * 40));
            let want = 16 * (i32::from(count) - 2048);
            assert!(sound[20..].iter().all(|y| i32::from(*y) == want), "{count}");
        }
    }

    /// The largest sums that counts can make: no overflow, cut off at full scale.
    #[test]
    fn the_worst_sound_saturates() {
        let sign = |k: usize| HALF[k.min(TAPS - 1 - k)] > 0;
        // Two counts for each v, so that the signs of v follow the taps'.
        for up in [0, 4095] {
            let counts = (0..TAPS).flat_map(|k| [if sign(k) { up } else { 4095 - up }; 2]);
            let sound = decimated(counts.cycle().take(16 * TAPS));
            assert!(sound.contains(&i16::MAX) && sound.contains(&i16::MIN));
        }
    }

    #[test]
    fn a_count_with_an_error_is_left_out() {
        let tone = |n: u32| (2048.0 + 900.0 * (TAU * 300.0 / RATE * f64::from(n)).sin()) as u16;
        let flawed = decimated((0..8000).map(|n| if n % 100 == 99 { ERROR | 4095 } else { tone(n) }));
        let held = decimated((0..8000).map(|n| tone(if n % 100 == 99 { n - 1 } else { n })));
        assert_eq!(flawed, held);
    }

    #[test]
    fn the_taps_are_the_formulas() {
        // The modified Bessel function of order 0, by its series.
        let bessel = |x: f64| {
            let terms = (1..60).scan(1.0, |term, k| {
                *term *= (x / 2.0 / f64::from(k)).powi(2);
                Some(*term)
            });
            1.0 + terms.sum::<f64>()
        };
        let beta = 0.5842 * 29_f64.powf(0.4) + 0.07886 * 29.0;
        let tap = |k: usize| {
            let t = k as f64 - (TAPS - 1) as f64 / 2.0;
            let w = bessel(beta * (1.0 - (2.0 * t / (TAPS - 1) as f64).powi(2)).sqrt());
            w * (PI * t / 4.0).sin() / t
        };
        let half: Vec<f64> = (0..TAPS / 2).map(tap).collect();
        let sum: f64 = half.iter().sum();
        let mut taps: Vec<i32> = half.iter().map(|h| (h / sum * 16384.0).round() as i32).collect();
        // What rounding leaves goes to the largest, so that the sum is exact.
        let rest = 16384 - taps.iter().sum::<i32>();
        taps[TAPS / 2 - 1] += rest;
        assert_eq!(taps, HALF);
    }
}
