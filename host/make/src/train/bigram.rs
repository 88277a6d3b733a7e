//! The phone bigram that the loop over all phones follows.
use ndarray::{Array1, Array2};

use super::data::Clips;
use lipstream::hmm::joint::N_EMITTING;

/// How often each phone came first, and each after each.
#[derive(Clone, Debug)]
pub(crate) struct Said {
    first: Array1<f64>,
    next: Array2<f64>,
}

impl Said {
    pub(crate) fn none(phones: usize) -> Self {
        Self {
            first: Array1::zeros(phones),
            next: Array2::zeros((phones, phones)),
        }
    }

    /// Adds the phones of one utterance.
    pub(crate) fn add(&mut self, said: &[usize]) {
        if let Some(&first) = said.first() {
            self.first[first] += 1.0;
        }
        for pair in said.windows(2) {
            self.next[[pair[0], pair[1]]] += 1.0;
        }
        // Speech goes on after an utterance: its last phone is followed by its first.
        if let (Some(&first), Some(&last)) = (said.first(), said.last()) {
            self.next[[last, first]] += 1.0;
        }
    }
}

/// The phones of an alignment.
pub(super) fn said_on(path: &[(usize, usize)]) -> Vec<usize> {
    let begins = |t: usize| {
        let audio = path[t].0;
        t == 0 || (audio.is_multiple_of(N_EMITTING) && path[t - 1].0 != audio)
    };
    let starts = (0..path.len()).filter(|&t| begins(t));
    starts.map(|t| path[t].0 / N_EMITTING).collect()
}

/// ln P(first phone) and ln P(next | phone): halves from the model's own talker and from the other speakers, with a
/// twentieth spread evenly, so that every phone can follow every other.
pub(crate) fn bigram(n: usize, own: &Said, heard: &Clips) -> (Vec<f32>, Array2<f32>) {
    let mut others = Said::none(n);
    for network in heard.networks() {
        others.add(&network.usual());
    }
    let mix = |a: f64, total_a: f64, b: f64, total_b: f64| -> f32 {
        let even = 1.0 / n as f64;
        let share = |x: f64, total: f64| if total > 0.0 { x / total } else { 0.0 };
        let (wa, wb) = match (total_a > 0.0, total_b > 0.0) {
            (true, true) => (0.475, 0.475),
            (true, false) => (0.95, 0.0),
            (false, true) => (0.0, 0.95),
            (false, false) => (0.0, 0.0),
        };
        (wa * share(a, total_a) + wb * share(b, total_b) + (1.0 - wa - wb) * even).ln() as f32
    };
    let (first_own, first_others) = (own.first.sum(), others.first.sum());
    let initial = (0..n)
        .map(|p| mix(own.first[p], first_own, others.first[p], first_others))
        .collect();
    let table = Array2::from_shape_fn((n, n), |(p, q)| {
        mix(
            own.next[[p, q]],
            own.next.row(p).sum(),
            others.next[[p, q]],
            others.next.row(p).sum(),
        )
    });
    (initial, table)
}
