//! The zero of the sound: what a microphone or its converter adds to every sample is taken off, with all below 20 Hz.
//!
//! ```text
//! z    = x[0]                    before the first sample
//! z    = z + (x − z)/128
//! y    = x − z
//! ```
//!
//! A high pass of first order, −3 dB at 20 Hz and −0.3 dB at 80 Hz. HTK takes no offset off (`docs/frontend.md` says why we do),
//! so this stage runs where the statics are normalised and nowhere else. It is exact but for the rounding of y: |error| ≤ 1 LSB
//! against real numbers (`the_zero_of_the_sound_is_found`, host/run/tests/frontend_normalisation.rs).
use crate::fixed::{round_shift, saturate_i16};

/// Fraction bits of the zero: Q15.14, so that its distance from a sample (below 2¹⁶) fits into 31 bits.
const EXTRA: u32 = 14;
/// log₂ of the samples in which the zero is found, to 1/e: 8 ms.
const SHIFT: u32 = 7;

/// Where the zero of a stream is thought to be.
#[derive(Clone, Copy, Debug, Default)]
pub struct Offset {
    /// Q15.14; none before the first sample.
    zero: Option<i32>,
}

impl Offset {
    /// Writes samples less their zero to `out`, saturating; both are of one length.
    pub fn take_off(&mut self, samples: &[i16], out: &mut [i16]) {
        let Some(first) = samples.first() else { return };
        let mut zero = self.zero.unwrap_or(i32::from(*first) << EXTRA);
        let mut one = |x: i16| {
            let far = (i32::from(x) << EXTRA) - zero; // |x| ≤ 2²⁹, as is |zero|
            let step = far >> SHIFT;
            zero += step;
            saturate_i16(round_shift(far - step, EXTRA))
        };
        // Four at a time: half of the instructions of a loop over single samples are the loop's.
        let (fours, rest) = samples.as_chunks::<4>();
        let (out_fours, out_rest) = out.as_chunks_mut::<4>();
        for (out, x) in out_fours.iter_mut().zip(fours) {
            *out = x.map(&mut one);
        }
        for (out, x) in out_rest.iter_mut().zip(rest) {
            *out = one(*x);
        }
        self.zero = Some(zero);
    }
}
