//! A second memory beside the one that the states gate: a gated recurrent unit (Cho et al. 2014, with the reset behind the product) that
//! hears z and knows nothing of states.
//!
//! ```text
//! [r̂ û n̂] = W_g z + b_g,   [r' u' n'] = R_g h + b_r
//! r = σ(r̂ + r'),   u = σ(û + u'),   n = tanh(n̂ + r∘n'),   h ← n + u∘(h − n)
//! ĝ = O_g h + b_o,   y = (1 − s) ŷ + s ĝ
//! ```
//! A step is taken in every other frame, counted from the beginning of the stream; the frame between has an O_g and a b_o of its own, which read the same h:
//! mouths move slowly enough for that, and it halves the work.
//!
//! It is trained by itself, so that it errs where the first does not: the mean of both is better than either, most of all on words that
//! no training had. ŷ, not y, feeds back into the visual emissions.
use super::rate::{LOGISTIC_FRACTION_BITS, logistic};
use super::rows::{self, Inputs};
use super::tables::{Blocks, GatedTables, MAX_GATED};
use crate::fixed::{mul_high_rounded, mul_long, round_shift, saturate_i16};

/// Frames from one step to the next.
pub const STRIDE: u32 = 2;
/// Fraction bits of the memory as it is kept.
const MEMORY_BITS: u32 = 24;
/// Fraction bits of the memory as its products read it.
pub const READ_BITS: u32 = 14;
/// Sums before a gate are held to ±2⁵, in LSBs of 2⁻¹²: σ and tanh are flat long before.
const LIMIT: i32 = 1 << (5 + LOGISTIC_FRACTION_BITS);

/// h of a stream.
#[derive(Clone, Debug)]
pub struct GatedMemory {
    /// Q1.24 in (−1, 1), of which the model's first K are meaningful.
    h: [i32; MAX_GATED],
}

impl GatedMemory {
    /// All zeros; [`GatedMemory::reset`] puts it where a stream begins.
    #[inline(always)]
    pub const fn new() -> Self {
        Self { h: [0; MAX_GATED] }
    }

    /// What stands before the first frame.
    pub fn reset(&mut self, tables: Option<&GatedTables>) {
        self.h = [0; MAX_GATED];
        let Some(tables) = tables else { return };
        for (h, first) in self.h.iter_mut().zip(tables.first.iter()) {
            *h = i32::from(first) << (MEMORY_BITS - READ_BITS);
        }
    }

    /// Frame `frame` of the stream: z (Q5.10); `mouth` becomes the mean of what it was and of what this memory says, Q5.10.
    pub fn step(&mut self, tables: &GatedTables, frame: u32, z: &[i16], mouth: &mut [i16]) {
        let [output, later] = &tables.output;
        if frame.is_multiple_of(STRIDE) {
            self.hear(tables, z);
            self.speak(tables, output, mouth);
        } else {
            self.speak(tables, later, mouth);
        }
    }

    fn hear(&mut self, tables: &GatedTables, z: &[i16]) {
        let k = tables.size();
        let mut sums = [0i32; 3 * MAX_GATED];
        // Sums of resets and updates; behind them, what news hear.
        rows::product(&tables.input, &Inputs::new(z), |row, value| {
            if let Some(to) = sums.get_mut(row) {
                *to = held(value.saturating_add(tables.input.scaling.bias(row)));
            }
        });
        let (gates, news) = sums.split_at_mut_checked(2 * k).unwrap_or((&mut [], &mut []));
        let memory = &mut self.h;
        let mut read = [0; MAX_GATED];
        let now = Inputs::new(self::read(memory, k, &mut read));
        rows::product(&tables.again, &now, |row, value| {
            let value = held(value.saturating_add(tables.again.scaling.bias(row)));
            if let Some(gate) = gates.get_mut(row) {
                *gate = logistic(*gate + value) as i32;
                return;
            }
            let i = row - 2 * k;
            let (Some(reset), Some(update)) = (gates.get(i), gates.get(k + i)) else {
                return;
            };
            let (Some(new), Some(h)) = (news.get(i), memory.get_mut(i)) else {
                return;
            };
            // 2¹⁷ · 2¹⁶ / 2¹⁶.
            let new = new + (mul_long(value, *reset) >> 16) as i32;
            // tanh x = 2σ(2x) − 1, here in Q1.24.
            let new = ((logistic(2 * new) as i32) << 9) - (1 << MEMORY_BITS);
            // Below 2²⁵ · 2³¹ / 2³²: h never leaves (−1, 1).
            *h = new + (mul_high_rounded(*h - new, update << 15) << 1);
        });
    }

    fn speak(&self, tables: &GatedTables, output: &Blocks, mouth: &mut [i16]) {
        let mut read = [0; MAX_GATED];
        let now = Inputs::new(self::read(&self.h, tables.size(), &mut read));
        let kept = 0x1_0000 - i32::from(tables.share);
        rows::product(output, &now, |row, value| {
            if let Some(to) = mouth.get_mut(row) {
                // 2¹⁵ · 2¹⁶; the bias is within ±2³⁰.
                let first = (mul_long(i32::from(*to), kept) >> 16) as i32;
                let second = value.saturating_add(output.scaling.bias(row));
                *to = saturate_i16(first.saturating_add(second));
            }
        });
    }
}

/// The first `k` numbers as products read them.
fn read<'a>(memory: &[i32; MAX_GATED], k: usize, into: &'a mut [i16; MAX_GATED]) -> &'a [i16] {
    for (to, h) in into.iter_mut().zip(memory) {
        *to = saturate_i16(round_shift(*h, MEMORY_BITS - READ_BITS));
    }
    into.get(..k).unwrap_or(&[])
}

#[inline]
fn held(x: i32) -> i32 {
    x.clamp(-LIMIT, LIMIT)
}

impl Default for GatedMemory {
    fn default() -> Self {
        Self::new()
    }
}
