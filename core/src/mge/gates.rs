//! Which states speak in a frame: occupancies of the audio and the visual states from the tokens, the largest of each.
use crate::hmm::lag::MAX_AUDIO_STATES;
use crate::hmm::token::Token;
use crate::logmath::{LINEAR_FRACTION_BITS, LogProb};
use crate::model::Model;
use crate::model::field::N_VISUAL_STATES;

/// States of a chain that take part in one frame, at most.
pub const N_GATES: usize = 6;
/// Least occupancy that takes part, Q0.16: 1/64.
pub const LEAST_OCCUPANCY: u32 = 1 << 10;

/// Occupancies of both chains' states, Q0.16; each chain's sum is 1 within its number of states in LSBs.
pub struct Occupancy {
    pub audio: [u32; MAX_AUDIO_STATES],
    pub visual: [u32; N_VISUAL_STATES],
}

impl Occupancy {
    /// γᵃ(a) = Σ_v α(a, v), γᵛ(v) = Σ_a α(a, v).
    pub fn of(model: &Model, tokens: &[Token]) -> Self {
        let mut out = Self {
            audio: [0; MAX_AUDIO_STATES],
            visual: [0; N_VISUAL_STATES],
        };
        // The best token has 2¹⁶; at most 1872 of them: below 2²⁷.
        let mut total: u32 = 0;
        for token in tokens {
            let share = LogProb::from_score(token.score).exp2();
            total += share;
            if let Some(sum) = out.audio.get_mut(token.state.audio()) {
                *sum += share;
            }
            let visual = token.state.visual(model.viseme(token.state.phone()));
            if let Some(sum) = out.visual.get_mut(visual) {
                *sum += share;
            }
        }
        // Divide by the total's upper 16 bits: relative error 2⁻¹⁵, and 32-bit divisions only.
        let up = total.leading_zeros();
        let divisor = total.checked_shl(up).unwrap_or(0) >> LINEAR_FRACTION_BITS;
        for sum in out.audio.iter_mut().chain(&mut out.visual).filter(|s| **s > 0) {
            *sum = (*sum << up)
                .checked_div(divisor)
                .unwrap_or(0)
                .min(1 << LINEAR_FRACTION_BITS);
        }
        out
    }
}

/// The occupancies that take part in a frame: state and weight, Q0.16.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Gates(heapless::Vec<(u8, u32), N_GATES>);

impl Gates {
    /// The largest of `occupancy` (Q0.16, sum about 1), scaled to sum 1. Of equal ones the lower states.
    pub fn choose(occupancy: &[u32]) -> Self {
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
        // At most 2¹⁶ + 240.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gates_are_the_largest_in_order() {
        let mut occupancy = [0; MAX_AUDIO_STATES];
        for (i, weight) in [9000, 500, 12000, 7000, 8000, 6000, 11000, 10000, 2036]
            .into_iter()
            .enumerate()
        {
            occupancy[26 * i] = weight;
        }
        let gates = Gates::choose(&occupancy);
        let states: heapless::Vec<usize, 8> = gates.iter().map(|g| g.0).collect();
        assert_eq!(states[..], [52, 156, 182, 0, 104, 78]);
        let total: u32 = gates.iter().map(|g| g.1).sum();
        assert!(total.abs_diff(1 << 16) <= 2 * N_GATES as u32, "{total}");
    }
}
