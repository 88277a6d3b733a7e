//! Transition chances: where EM starts, and the M step (X&L eq. 18, A.16).
use ndarray::Array3;

use super::Parameters;
use lipstream::hmm::joint::{N_EMITTING, choice};
use lipstream::hmm::topology::{Pairing, independent};

/// What the chances that were before weigh in an M step, in frames.
const PRIOR: f64 = 3.0;

/// Transition rows from expected counts (eq. A.16), with [`PRIOR`] frames' weight on what they were before.
pub(super) fn maximise_transitions(parameters: &mut Parameters, counts: &Array3<f64>) {
    if parameters.topology.pairing == Pairing::Free {
        return maximise_independent(parameters, counts);
    }
    let (phones, classes, _) = counts.dim();
    for p in 0..phones {
        for class in 0..classes {
            let allowed = parameters.topology.allowed(class);
            let n: f64 = (0..4).map(|c| counts[[p, class, c]]).sum();
            for c in 0..4 {
                if allowed[c] {
                    let before = f64::from(parameters.transition[[p, class, c]]).exp();
                    let share = (counts[[p, class, c]] + PRIOR * before) / (n + PRIOR);
                    parameters.transition[[p, class, c]] = share.ln() as f32;
                }
            }
        }
    }
}

/// Chances of chains that do not see each other: the audio chain's per phone and state, whatever the mouth does; the
/// visual chain's per visual atom and state, whatever the sound does.
fn maximise_independent(parameters: &mut Parameters, counts: &Array3<f64>) {
    const LAST: usize = N_EMITTING - 1;
    let topology = parameters.topology;
    let atom: Vec<usize> = parameters
        .phones
        .iter()
        .enumerate()
        .map(|(p, &phone)| topology.visual_atom(p, phone))
        .collect();
    // (times that it advanced, frames), with what it was before.
    let mut audio = vec![(0.0, 0.0); parameters.phones.len() * N_EMITTING];
    let mut visual = vec![(0.0, 0.0); topology.n_visual_states(parameters.phones.len())];
    let mut before_visual = vec![0.0; visual.len()];
    for (p, &atom) in atom.iter().enumerate() {
        for class in 0..N_EMITTING * N_EMITTING {
            let (i, j) = (class / N_EMITTING, class % N_EMITTING);
            let n: f64 = (0..4).map(|c| counts[[p, class, c]]).sum();
            let both = counts[[p, class, choice::BOTH_ADVANCE]];
            if i < LAST || j == LAST {
                audio[N_EMITTING * p + i].0 += both + counts[[p, class, choice::AUDIO_ADVANCES]];
                audio[N_EMITTING * p + i].1 += n;
            }
            if j < LAST {
                visual[N_EMITTING * atom + j].0 += both + counts[[p, class, choice::VISUAL_ADVANCES]];
                visual[N_EMITTING * atom + j].1 += n;
            }
        }
        for j in 0..LAST {
            let row = topology.inside_class(LAST, j);
            before_visual[N_EMITTING * atom + j] =
                f64::from(parameters.transition[[p, row, choice::VISUAL_ADVANCES]]).exp();
        }
    }
    let chance = |(advanced, n): (f64, f64), before: f64| ((advanced + PRIOR * before) / (n + PRIOR)) as f32;
    for (p, &atom) in atom.iter().enumerate() {
        let before: Vec<f64> = (0..N_EMITTING)
            .map(|i| {
                let c = if i == LAST {
                    choice::BOTH_ADVANCE
                } else {
                    choice::AUDIO_ADVANCES
                };
                f64::from(parameters.transition[[p, topology.inside_class(i, LAST), c]]).exp()
            })
            .collect();
        for class in 0..N_EMITTING * N_EMITTING {
            let (i, j) = (class / N_EMITTING, class % N_EMITTING);
            let (a, v) = (N_EMITTING * p + i, N_EMITTING * atom + j);
            let row = independent(
                class,
                chance(audio[a], before[i]),
                chance(visual[v], before_visual[v]),
            );
            for (c, log) in row.into_iter().enumerate() {
                parameters.transition[[p, class, c]] = log;
            }
        }
    }
}
