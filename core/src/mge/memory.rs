//! The memory that the states gate, and the mouth that reads it.
//!
//! w = Σγ G, r = Σγ R, λ = Σγ Λ over both chains' states; h ← h + λ∘(V_d z ∘ w + r − h);
//! ŷ = W₀ z + b₀ + Σγ B + O h.
use super::rate::rate;
use super::rows;
use crate::fixed::{round_shift, saturate_i16, saturate_i32};
use crate::hmm::gates::Gates;
use crate::model::field::{Matrix, SCALE_FRACTION_BITS, SIGNAL_FRACTION_BITS, limit};
use crate::model::{Gate, Model};
use crate::parameters::MAX_PARAMETERS;

/// Fraction bits of the memory.
const MEMORY_FRACTION_BITS: u32 = 16;
/// Fraction bits of sums over states.
const SUM_FRACTION_BITS: u32 = 20;

/// h, and the mouth of the last frame.
#[derive(Clone, Debug)]
pub struct Memory {
    /// Q15.16, of which the model's first H are meaningful.
    h: [i32; limit::MEMORY],
    /// ŷ, Q5.10.
    mouth: [i16; MAX_PARAMETERS],
}

/// Sums over the gates of a frame, Q11.20; rates Q0.16.
struct Sums {
    gain: [i32; limit::MEMORY],
    drive: [i32; limit::MEMORY],
    rate: [u32; limit::MEMORY],
    offset: [i32; MAX_PARAMETERS],
}

impl Sums {
    fn add(&mut self, gate: &Gate, weight: u32) {
        let [gain, drive, offset] = gate.scale;
        add_scaled(&mut self.gain, gate.gain, gain, weight);
        add_scaled(&mut self.drive, gate.drive, drive, weight);
        add_scaled(&mut self.offset, gate.offset, offset, weight);
        for (to, code) in self.rate.iter_mut().zip(gate.rate) {
            // 2¹⁶ · 2¹⁶ just fits: a rate is below 2¹⁶.
            *to += (weight * rate(*code)) >> 16;
        }
    }
}

/// to += weight · scale · codes. A sum beyond ±2048 is held there.
#[inline]
fn add_scaled(to: &mut [i32], codes: &[u8], scale: i32, weight: u32) {
    const SHIFT: u32 = 16 + SCALE_FRACTION_BITS - SUM_FRACTION_BITS;
    // 2¹⁷ · 2³¹, shifted down to 2²⁸.
    let unit = ((i64::from(weight) * i64::from(scale)) >> SHIFT) as i32;
    // Codes reach 2⁷: with units up to 2²⁰ twelve gates stay below 2³¹.
    let unit = unit.clamp(-(1 << 20), 1 << 20);
    for (to, code) in to.iter_mut().zip(codes) {
        *to += unit * i32::from(*code as i8);
    }
}

impl Memory {
    pub const fn new() -> Self {
        Self {
            h: [0; limit::MEMORY],
            mouth: [0; MAX_PARAMETERS],
        }
    }

    /// What stands before the first frame.
    pub fn reset(&mut self, model: &Model) {
        self.mouth = [0; MAX_PARAMETERS];
        self.h = [0; limit::MEMORY];
        for (h, first) in self.h.iter_mut().zip(model.first_memory().iter()) {
            *h = i32::from(first) << (MEMORY_FRACTION_BITS - SIGNAL_FRACTION_BITS);
        }
    }

    /// ŷ of the last frame, Q5.10.
    pub fn mouth(&self) -> &[i16; MAX_PARAMETERS] {
        &self.mouth
    }

    /// One frame: z (Q5.10) and the states that speak; gives ŷ, Q5.10.
    pub fn step(
        &mut self,
        model: &Model,
        z: &[i16],
        audio: &Gates,
        visual: &Gates,
    ) -> heapless::Vec<i16, MAX_PARAMETERS> {
        let mut sums = Sums {
            gain: [0; limit::MEMORY],
            drive: [0; limit::MEMORY],
            rate: [0; limit::MEMORY],
            offset: [0; MAX_PARAMETERS],
        };
        for (state, weight) in audio.iter() {
            sums.add(&model.audio_gate(state), weight);
        }
        for (state, weight) in visual.iter() {
            sums.add(&model.visual_gate(state), weight);
        }
        let memory = &mut self.h;
        rows::product(&model.rows(Matrix::DRIVE, z.len()), z, |i, d| {
            let (Some(h), Some(w), Some(r), Some(rate)) = (
                memory.get_mut(i),
                sums.gain.get(i),
                sums.drive.get(i),
                sums.rate.get(i),
            ) else {
                return;
            };
            // Q10 · Q20 to Q16; 2³¹ · 2³¹.
            const DOWN: u32 = SIGNAL_FRACTION_BITS + SUM_FRACTION_BITS - MEMORY_FRACTION_BITS;
            let driven = (i64::from(d) * i64::from(*w)) >> DOWN;
            let target = driven + i64::from(*r >> (SUM_FRACTION_BITS - MEMORY_FRACTION_BITS));
            let way = i64::from(saturate_i32(target - i64::from(*h)));
            *h = saturate_i32(i64::from(*h) + ((way * i64::from((*rate).min(1 << 16))) >> 16));
        });
        let mut read = [0; limit::MEMORY];
        for (to, h) in read.iter_mut().zip(&self.h) {
            // |h| < 2³¹ leaves room for half a step only just: held first.
            let h = (*h).clamp(-(1 << 30), 1 << 30);
            *to = saturate_i16(round_shift(h, MEMORY_FRACTION_BITS - SIGNAL_FRACTION_BITS));
        }
        let shape = model.shape();
        let read = read.get(..shape.memory).unwrap_or(&[]);
        let mut out = [0i32; MAX_PARAMETERS];
        rows::product(&model.rows(Matrix::OUTPUT, z.len()), z, |i, value| {
            if let Some(to) = out.get_mut(i) {
                *to = value;
            }
        });
        rows::product(&model.rows(Matrix::MEMORY, shape.memory), read, |i, value| {
            if let (Some(to), Some(offset)) = (out.get_mut(i), sums.offset.get(i)) {
                let offset = offset >> (SUM_FRACTION_BITS - SIGNAL_FRACTION_BITS);
                *to = to.saturating_add(value).saturating_add(offset);
            }
        });
        let said: heapless::Vec<i16, MAX_PARAMETERS> = out
            .iter()
            .take(shape.parameters)
            .map(|y| saturate_i16(*y))
            .collect();
        for (to, from) in self.mouth.iter_mut().zip(&said) {
            *to = *from;
        }
        said
    }
}

impl Default for Memory {
    fn default() -> Self {
        Self::new()
    }
}
