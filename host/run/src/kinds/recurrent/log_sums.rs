//! What the device's table of log-additions costs by itself: the float model, its probabilities moved along the graph's arcs and
//! added up in log2 of 12 fraction bits, by the table or exactly.
use std::collections::HashMap;

use lipstream_core::logmath::{FRACTION_BITS, LogProb};

use super::chain::{Chain, Visual};
use crate::hmm::graph::Graph;
use crate::hmm::joint::{MOUTH_LEADS, N_EMITTING, SOUND_LEADS};

/// How log probabilities are added.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sums {
    /// Without a table: in floats, rounded to 12 fraction bits.
    Exact,
    /// By the device's table of log-additions.
    Table,
}

/// The arcs into each of the chain's slots.
pub struct LogSums {
    /// From where, and log2 of the probability.
    into: Vec<Vec<(usize, f64)>>,
    sums: Sums,
}

const LSBS: f64 = (1 << FRACTION_BITS) as f64;

impl LogSums {
    /// `probability` is that of every arc of `graph`; arcs of probability 0 are left out.
    pub fn new(chain: &Chain, graph: &Graph, probability: &[f64], sums: Sums) -> Self {
        let slot = slots(chain, graph);
        let mut into = vec![Vec::new(); chain.states()];
        for (arc, p) in graph.arcs.iter().zip(probability).filter(|(_, p)| **p > 0.0) {
            into[slot[arc.to as usize]].push((slot[arc.from as usize], p.log2()));
        }
        Self { into, sums }
    }

    /// [`Chain::predict`].
    pub fn predict(&self, alpha: &[f32], out: &mut [f32]) {
        let logs: Vec<f64> = alpha.iter().map(|a| f64::from(*a).log2()).collect();
        for (to, arcs) in out.iter_mut().zip(&self.into) {
            let mut sum: Option<LogProb> = None;
            for &(from, log) in arcs.iter().filter(|(from, _)| alpha[*from] > 0.0) {
                let term = LogProb::from_q12(((logs[from] + log) * LSBS).round() as i32);
                sum = Some(sum.map_or(term, |sum| self.plus(sum, term)));
            }
            *to = sum.map_or(0.0, |sum| (f64::from(sum.q12()) / LSBS).exp2() as f32);
        }
    }

    fn plus(&self, a: LogProb, b: LogProb) -> LogProb {
        match self.sums {
            Sums::Table => a.plus(b),
            Sums::Exact => {
                let real = |p: LogProb| (f64::from(p.q12()) / LSBS).exp2();
                LogProb::from_q12(((real(a) + real(b)).log2() * LSBS).round() as i32)
            }
        }
    }
}

/// Which slot each state of the graph is. Pairs that differ only in what they wait for share their states.
pub fn slots(chain: &Chain, graph: &Graph) -> Vec<usize> {
    let mut of: HashMap<(usize, usize, usize), usize> = HashMap::new();
    chain.for_slots(|k, i, visual| {
        for p in 0..chain.phones {
            let (v, class) = match visual {
                Visual::Own(j) => (N_EMITTING * chain.atom[p] + j, k),
                // The first slots that lead are the mouth's.
                Visual::State(v) if i == N_EMITTING - 1 => (v, MOUTH_LEADS),
                Visual::State(v) => (v, SOUND_LEADS),
            };
            of.insert((N_EMITTING * p + i, v, class), k * chain.stride + p);
        }
    });
    let states = graph.states.iter();
    states.map(|s| of[&(s.audio, s.visual, s.class)]).collect()
}
