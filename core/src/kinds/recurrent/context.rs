//! What a frame knows of the sound around it: statics at sparse taps, and exponential means of them up to the look-ahead.
//!
//! m_n = m_{n−1} + (x_n − m_{n−1}) / 2^shift, m_0 = x_0. Before the first frame stands the first, after the last one the
//! last.
use super::Recurrent;
use crate::N_STATIC;
use crate::context::history::History;
use crate::context::projection::{self, MAX_CONTEXT};
use crate::context::tables::{MAX_INPUTS, MAX_MEANS};
use crate::fixed::saturate_i16;

/// Bits below a static's LSB that the means keep.
const MEAN_FRACTION_BITS: u32 = 8;

/// Exponential means of the statics.
#[derive(Clone, Debug)]
pub struct Means {
    /// Q7.16, by mean and static; ±2²³.
    value: [[i32; N_STATIC]; MAX_MEANS],
    /// Frames heard, those that stand behind the end too.
    heard: u32,
    last: [i16; N_STATIC],
}

impl Means {
    /// Nothing heard yet.
    pub const fn new() -> Self {
        Self {
            value: [[0; N_STATIC]; MAX_MEANS],
            heard: 0,
            last: [0; N_STATIC],
        }
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        self.heard = 0;
    }

    /// Frames heard, modulo 2³².
    pub fn heard(&self) -> u32 {
        self.heard
    }

    /// The next frame's statics, Q7.8.
    pub fn push(&mut self, model: &Recurrent, statics: &[i16; N_STATIC]) {
        let shifts = model.mean_shifts().iter();
        for (mean, shift) in self.value.iter_mut().zip(shifts) {
            for (m, x) in mean.iter_mut().zip(statics) {
                let x = i32::from(*x) << MEAN_FRACTION_BITS;
                *m = if self.heard == 0 {
                    x
                } else {
                    *m + ((x - *m) >> shift)
                };
            }
        }
        self.last = *statics;
        // Never back to 0, which stands for the beginning.
        self.heard = self.heard.checked_add(1).unwrap_or(1);
    }

    /// The last frame once more: what stands behind the end.
    pub fn push_last(&mut self, model: &Recurrent) {
        let last = self.last;
        self.push(model, &last);
    }

    #[inline]
    fn of(&self, mean: usize) -> [i16; N_STATIC] {
        self.value.get(mean).map_or([0; N_STATIC], |m| {
            m.map(|v| saturate_i16((v + (1 << (MEAN_FRACTION_BITS - 1))) >> MEAN_FRACTION_BITS))
        })
    }
}

impl Default for Means {
    fn default() -> Self {
        Self::new()
    }
}

/// z of frame `frame`, Q5.10, of which the model's first Z are meaningful. `means` have heard up to the look-ahead.
pub fn project(model: &Recurrent, history: &History, means: &Means, frame: u32) -> [i16; MAX_INPUTS] {
    let mut context = [0; MAX_CONTEXT];
    let taps = model
        .context()
        .taps()
        .map(|tap| history.at(i64::from(frame) + i64::from(tap)));
    let means = (0..model.mean_shifts().len()).map(|m| means.of(m));
    let places = context.as_chunks_mut::<N_STATIC>().0;
    for (to, from) in places.iter_mut().zip(taps.chain(means)) {
        *to = from;
    }
    let size = model.context().size();
    projection::project(model.context(), context.get(..size).unwrap_or(&[]))
}
