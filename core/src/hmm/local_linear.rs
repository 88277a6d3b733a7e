//! Local linear visual densities (DESIGN section 6; COS eq. 9-11 with the cluster chosen by the HMM):
//! v_t = W₀x_t + b₀ + Σ_s γ_t(s)·(W_s x_t + b_s), where x_t is a projection of the statics around frame t.
//!
//! The largest occupancies take part, see [`super::gates`].
use super::gates::Gates;
use crate::N_STATIC;
use crate::fixed::{round_shift_i64, saturate_i16, saturate_i32};
use crate::model::Model;
use crate::model::field::{INPUT_FRACTION_BITS, SUM_FRACTION_BITS, limit};
use crate::parameters::MAX_PARAMETERS;
use crate::projection;

/// Statics that are kept: more than 40 before a frame and 16 after it.
const RING: usize = 64;

/// The last statics, Q7.8.
#[derive(Clone, Debug)]
pub struct History {
    ring: [[i16; N_STATIC]; RING],
    /// Frames pushed so far.
    count: u32,
}

impl History {
    #[inline(always)]
    pub const fn new() -> Self {
        Self {
            ring: [[0; N_STATIC]; RING],
            count: 0,
        }
    }

    pub fn reset(&mut self) {
        self.count = 0;
    }

    pub fn count(&self) -> u32 {
        self.count
    }

    pub fn push(&mut self, statics: &[i16; N_STATIC]) {
        self.ring[self.count as usize % RING] = *statics;
        self.count = self.count.wrapping_add(1);
    }

    /// The statics of a frame; beyond either end of what has been pushed those of the first or the last frame.
    #[inline]
    pub fn at(&self, frame: i64) -> [i16; N_STATIC] {
        let last = i64::from(self.count) - 1;
        self.ring[frame.min(last).max(0) as usize % RING]
    }

    /// x of frame `frame`, Q5.11, of which the model's first X are meaningful. Taps beyond either end of what has been
    /// pushed see the first or the last frame.
    pub fn project(&self, model: &Model, frame: u32) -> [i16; limit::INPUTS] {
        let mut stack = [0; limit::TAPS * N_STATIC];
        for (to, tap) in stack.as_chunks_mut::<N_STATIC>().0.iter_mut().zip(model.taps()) {
            *to = self.at(i64::from(frame) + i64::from(tap));
        }
        projection::project(model, stack.get(..model.shape().context()).unwrap_or(&[]))
    }
}

impl Default for History {
    fn default() -> Self {
        Self::new()
    }
}

/// Σ weightᵢ·inputᵢ
#[inline]
fn dot(weights: impl Iterator<Item = i16>, inputs: &[i16]) -> i64 {
    weights
        .zip(inputs)
        .map(|(w, u)| i64::from(w) * i64::from(*u))
        .sum()
}

/// Parameters of one frame in their LSBs, from x (Q5.11) and the gates.
pub fn apply(model: &Model, x: &[i16; limit::INPUTS], gates: &Gates) -> heapless::Vec<i16, MAX_PARAMETERS> {
    let mut sums = [0i64; MAX_PARAMETERS];
    for (sum, row) in sums.iter_mut().zip(model.global_map()) {
        // 96 products of 30 bits: below 2³⁷.
        *sum = round_shift_i64(dot(row.weights.iter(), x), row.shift) + i64::from(row.offset);
    }
    for (state, weight) in gates.iter() {
        for (sum, row) in sums.iter_mut().zip(model.state_map(state)) {
            // 96 products of 22 bits: below 2²⁹. Then 16 bits of scale: below 2⁴⁵.
            let residual: i32 = row
                .weights
                .iter()
                .zip(x)
                .map(|(w, u)| i32::from(*w as i8) * i32::from(*u))
                .sum();
            let residual = (i64::from(residual) * i64::from(row.scale)) >> INPUT_FRACTION_BITS;
            let value = residual + (i64::from(row.bias) << SUM_FRACTION_BITS);
            // Below 2³⁵ · 2¹⁷; six of them.
            *sum += (value * i64::from(weight)) >> 16;
        }
    }
    sums.iter()
        .take(model.n_parameters())
        .map(|sum| saturate_i16(saturate_i32(round_shift_i64(*sum, SUM_FRACTION_BITS))))
        .collect()
}
