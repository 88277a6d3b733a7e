//! What a model will cost a Cortex-M4, without running it, and which of several fits a budget.
//!
//! Instructions of a hop on average over speech, a model with a memory (Z inputs, C numbers in a context, H numbers of memory, D
//! mouth parameters, a beam of B bits):
//!
//! ```text
//! 57,000 + 1.72·C·Z + 1.6·(H·Z + (Z + H)·D) + 18·(3H + D) + 30·H + 1,360·active
//! active = 39 + 3.5·(B − 11) from 11 bits on, 39 + 6·(B − 11) below
//! ```
//!
//! front end and what does not depend on sizes; projection; products of i8 matrices; what the states of each chain bring;
//! the memory; following the joint states, of which 39 are active in speech at 11 bits (25 for the talker of the training, 53 for
//! strangers). Within 3 % of what was counted for three models at five beams (`docs/cost.md`).
use crate::mge::model::MgeModel;

/// A model under a beam.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// Which of the models.
    pub model: usize,
    pub beam_bits: f64,
    /// Bytes of tables.
    pub bytes: usize,
    /// Instructions of a hop on average; none where there is no formula.
    pub instructions: Option<f64>,
    /// AMSE of the validation clips, where the file says.
    pub validation: Option<f64>,
}

/// Limits; none: no limit.
#[derive(Clone, Copy, Debug, Default)]
pub struct Budget {
    pub bytes: Option<usize>,
    pub instructions: Option<f64>,
}

/// Instructions of a hop of a model with a memory on average over speech.
pub fn instructions(model: &MgeModel, beam_bits: f64) -> f64 {
    let shape = &model.parameters.shape;
    let of = |n: usize| n as f64;
    let (z, h, d, c) = (
        of(shape.inputs),
        of(shape.memory),
        of(shape.outputs),
        of(shape.context.size()),
    );
    let wider = beam_bits - 11.0;
    let active = (39.0 + wider * if wider < 0.0 { 6.0 } else { 3.5 }).clamp(5.0, 80.0);
    57_000.0 + 1.72 * c * z + 1.6 * (h * z + (z + h) * d) + 18.0 * (3.0 * h + d) + 30.0 * h + 1_360.0 * active
}

impl Candidate {
    pub fn fits(&self, budget: &Budget) -> bool {
        let flash = budget.bytes.is_none_or(|most| self.bytes <= most);
        // What cannot be estimated is not promised.
        let time = budget
            .instructions
            .is_none_or(|most| self.instructions.is_some_and(|n| n <= most));
        flash && time
    }
}

/// The best of those that fit: the smallest error on validation clips, where it is the same (or unknown) the widest beam, then
/// the larger tables.
pub fn choose(candidates: &[Candidate], budget: &Budget) -> Option<usize> {
    let rank = |c: &Candidate| c.validation.unwrap_or(f64::INFINITY);
    (0..candidates.len())
        .filter(|&n| candidates[n].fits(budget))
        .min_by(|&a, &b| {
            let (a, b) = (&candidates[a], &candidates[b]);
            rank(a)
                .total_cmp(&rank(b))
                .then(b.beam_bits.total_cmp(&a.beam_bits))
                .then(b.bytes.cmp(&a.bytes))
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidate(validation: f64, beam_bits: f64, bytes: usize, instructions: f64) -> Candidate {
        Candidate {
            model: 0,
            beam_bits,
            bytes,
            instructions: Some(instructions),
            validation: Some(validation),
        }
    }

    #[test]
    fn the_best_that_fits_is_chosen() {
        let all = [
            candidate(180.0, 11.0, 190_000, 200_000.0),
            candidate(180.0, 10.0, 190_000, 195_000.0),
            candidate(185.0, 11.0, 150_000, 170_000.0),
        ];
        let within = |bytes: usize, instructions: f64| {
            let budget = Budget {
                bytes: Some(bytes),
                instructions: Some(instructions),
            };
            choose(&all, &budget)
        };
        assert_eq!(choose(&all, &Budget::default()), Some(0));
        assert_eq!(within(200_000, 198_000.0), Some(1));
        assert_eq!(within(160_000, 198_000.0), Some(2));
        assert_eq!(within(160_000, 100_000.0), None);
    }

    #[test]
    fn what_cannot_be_estimated_is_not_promised() {
        let unknown = Candidate {
            instructions: None,
            ..candidate(100.0, 24.0, 10, 0.0)
        };
        let budget = Budget {
            instructions: Some(1e9),
            ..Budget::default()
        };
        assert!(!unknown.fits(&budget));
        assert!(unknown.fits(&Budget::default()));
    }
}
