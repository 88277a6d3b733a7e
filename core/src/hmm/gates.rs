//! Occupancies as numbers, and the states that speak in a frame: the [`N_GATES`] largest of those that reach
//! [`LEAST_OCCUPANCY`], scaled to sum 1.
use super::transition::{N_EMITTING, N_VISUAL_STATES};
use crate::frame::{N_VISEMES, VisemeWeights};
use crate::logmath::LINEAR_FRACTION_BITS;

/// States of a chain that take part in one frame, at most.
pub const N_GATES: usize = 6;
/// Least occupancy that takes part, Q0.16: 1/64.
pub const LEAST_OCCUPANCY: u32 = 1 << 10;

/// Turns sums of weights into occupancies: divides each of `sums` by `total` (which none of them exceeds, below 2²⁷) and leaves the
/// shares as Q0.16. If `total` is 0, all shares are 0.
///
/// Cortex-M divides 32-bit numbers in hardware but 64-bit ones by a slow routine, so only the upper 16 bits of the total are divided
/// by. That makes a share wrong by a factor of up to 1 + 2⁻¹⁵.
pub fn share(sums: &mut [u32], total: u32) {
    let up = total.leading_zeros();
    let divisor = total.checked_shl(up).unwrap_or(0) >> LINEAR_FRACTION_BITS;
    for sum in sums.iter_mut().filter(|s| **s > 0) {
        *sum = (*sum << up)
            .checked_div(divisor)
            .unwrap_or(0)
            .min(1 << LINEAR_FRACTION_BITS);
    }
}

/// The states of one chain that take part in a frame, and their weights, Q0.16.
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
        // At most 2¹⁶ + 240. Should no state reach the least, the global map speaks alone.
        let total: u32 = gates.iter().map(|g| g.1).sum();
        for gate in &mut gates {
            // Below 2¹⁷ · 2¹⁵.
            gate.1 = (gate.1 << 15).checked_div(total).unwrap_or(0) << 1;
        }
        Self(gates)
    }

    /// State and weight of each, largest first.
    pub fn iter(&self) -> impl Iterator<Item = (usize, u32)> + '_ {
        self.0.iter().map(|g| (usize::from(g.0), g.1))
    }
}

/// Occupancies of the visemes from those of their states (Q0.16), 255 = 1.
pub fn viseme_weights(occupancy: &[u32; N_VISUAL_STATES]) -> VisemeWeights {
    let mut weights = [0; N_VISEMES];
    for (to, states) in weights.iter_mut().zip(occupancy.as_chunks::<N_EMITTING>().0) {
        // At most 2¹⁶ + 5, times 255.
        let sum: u32 = states.iter().sum();
        *to = ((sum * 255 + (1 << 15)) >> 16).min(255) as u8;
    }
    VisemeWeights::from_array(weights)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hmm::transition::MAX_AUDIO_STATES;

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

    #[test]
    fn the_largest_of_many_states_too() {
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
