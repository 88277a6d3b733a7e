//! Causal normalisation: a recursive mean of the 13 statics over speech, taken off frame by frame.
//!
//! ```text
//! e = max(E, 10)
//! top    = e if e > top,       else top    + (e − top)/128
//! bottom = e if e < bottom,    else bottom + (e − bottom)/64
//! stir   = stir + (min(|e − e of the frame before|, 1) − stir)/16
//! speech = top − bottom ≥ 2  and  2e > top + bottom  and  stir ≥ 1/8
//! mean   = mean + (s − mean)/256                  if speech
//! output = s − mean
//! ```
//!
//! `docs/frontend.md` says why. Levels are Q16, the mean Q7.20, shifts round down: |error| of the mean against exact
//! arithmetic with the same gate < 0.001.
use crate::N_STATIC;
use crate::fixed::{round_shift, saturate_i16};

/// Energies below 10 nats (about 7 LSB rms) count as 10, Q16.
const QUIET: i32 = 10 << 16;
/// Least range in which there can be speech, 2 nats (8.7 dB), Q16.
const LEAST_RANGE: i32 = 2 << 16;
/// log₂ of the frames in which `top` falls to the present level, to 1/e.
const TOP_SHIFT: u32 = 7;
/// log₂ of the frames in which `bottom` rises to the present level, to 1/e.
const BOTTOM_SHIFT: u32 = 6;
/// log₂ of the frames over which the energy's changes are averaged.
const STIR_SHIFT: u32 = 4;
/// Largest change that counts in full, 1 nat, Q16.
const MOST_STIR: i32 = 1 << 16;
/// Least average change in speech, 1/8 nat a frame, Q16.
const LEAST_STIR: i32 = 1 << 13;
/// log₂ of the frames of speech over which the mean is taken.
const MEAN_SHIFT: u32 = 8;
/// From Q7.8 to the mean's Q7.20.
const MEAN_EXTRA: u32 = 12;

/// Decides frame by frame which frames are speech.
#[derive(Clone, Debug, Default)]
struct Gate {
    /// None before the first frame.
    levels: Option<Levels>,
}

/// What the gate remembers, Q16.
#[derive(Clone, Copy, Debug)]
struct Levels {
    top: i32,
    bottom: i32,
    before: i32,
    stir: i32,
}

impl Gate {
    /// Takes the next frame's E (Q7.8); true when the frame is speech.
    fn next(&mut self, energy: i16) -> bool {
        let e = (i32::from(energy) << 8).max(QUIET); // ≤ 2²³
        let last = self.levels.unwrap_or(Levels {
            top: e,
            bottom: e,
            before: e,
            stir: 0,
        });
        let top = e.max(last.top + ((e - last.top) >> TOP_SHIFT));
        let bottom = e.min(last.bottom + ((e - last.bottom) >> BOTTOM_SHIFT));
        let change = (e - last.before).abs().min(MOST_STIR);
        let stir = last.stir + ((change - last.stir) >> STIR_SHIFT);
        self.levels = Some(Levels {
            top,
            bottom,
            before: e,
            stir,
        });
        top - bottom >= LEAST_RANGE && 2 * e > top + bottom && stir >= LEAST_STIR
    }
}

/// The mean in force and the gate that lets speech into it.
#[derive(Clone, Debug)]
pub struct Normaliser {
    gate: Gate,
    /// Q7.20.
    mean: [i32; N_STATIC],
}

impl Normaliser {
    /// Starts from a mean in Q7.8.
    pub fn new(start_mean: &[i16; N_STATIC]) -> Self {
        Self {
            gate: Gate::default(),
            mean: start_mean.map(|m| i32::from(m) << MEAN_EXTRA),
        }
    }

    /// Raw statics less the mean in force, Q7.8, saturating. This frame is the last that the mean knows.
    pub fn next(&mut self, raw: &[i16; N_STATIC]) -> [i16; N_STATIC] {
        if self.gate.next(raw[N_STATIC - 1]) {
            for (m, &s) in self.mean.iter_mut().zip(raw) {
                *m += ((i32::from(s) << MEAN_EXTRA) - *m) >> MEAN_SHIFT; // |difference| ≤ 2²⁸
            }
        }
        core::array::from_fn(|i| {
            let difference = (i32::from(raw[i]) << MEAN_EXTRA) - self.mean[i];
            saturate_i16(round_shift(difference, MEAN_EXTRA))
        })
    }
}
