//! 512-point transform of real samples: 256 complex points by radix 4 (decimation in frequency), then the split
//! into the bins of the real signal.
//!
//! Range. With headroom s the window's energy obeys Σ x²·4^s < 2³⁹ and pre-emphasis at most doubles amplitudes
//! (1.97), so the samples that enter have √(Σ z²) < 1.97·2^19.5 = 2^20.48. A sum of m complex points, each turned by
//! any angle, is at most √m times that (Cauchy-Schwarz); over the whole window it is √(Σ w²) times that, and Σ w² is
//! 79.7 over every other sample, 159 over all. The input is Q(9 + s); each of the first three stages halves (the
//! high word of a Q31 product), the last does not:
//!
//! ```text
//! stage       sums of         before halving             after
//! 1           4 points        √4   ·2^20.48·2⁹ < 2³¹     Q(8 + s)
//! 2           16              √16  ·2^20.48·2⁸ < 2³¹     Q(7 + s)
//! 3           64              √64  ·2^20.48·2⁷ < 2³¹     Q(6 + s)
//! 4           all             √79.7·2^20.48·2⁶ < 2³⁰     Q(6 + s)
//! split       twice the even  2·√79.7·2^20.48·2⁶ < 2³¹   Q(6 + s), bins below √159·2^20.48·2⁶ < 2^30.2
//! ```
//!
//! so nothing overflows for any input. Error of a point: at most 24 LSB, 3.5 LSB rms.
use core::hint::black_box;

use crate::FRAME_SAMPLES;
use crate::fixed::{mul_high, mul_high_subtract};
use crate::frontend::magnitude::magnitude;
use crate::tables::fft::{ORDER, SPLIT, TWIDDLE_16, TWIDDLE_64, TWIDDLE_256};

/// Complex points: half the points of the real transform.
pub const FFT_HALF: usize = 256;

/// A complex number; the Q format is its user's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Complex {
    /// Real part.
    pub re: i32,
    /// Imaginary part.
    pub im: i32,
}

impl Complex {
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        Self {
            re: self.re + other.re,
            im: self.im + other.im,
        }
    }

    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        Self {
            re: self.re - other.re,
            im: self.im - other.im,
        }
    }

    #[inline(always)]
    fn half(self) -> Self {
        Self {
            re: self.re >> 1,
            im: self.im >> 1,
        }
    }

    /// Half of self·(c − j·s), c and s in Q31.
    #[inline(always)]
    fn rotate_half(self, c: i32, s: i32) -> Self {
        Self {
            re: mul_high(self.re, c) + mul_high(self.im, s),
            im: mul_high_subtract(mul_high(self.im, c), self.re, s),
        }
    }
}

/// Transforms 200 points, padded with 56 zeros (whatever stands there), in place; bin k is left at the position that
/// [`ORDER`] says.
pub fn transform(points: &mut [Complex; FFT_HALF]) {
    first_stage(points);
    // Tables of known address and content would be unrolled and turned into long multiplications.
    let (twiddle_64, twiddle_16) = (black_box(&TWIDDLE_64), black_box(&TWIDDLE_16));
    for block in points.chunks_exact_mut(64) {
        stage(block, twiddle_64);
    }
    for block in points.chunks_exact_mut(16) {
        stage(block, twiddle_16);
    }
    for block in points.as_chunks_mut::<4>().0 {
        let [a, b, c, d] = *block;
        *block = butterfly(a, b, c, d);
    }
}

/// Sums of the four-point transform, in the order 0, 1, 2, 3.
#[inline(always)]
fn butterfly(a: Complex, b: Complex, c: Complex, d: Complex) -> [Complex; 4] {
    let (ac, a_c) = (a.plus(c), a.minus(c));
    let (bd, b_d) = (b.plus(d), b.minus(d));
    let turned = Complex {
        re: b_d.im,
        im: -b_d.re,
    };
    [ac.plus(bd), a_c.plus(turned), ac.minus(bd), a_c.minus(turned)]
}

/// One stage of a block: quarter i of output k holds half of W^{ik} times the butterfly's sum k.
#[inline(always)]
fn stage(block: &mut [Complex], twiddles: &[[i32; 6]]) {
    let quarter = twiddles.len();
    let (front, back) = block.split_at_mut(2 * quarter);
    let (a, b) = front.split_at_mut(quarter);
    let (c, d) = back.split_at_mut(quarter);
    for ((((a, b), c), d), w) in a.iter_mut().zip(b).zip(c).zip(d).zip(twiddles) {
        turned_butterfly(a, b, c, d, *d, w);
    }
}

/// [`stage`] for the whole, whose last 56 points are zeros, whatever stands there.
#[inline(always)]
fn first_stage(points: &mut [Complex; FFT_HALF]) {
    const QUARTER: usize = FFT_HALF / 4;
    /// Points of the last quarter that are not zero.
    const HEARD: usize = FRAME_SAMPLES / 2 - 3 * QUARTER;
    let (front, back) = points.split_at_mut(2 * QUARTER);
    let (a, b) = front.split_at_mut(QUARTER);
    let (c, d) = back.split_at_mut(QUARTER);
    let mut all = a.iter_mut().zip(b).zip(c).zip(d).zip(black_box(&TWIDDLE_256));
    for ((((a, b), c), d), w) in all.by_ref().take(HEARD) {
        turned_butterfly(a, b, c, d, *d, w);
    }
    for ((((a, b), c), d), w) in all {
        turned_butterfly(a, b, c, d, Complex::default(), w);
    }
}

/// Halves of the four sums of a, b, c and `last`, turned, to a, b, c and d.
#[inline(always)]
fn turned_butterfly(
    a: &mut Complex,
    b: &mut Complex,
    c: &mut Complex,
    d: &mut Complex,
    last: Complex,
    w: &[i32; 6],
) {
    // In this order few numbers are alive at a time.
    let (ac, a_c) = (a.plus(*c), a.minus(*c));
    let (bd, b_d) = (b.plus(last), b.minus(last));
    *a = ac.plus(bd).half();
    *c = ac.minus(bd).rotate_half(w[2], w[3]);
    let turned = Complex {
        re: b_d.im,
        im: -b_d.re,
    };
    *b = a_c.plus(turned).rotate_half(w[0], w[1]);
    *d = a_c.minus(turned).rotate_half(w[4], w[5]);
}

/// Magnitudes of the real signal's bins 1..=255, in Q(4 + s), below 2^28.2; entry 0 is left alone.
///
/// X\[k\] = ½(Z\[k\] + Z*\[256−k\]) − ½j·W₅₁₂^k·(Z\[k\] − Z*\[256−k\]), and X\[256−k\] is the conjugate of the same with
/// the second term's sign turned.
pub fn split_magnitudes(points: &[Complex; FFT_HALF], out: &mut [u32; FFT_HALF]) {
    let (low, high) = out.split_at_mut(FFT_HALF / 2);
    let (middle, high) = high.split_at_mut(1);
    let pairs = low[1..].iter_mut().zip(high.iter_mut().rev());
    for ((low, high), (at, w)) in pairs.zip(black_box(&ORDER).iter().zip(black_box(&SPLIT))) {
        let z = points[usize::from(at[0])];
        let mirror = points[usize::from(at[1])];
        let conjugate = Complex {
            re: mirror.re,
            im: -mirror.im,
        };
        let even = z.plus(conjugate).half();
        let odd = z.minus(conjugate).rotate_half(w[0], w[1]);
        // −j·odd, already halved.
        *low = magnitude(even.re + odd.im, even.im - odd.re);
        *high = magnitude(even.re - odd.im, even.im + odd.re);
    }
    // X[128] is the conjugate of Z[128], which stands at position 2 in base-4 digits reversed.
    let centre = points[2];
    middle[0] = magnitude(centre.re, centre.im);
}
