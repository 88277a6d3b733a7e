//! Local linear visual densities (DESIGN section 6; COS eq. 9-11 with the cluster chosen by the HMM):
//! v_t = W₀x_t + b₀ + Σ_s γ_t(s)·(W_s x_t + b_s), where x_t is a projection of the statics around frame t.
//!
//! Of the occupancies the [`N_GATES`] largest take part, those below [`LEAST_OCCUPANCY`] do not; the ones that do are
//! scaled to sum 1.
use crate::N_STATIC;
use crate::fixed::{round_shift_i64, saturate_i16, saturate_i32};
use crate::model::Model;
use crate::model::field::{INPUT_FRACTION_BITS, N_VISUAL_STATES, SUM_FRACTION_BITS, limit};
use crate::parameters::MAX_PARAMETERS;

/// Visual states that take part in one frame, at most.
pub const N_GATES: usize = 6;
/// Least occupancy that takes part, Q0.16: 1/64.
pub const LEAST_OCCUPANCY: u32 = 1 << 10;

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
        let mut x = [0; limit::INPUTS];
        for (to, row) in x.iter_mut().zip(model.projection()) {
            // 416 products of 30 bits: below 2³⁹.
            let sum = dot(row.weights.iter(), &stack);
            *to = saturate_i16(saturate_i32(
                round_shift_i64(sum, row.shift) - i64::from(row.offset),
            ));
        }
        x
    }
}

impl Default for History {
    fn default() -> Self {
        Self::new()
    }
}

/// Σ weightᵢ·inputᵢ
#[inline]
pub(crate) fn dot(weights: impl Iterator<Item = i16>, inputs: &[i16]) -> i64 {
    weights
        .zip(inputs)
        .map(|(w, u)| i64::from(w) * i64::from(*u))
        .sum()
}

/// The occupancies that take part in a frame: visual state and weight, Q0.16.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Gates(heapless::Vec<(u8, u32), N_GATES>);

impl Gates {
    /// The largest of `occupancy` (Q0.16, sum about 1), scaled to sum 1.
    pub fn choose(occupancy: &[u32; N_VISUAL_STATES]) -> Self {
        let mut gates: heapless::Vec<(u8, u32), N_GATES> = heapless::Vec::new();
        for (state, &weight) in occupancy.iter().enumerate() {
            if weight < LEAST_OCCUPANCY {
                continue;
            }
            if gates.is_full() {
                match gates.last() {
                    Some(last) if last.1 < weight => gates.pop(),
                    _ => continue,
                };
            }
            let at = gates.iter().take_while(|g| g.1 >= weight).count();
            let _ = gates.insert(at, (state as u8, weight));
        }
        // At most 2¹⁶ + 65. Should no state reach the least, the global map speaks alone.
        let total: u32 = gates.iter().map(|g| g.1).sum();
        for gate in &mut gates {
            // Below 2¹⁷ · 2¹⁵.
            gate.1 = (gate.1 << 15).checked_div(total).unwrap_or(0) << 1;
        }
        Self(gates)
    }

    pub fn iter(&self) -> impl Iterator<Item = (usize, u32)> + '_ {
        self.0.iter().map(|g| (usize::from(g.0), g.1))
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gates_are_the_largest_in_order() {
        let mut occupancy = [0; N_VISUAL_STATES];
        for (i, weight) in [9000, 500, 12000, 7000, 8000, 6000, 11000, 10000, 2036]
            .into_iter()
            .enumerate()
        {
            occupancy[7 * i] = weight;
        }
        let gates = Gates::choose(&occupancy);
        let states: heapless::Vec<usize, 8> = gates.iter().map(|g| g.0).collect();
        assert_eq!(states[..], [14, 42, 49, 0, 28, 21]);
        let total: u32 = gates.iter().map(|g| g.1).sum();
        assert!(total.abs_diff(1 << 16) <= 2 * N_GATES as u32, "{total}");
    }

    #[test]
    fn a_single_state_is_one() {
        let mut occupancy = [0; N_VISUAL_STATES];
        occupancy[64] = 65536;
        assert_eq!(Gates::choose(&occupancy).iter().next(), Some((64, 65536)));
    }
}
