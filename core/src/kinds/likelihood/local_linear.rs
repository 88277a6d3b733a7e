//! Local linear visual densities (docs/design.md section 6; COS = Cosker et al. 2004, *Speech-driven facial animation using a
//! hierarchical model*, eq. 9-11 with the cluster chosen by the HMM): v_t = W₀x_t + b₀ + Σ_s γ_t(s)·(W_s x_t + b_s), where x_t is a
//! projection of the statics around frame t.
//!
//! The largest occupancies take part, see [`crate::hmm::gates`].
use super::Likelihood;
use super::tables::{INPUT_FRACTION_BITS, SUM_FRACTION_BITS};
use crate::N_STATIC;
use crate::context::history::History;
use crate::context::projection;
use crate::context::tables::{ContextTables, MAX_INPUTS, MAX_TAPS};
use crate::fixed::{round_shift_i64, saturate_i16, saturate_i32};
use crate::frame::MAX_PARAMETERS;
use crate::hmm::gates::Gates;

/// x of frame `frame`, Q5.11, of which the model's first X are meaningful. Taps beyond either end of what has been pushed see
/// the first or the last frame.
pub fn project(tables: &ContextTables, history: &History, frame: u32) -> [i16; MAX_INPUTS] {
    let mut stack = [0; MAX_TAPS * N_STATIC];
    for (to, tap) in stack.as_chunks_mut::<N_STATIC>().0.iter_mut().zip(tables.taps()) {
        *to = history.at(i64::from(frame) + i64::from(tap));
    }
    projection::project(tables, stack.get(..tables.size()).unwrap_or(&[]))
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
pub fn apply(model: &Likelihood, x: &[i16; MAX_INPUTS], gates: &Gates) -> heapless::Vec<i16, MAX_PARAMETERS> {
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
        .take(model.n_parameters)
        .map(|sum| saturate_i16(saturate_i32(round_shift_i64(*sum, SUM_FRACTION_BITS))))
        .collect()
}
