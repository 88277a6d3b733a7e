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
//!
//! A likelihood-trained model (K densities a state, a lag of L frames) with so many joint states active on average, which depends on more
//! than its sizes:
//!
//! ```text
//! 92,000 + 1,450·D + active·(570 + 150·K + 1,650·L / (L + 3.6))
//! ```
//!
//! within 7 % of eighteen counts.
use lipstream_core::{Likelihood, Model, Stream, StreamSettings};

use crate::kinds::hierarchical::{HierarchicalModel, Node};
use crate::kinds::recurrent::model::RecurrentModel;

/// A model under a beam.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// Which of the models.
    pub model: usize,
    /// Width of the beam in bits.
    pub beam_bits: f64,
    /// Bytes of tables.
    pub bytes: usize,
    /// Instructions of a hop on average.
    pub instructions: f64,
    /// AMSE of the validation clips, where the file says.
    pub validation: Option<f64>,
}

/// Limits; none: no limit.
#[derive(Clone, Copy, Debug, Default)]
pub struct Budget {
    /// Most bytes of tables.
    pub bytes: Option<usize>,
    /// Most instructions of a hop on average.
    pub instructions: Option<f64>,
}

/// Instructions of a hop of a model with a memory on average over speech.
pub fn instructions(model: &RecurrentModel, beam_bits: f64) -> f64 {
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
    // Half of a step in every frame, and what speaks.
    let second = model.gated.as_ref().map_or(0.0, |gated| {
        let k = of(gated.shape.memory);
        2.0 * (1.5 * k * (z + k) + k * d) + 70.0 * k
    });
    second
        + 57_000.0
        + 1.72 * c * z
        + 1.6 * (h * z + (z + h) * d)
        + 18.0 * (3.0 * h + d)
        + 30.0 * h
        + 1_360.0 * active
}

/// Instructions of a hop of a hierarchical model on average: front end, frames between pictures, and a picture every fourth hop. Within 1 % of the one count that there is
/// (`docs/cost.md`), 43,913.
pub fn instructions_of_pictures(model: &HierarchicalModel) -> f64 {
    let of = |node: &Node| {
        let (k, m) = (node.map.clusters.len(), node.map.modes());
        (k * model.speech.modes() + m * (model.speech.modes() + node.appearance.size())) as f64
    };
    let picture =
        model.nodes.iter().map(of).sum::<f64>() + (model.speech.modes() * model.speech.size()) as f64;
    let d = model.n_parameters() as f64;
    37_000.0 + 60.0 * d + 9.0 * picture / 4.0
}

/// Instructions of a hop of a likelihood-trained model with so many active joint states on average.
pub fn instructions_by_likelihood(tables: &Model<Likelihood>, active: f64) -> f64 {
    let (k, d, lag) = (
        tables.own().n_densities() as f64,
        tables.head().n_parameters() as f64,
        f64::from(tables.own().settings().lag),
    );
    92_000.0 + 1_450.0 * d + active * (570.0 + 150.0 * k + 1_650.0 * lag / (lag + 3.6))
}

/// Active joint states of a hop on average over a sound, with the tables' own beam and lag.
pub fn mean_active(tables: &Model<Likelihood>, samples: &[i16]) -> f64 {
    let mut stream = Stream::new(tables, StreamSettings::default());
    let (mut rest, mut active, mut frames) = (samples, 0, 0);
    while !rest.is_empty() {
        let (taken, frame) = stream.push(rest);
        rest = &rest[taken..];
        if frame.is_some() {
            active += stream.active();
            frames += 1;
        }
    }
    active as f64 / f64::from(frames.max(1))
}

impl Candidate {
    /// Whether it keeps every limit of `budget`.
    pub fn fits(&self, budget: &Budget) -> bool {
        self.exceeds(budget).is_none()
    }

    /// Which limit it breaks, in words.
    pub fn exceeds(&self, budget: &Budget) -> Option<&'static str> {
        if budget.bytes.is_some_and(|most| self.bytes > most) {
            return Some("too large");
        }
        budget
            .instructions
            .is_some_and(|most| self.instructions > most)
            .then_some("too slow")
    }
}

/// The best of those that fit: the smallest error on validation clips, where it is the same (or unknown) the model that was named
/// first, and of one model the widest beam.
pub fn choose(candidates: &[Candidate], budget: &Budget) -> Option<usize> {
    let rank = |c: &Candidate| c.validation.unwrap_or(f64::INFINITY);
    (0..candidates.len())
        .filter(|&n| candidates[n].fits(budget))
        .min_by(|&a, &b| {
            let (a, b) = (&candidates[a], &candidates[b]);
            rank(a)
                .total_cmp(&rank(b))
                .then(a.model.cmp(&b.model))
                .then(b.beam_bits.total_cmp(&a.beam_bits))
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
            instructions,
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
        let budget = Budget {
            bytes: Some(160_000),
            instructions: Some(165_000.0),
        };
        let said = all.each_ref().map(|candidate| candidate.exceeds(&budget));
        assert_eq!(said, [Some("too large"), Some("too large"), Some("too slow")]);
    }

    /// Counted in QEMU over both corpora (`docs/cost.md`), by beam.
    #[test]
    fn the_estimate_is_what_was_counted() {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/grid-s1.safetensors");
        let model = RecurrentModel::read(&path).unwrap();
        for (beam_bits, counted) in [(8.0, 146_709.0), (11.0, 169_357.0), (14.0, 188_521.0)] {
            let estimate = instructions(&model, beam_bits);
            assert!(
                (estimate / counted - 1.0).abs() < 0.03,
                "{beam_bits} bits: {estimate}"
            );
        }
    }

    #[test]
    fn of_models_that_nobody_judged_the_first_is_chosen() {
        let unknown = |model: usize, beam_bits: f64| Candidate {
            model,
            validation: None,
            ..candidate(0.0, beam_bits, 100, 100.0)
        };
        let all = [unknown(0, 10.0), unknown(0, 11.0), unknown(1, 24.0)];
        assert_eq!(choose(&all, &Budget::default()), Some(1));
        let judged = candidate(200.0, 7.0, 100, 100.0);
        let all = [unknown(0, 11.0), judged];
        assert_eq!(choose(&all, &Budget::default()), Some(1));
    }
}
