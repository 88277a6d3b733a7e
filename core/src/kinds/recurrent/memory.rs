//! The memory that the states gate, and the mouth that reads it.
//!
//! w = Σγ G, r = Σγ R, λ = Σγ Λ over both chains' states; h ← h + λ∘(V_d z ∘ w + r − h);
//! ŷ = W₀ z + b₀ + Σγ B + O h.
use super::Recurrent;
use super::rate::rate;
use super::rows::{self, Inputs};
use super::tables::{Gate, MAX_MEMORY, SCALE_FRACTION_BITS, SIGNAL_FRACTION_BITS};
use crate::fixed::{mul_high_rounded, mul_long, round_shift, saturate_i16};
use crate::frame::MAX_PARAMETERS;
use crate::hmm::gates::{Gates, N_GATES};

/// Fraction bits of the memory.
const MEMORY_FRACTION_BITS: u32 = 16;
/// Fraction bits of sums over states.
const SUM_FRACTION_BITS: u32 = 20;

/// h, and the mouth of the last frame.
#[derive(Clone, Debug)]
pub struct Memory {
    /// Q15.16, of which the model's first H are meaningful.
    h: [i32; MAX_MEMORY],
    /// ŷ, Q5.10.
    mouth: [i16; MAX_PARAMETERS],
}

/// Sums over the gates of a frame, Q11.20; rates Q0.32, the bits of a u32.
struct Sums {
    gain: [i32; MAX_MEMORY],
    drive: [i32; MAX_MEMORY],
    rate: [i32; MAX_MEMORY],
    offset: [i32; MAX_PARAMETERS],
}

impl Sums {
    const fn new() -> Self {
        Self {
            gain: [0; MAX_MEMORY],
            drive: [0; MAX_MEMORY],
            rate: [0; MAX_MEMORY],
            offset: [0; MAX_PARAMETERS],
        }
    }

    /// The states of one chain that speak: all own the same tables. Up to three of them share a walk.
    fn add<'g>(&mut self, gates: impl Iterator<Item = (Gate<'g>, u32)>) {
        let gates: heapless::Vec<_, N_GATES> = gates.collect();
        let (threes, rest) = gates.as_chunks();
        for [a, b, c] in threes {
            self.add_some([a, b, c]);
        }
        match rest {
            [a] => self.add_some([a]),
            [a, b] => self.add_some([a, b]),
            _ => {}
        }
    }

    fn add_some<const N: usize>(&mut self, gates: [&(Gate, u32); N]) {
        let signed = |code: u8| i32::from(code as i8);
        let unit = |of: usize| gates.map(|(gate, weight)| unit(gate.scale[of], *weight));
        add(&mut self.gain, gates.map(|g| g.0.gain), unit(0), signed);
        add(&mut self.drive, gates.map(|g| g.0.drive), unit(1), signed);
        add(&mut self.offset, gates.map(|g| g.0.offset), unit(2), signed);
        // The weights of the chain that owns the rates add up to 2¹⁶ at most, a rate is below 2¹⁶: below 2³².
        let weights = gates.map(|g| g.1 as i32);
        add(&mut self.rate, gates.map(|g| g.0.rate), weights, |code| {
            rate(code) as i32
        });
    }
}

/// weight · scale, what a code is worth: within ±2²⁰, so that twelve gates of codes up to 2⁷ stay below 2³¹.
#[inline]
fn unit(scale: i32, weight: u32) -> i32 {
    const SHIFT: u32 = 16 + SCALE_FRACTION_BITS - SUM_FRACTION_BITS;
    // 2¹⁷ · 2³¹, shifted down to 2²⁸.
    let unit = (mul_long(weight as i32, scale) >> SHIFT) as i32;
    unit.clamp(-(1 << 20), 1 << 20)
}

/// Numbers that are unrolled.
const STEP: usize = 24;

/// Adds Σ unit·worth(code) to every number, by its codes, modulo 2³².
#[inline(always)]
fn add<const N: usize>(to: &mut [i32], codes: [&[u8]; N], units: [i32; N], worth: impl Fn(u8) -> i32) {
    let steps = codes.map(|c| c.as_chunks::<STEP>());
    let n = steps.iter().fold(to.len() / STEP, |n, c| n.min(c.0.len()));
    let (to, to_rest) = to.split_at_mut_checked(STEP * n).unwrap_or((&mut [], &mut []));
    for (i, to) in to.as_chunks_mut::<STEP>().0.iter_mut().enumerate() {
        add_step(
            to,
            steps.map(|s| s.0.get(i).unwrap_or(&[0; STEP])),
            &units,
            &worth,
        );
    }
    for (unit, (_, codes)) in units.iter().zip(steps) {
        for (to, code) in to_rest.iter_mut().zip(codes) {
            *to = to.wrapping_add(unit.wrapping_mul(worth(*code)));
        }
    }
}

/// Out of line, so that its registers are its own and all its addresses constant offsets.
#[inline(never)]
fn add_step<const N: usize>(
    to: &mut [i32; STEP],
    codes: [&[u8; STEP]; N],
    units: &[i32; N],
    worth: &impl Fn(u8) -> i32,
) {
    for i in 0..STEP {
        for k in 0..N {
            to[i] = to[i].wrapping_add(units[k].wrapping_mul(worth(codes[k][i])));
        }
    }
}

impl Memory {
    /// All zeros; [`Memory::reset`] puts it where a stream begins.
    #[inline(always)]
    pub const fn new() -> Self {
        Self {
            h: [0; MAX_MEMORY],
            mouth: [0; MAX_PARAMETERS],
        }
    }

    /// What stands before the first frame.
    pub fn reset(&mut self, model: &Recurrent) {
        self.mouth = [0; MAX_PARAMETERS];
        self.h = [0; MAX_MEMORY];
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
        model: &Recurrent,
        z: &[i16],
        audio: &Gates,
        visual: &Gates,
    ) -> heapless::Vec<i16, MAX_PARAMETERS> {
        let mut sums = Sums::new();
        let heard = |(state, weight)| (model.audio_gate(state), weight);
        sums.add(audio.iter().map(heard));
        let seen = |(state, weight)| (model.visual_gate(state), weight);
        sums.add(visual.iter().map(seen));
        let memory = &mut self.h;
        let heard = Inputs::new(z);
        rows::product(model.drive(), &heard, |i, d| {
            let (Some(h), Some(w), Some(r), Some(rate)) = (
                memory.get_mut(i),
                sums.gain.get(i),
                sums.drive.get(i),
                sums.rate.get(i),
            ) else {
                return;
            };
            // Q10 · Q20 to Q14, as one product of a word and a halfword: below 2¹⁵ · 2³¹ / 2¹⁶.
            let driven = (mul_long(i32::from(saturate_i16(d)), *w) >> 16) as i32;
            let driven = driven.clamp(-(1 << 26), 1 << 26) << 2;
            // Both below 2²⁸, h within as much: it never leaves where its targets are.
            let target = driven + (*r >> (SUM_FRACTION_BITS - MEMORY_FRACTION_BITS));
            let way = target - *h;
            *h += mul_high_rounded(way, (*rate as u32 >> 1) as i32) << 1;
        });
        let mut read = [0; MAX_MEMORY];
        for (to, h) in read.iter_mut().zip(&self.h) {
            *to = saturate_i16(round_shift(*h, MEMORY_FRACTION_BITS - SIGNAL_FRACTION_BITS));
        }
        let read = read.get(..model.n_memory()).unwrap_or(&[]);
        let mut out = [0i32; MAX_PARAMETERS];
        rows::product(model.output(), &heard, |i, value| {
            if let Some(to) = out.get_mut(i) {
                // The bias is within ±2³⁰, as the value is.
                *to = value + model.output().scaling.bias(i);
            }
        });
        let read = Inputs::new(read);
        rows::product(model.memory(), &read, |i, value| {
            if let (Some(to), Some(offset)) = (out.get_mut(i), sums.offset.get(i)) {
                let offset = offset >> (SUM_FRACTION_BITS - SIGNAL_FRACTION_BITS);
                *to = to.saturating_add(value).saturating_add(offset);
            }
        });
        let said: heapless::Vec<i16, MAX_PARAMETERS> = out
            .iter()
            .take(model.n_parameters)
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
