//! Transition chances: where EM starts, and the M step (X&L eq. 18, A.16).
use ndarray::Array3;

use super::Parameters;
use crate::hmm::topology::{Pairing, Topology};
use crate::model::{Mixtures, N_EMITTING, choice};

/// Every choice that a row allows; staying is likelier, so that a state lasts about three frames.
pub fn start_transitions(topology: Topology, phones: usize) -> Array3<f32> {
    const STAY: f32 = 0.65;
    if topology.pairing == Pairing::Free {
        return Array3::from_shape_fn((phones, topology.classes_per_phone(), 4), |(_, class, c)| {
            independent(class, 1.0 - STAY, 1.0 - STAY)[c]
        });
    }
    Array3::from_shape_fn((phones, topology.classes_per_phone(), 4), |(_, class, c)| {
        let allowed = topology.allowed(class);
        let others = allowed.iter().filter(|a| **a).count() as f32 - 1.0;
        match (allowed[c], c == choice::STAY) {
            (false, _) => Mixtures::NO_WEIGHT,
            (true, true) => STAY.ln(),
            (true, false) => ((1.0 - STAY) / others).ln(),
        }
    })
}

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

/// Logs of the four choices of pair (i, j) when each chain advances by its own chance (eq. 18). In the last state a
/// chain waits for the other; when both are there, `audio` is the chance to leave the phone.
fn independent(class: usize, audio: f32, visual: f32) -> [f32; 4] {
    const LAST: usize = N_EMITTING - 1;
    let (i, j) = (class / N_EMITTING, class % N_EMITTING);
    let mut row = [0.0; 4];
    match (i < LAST, j < LAST) {
        (false, false) => (row[choice::STAY], row[choice::BOTH_ADVANCE]) = (1.0 - audio, audio),
        (a, v) => {
            let (audio, visual) = (if a { audio } else { 0.0 }, if v { visual } else { 0.0 });
            row[choice::STAY] = (1.0 - audio) * (1.0 - visual);
            row[choice::AUDIO_ADVANCES] = audio * (1.0 - visual);
            row[choice::VISUAL_ADVANCES] = (1.0 - audio) * visual;
            row[choice::BOTH_ADVANCE] = audio * visual;
        }
    }
    row.map(|p| if p > 0.0 { p.ln() } else { Mixtures::NO_WEIGHT })
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
