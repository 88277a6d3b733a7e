//! The phone bigram that the loop over all phones follows.
use ndarray::{Array1, Array2};

use crate::hmm::em::Utterance;
use crate::model::N_EMITTING;

/// ln P(first phone) and ln P(next | phone): halves from the model's own talker and from the other speakers, with a
/// twentieth spread evenly, so that every phone can follow every other.
pub(super) fn bigram(
    n: usize,
    aligned: &[Option<Vec<(usize, usize)>>],
    heard: &[Vec<Utterance>],
) -> (Vec<f32>, Array2<f32>) {
    let mut own = (Array1::<f64>::zeros(n), Array2::<f64>::zeros((n, n)));
    for path in aligned.iter().flatten() {
        let mut said: Vec<usize> = Vec::new();
        for (t, &(audio, _)) in path.iter().enumerate() {
            let begins = t == 0 || (audio % N_EMITTING == 0 && path[t - 1].0 != audio);
            if begins {
                said.push(audio / N_EMITTING);
            }
        }
        count(&said, &mut own);
    }
    let mut others = (Array1::<f64>::zeros(n), Array2::<f64>::zeros((n, n)));
    for utterance in heard.iter().flatten() {
        // Labelled utterances are chains; in a transcript the first pronunciation stands for all.
        let mut said = Vec::new();
        let mut node = utterance.network.entries.first().map(|e| e.0);
        while let Some(at) = node {
            said.push(utterance.network.nodes[at]);
            node = utterance.network.successors[at].first().map(|s| s.0);
        }
        count(&said, &mut others);
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
    let (first_own, first_others) = (own.0.sum(), others.0.sum());
    let initial = (0..n)
        .map(|p| mix(own.0[p], first_own, others.0[p], first_others))
        .collect();
    let table = Array2::from_shape_fn((n, n), |(p, q)| {
        mix(
            own.1[[p, q]],
            own.1.row(p).sum(),
            others.1[[p, q]],
            others.1.row(p).sum(),
        )
    });
    (initial, table)
}

fn count(said: &[usize], counts: &mut (Array1<f64>, Array2<f64>)) {
    if let Some(&first) = said.first() {
        counts.0[first] += 1.0;
    }
    for pair in said.windows(2) {
        counts.1[[pair[0], pair[1]]] += 1.0;
    }
    // Speech goes on after an utterance: its last phone is followed by its first.
    if let (Some(&first), Some(&last)) = (said.first(), said.last()) {
        counts.1[[last, first]] += 1.0;
    }
}
