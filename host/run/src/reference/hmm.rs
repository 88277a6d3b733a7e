//! The ph-vi coupled HMM over a phone loop in `f64`, dense and by the definition (X&L eq. 19): the twin of
//! `core/src/hmm`. Slow; for tests.
use ndarray::{Array2, ArrayView1, ArrayView2, Axis, s};

use crate::hmm::joint::{MOUTH_LEADS, N_EMITTING, SOUND_LEADS, choice, pair_class};
use crate::hmm::mixtures::Mixtures;
use crate::kinds::likelihood::Model;
use crate::phones::VISEMES;

/// Audio state i of `phone` and visual state j of `viseme`, and how far the audio chain is ahead of the visual chain along the
/// unrolled path: −1, 0 or 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct State {
    /// Phone of the audio chain, by its index in the model.
    pub phone: usize,
    /// Audio state inside the phone, 0..5.
    pub i: usize,
    /// Viseme of the visual chain.
    pub viseme: usize,
    /// Visual state inside the viseme, 0..5.
    pub j: usize,
    /// States by which the audio chain is ahead: −1, 0 or 1.
    pub ahead: i32,
}

/// All joint states, and the probability of going from one to the other.
pub struct Coupled {
    /// The joint states; arcs refer to them by index.
    pub states: Vec<State>,
    /// Per state: where to, with which probability.
    pub arcs: Vec<Vec<(usize, f64)>>,
    /// Probability of beginning in each state.
    pub initial: Vec<f64>,
}

fn probability(log: f32) -> f64 {
    if log <= Mixtures::NO_WEIGHT / 10.0 {
        0.0
    } else {
        f64::from(log).exp()
    }
}

impl Coupled {
    /// The model's HMM over the phone loop.
    pub fn new(model: &Model) -> Self {
        let viseme = |p: usize| usize::from(model.phones[p].viseme().0);
        let last = N_EMITTING - 1;
        let mut states = Vec::new();
        for phone in 0..model.phones.len() {
            for i in 0..N_EMITTING {
                for j in 0..N_EMITTING {
                    if i.abs_diff(j) <= 1 {
                        let ahead = i as i32 - j as i32;
                        states.push(State {
                            phone,
                            i,
                            viseme: viseme(phone),
                            j,
                            ahead,
                        });
                    }
                }
            }
            for m in 0..VISEMES.len() {
                if model.phones.iter().any(|p| usize::from(p.viseme().0) == m) {
                    states.push(State {
                        phone,
                        i: last,
                        viseme: m,
                        j: 0,
                        ahead: -1,
                    });
                    states.push(State {
                        phone,
                        i: 0,
                        viseme: m,
                        j: last,
                        ahead: 1,
                    });
                }
            }
        }
        let mut coupled = Self {
            initial: vec![0.0; states.len()],
            arcs: Vec::new(),
            states,
        };
        for (p, log) in model.initial.iter().enumerate() {
            let start = State {
                phone: p,
                i: 0,
                viseme: viseme(p),
                j: 0,
                ahead: 0,
            };
            let at = coupled.find(start);
            coupled.initial[at] = probability(*log);
        }
        for from in coupled.states.clone() {
            let mut arcs = Vec::new();
            for (column, audio, visual) in [
                (choice::STAY, false, false),
                (choice::AUDIO_ADVANCES, true, false),
                (choice::VISUAL_ADVANCES, false, true),
                (choice::BOTH_ADVANCE, true, true),
            ] {
                let p = probability(model.transition[[from.phone, class(from), column]]);
                if p > 0.0 {
                    for (to, share) in advance(model, from, audio, visual) {
                        arcs.push((coupled.find(to), p * share));
                    }
                }
            }
            coupled.arcs.push(arcs);
        }
        coupled
    }

    fn find(&self, state: State) -> usize {
        self.states
            .iter()
            .position(|s| *s == state)
            .expect("every arc leads to a joint state")
    }

    /// Occupancies of the joint states `[frames, states]` given all of `log_emission` `[frames, audio states]`.
    pub fn occupancies(&self, log_emission: ArrayView2<f64>) -> Array2<f64> {
        let (frames, n) = (log_emission.nrows(), self.states.len());
        let emission = |t: usize| -> Vec<f64> {
            let best = log_emission.row(t).fold(f64::NEG_INFINITY, |m, v| m.max(*v));
            self.states
                .iter()
                .map(|s| (log_emission[[t, N_EMITTING * s.phone + s.i]] - best).exp())
                .collect()
        };
        let mut alpha = Array2::<f64>::zeros((frames, n));
        for t in 0..frames {
            let mut row = vec![0.0; n];
            if t == 0 {
                row.copy_from_slice(&self.initial);
            } else {
                for (from, arcs) in self.arcs.iter().enumerate() {
                    for &(to, p) in arcs {
                        row[to] += alpha[[t - 1, from]] * p;
                    }
                }
            }
            for (value, b) in row.iter_mut().zip(emission(t)) {
                *value *= b;
            }
            let sum: f64 = row.iter().sum();
            for (to, value) in alpha.row_mut(t).iter_mut().zip(row) {
                *to = value / sum;
            }
        }
        let mut beta = vec![1.0; n];
        for t in (0..frames).rev() {
            if t + 1 < frames {
                let b = emission(t + 1);
                let future: Vec<f64> = beta.iter().zip(&b).map(|(v, b)| v * b).collect();
                for (value, arcs) in beta.iter_mut().zip(&self.arcs) {
                    *value = arcs.iter().map(|&(to, p)| p * future[to]).sum();
                }
            }
            let sum: f64 = alpha.row(t).iter().zip(&beta).map(|(a, b)| a * b).sum();
            for (a, b) in alpha.row_mut(t).iter_mut().zip(&mut beta) {
                *b /= sum;
                *a *= *b;
            }
        }
        alpha
    }

    /// Occupancies of the visual states 5·viseme + j `[frames, 65]`, each frame's given no more than `lag` later frames.
    pub fn visual_occupancies(&self, log_emission: ArrayView2<f64>, lag: usize) -> Array2<f64> {
        let frames = log_emission.nrows();
        let mut out = Array2::zeros((frames, VISEMES.len() * N_EMITTING));
        let whole = (lag >= frames).then(|| self.occupancies(log_emission));
        for t in 0..frames {
            let end = (t + lag + 1).min(frames);
            let gamma = match &whole {
                Some(gamma) => gamma.row(t).to_owned(),
                None => self
                    .occupancies(log_emission.slice(s![..end, ..]))
                    .row(t)
                    .to_owned(),
            };
            for (state, g) in self.states.iter().zip(gamma) {
                out[[t, N_EMITTING * state.viseme + state.j]] += g;
            }
        }
        out
    }
}

fn class(s: State) -> usize {
    let last = N_EMITTING - 1;
    match (s.i, s.j, s.ahead) {
        (i, 0, -1) if i == last => MOUTH_LEADS,
        (0, j, 1) if j == last => SOUND_LEADS,
        (i, j, _) => pair_class(i, j),
    }
}

/// Where a choice leads and with which share, by eq. 19 and the bigram; nowhere if the chains would part.
fn advance(model: &Model, from: State, audio: bool, visual: bool) -> Vec<(State, f64)> {
    let last = N_EMITTING - 1;
    let n = model.phones.len();
    let viseme = |p: usize| usize::from(model.phones[p].viseme().0);
    let ahead = from.ahead + i32::from(audio) - i32::from(visual);
    if ahead.abs() > 1 {
        return Vec::new();
    }
    let mouth_leads = class(from) == MOUTH_LEADS;
    let sound_leads = class(from) == SOUND_LEADS;
    let audio_leaves = audio && from.i == last;
    let visual_leaves = visual && from.j == last;
    // The next phone matters only if a chain enters it that did not already know it.
    let nexts: Vec<(usize, f64)> = if audio_leaves || (visual_leaves && !sound_leads) {
        let bigram: Vec<f64> = (0..n)
            .map(|q| {
                let bound = !mouth_leads || viseme(q) == from.viseme;
                f64::from(u8::from(bound)) * probability(model.bigram[[from.phone, q]])
            })
            .collect();
        let total: f64 = if mouth_leads { bigram.iter().sum() } else { 1.0 };
        (0..n).map(|q| (q, bigram[q] / total)).collect()
    } else {
        vec![(from.phone, 1.0)]
    };
    let mut out: Vec<(State, f64)> = Vec::new();
    for (next, share) in nexts.into_iter().filter(|n| n.1 > 0.0) {
        let (phone, i) = match (audio, audio_leaves) {
            (true, true) => (next, 0),
            (true, false) => (from.phone, from.i + 1),
            (false, _) => (from.phone, from.i),
        };
        let (m, j) = match (visual, visual_leaves) {
            (true, true) if sound_leads => (viseme(from.phone), 0),
            (true, true) => (viseme(next), 0),
            (true, false) => (from.viseme, from.j + 1),
            (false, _) => (from.viseme, from.j),
        };
        let to = State {
            phone,
            i,
            viseme: m,
            j,
            ahead,
        };
        match out.iter_mut().find(|o| o.0 == to) {
            Some(same) => same.1 += share,
            None => out.push((to, share)),
        }
    }
    out
}

/// Scaled natural log likelihoods `[frames, audio states]` of `observations` `[frames, 39]`.
pub fn log_emissions(model: &Model, observations: ArrayView2<f32>) -> Array2<f64> {
    let scale = f64::from(model.following.acoustic_scale);
    let states = model.n_audio_states();
    Array2::from_shape_fn((observations.nrows(), states), |(t, state)| {
        scale * log_mixture(&model.audio, state, observations.row(t))
    })
}

fn log_mixture(mixtures: &Mixtures, state: usize, o: ArrayView1<f32>) -> f64 {
    let terms: Vec<f64> = (0..mixtures.mean.len_of(Axis(1)))
        .filter(|k| mixtures.log_weight[[state, *k]] > Mixtures::NO_WEIGHT / 10.0)
        .map(|k| {
            let mut log = f64::from(mixtures.log_weight[[state, k]]);
            for (d, o) in o.iter().enumerate() {
                let variance = f64::from(mixtures.variance[[state, k, d]]);
                let difference = f64::from(*o) - f64::from(mixtures.mean[[state, k, d]]);
                log -= 0.5 * ((std::f64::consts::TAU * variance).ln() + difference * difference / variance);
            }
            log
        })
        .collect();
    let best = terms.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    best + terms.iter().map(|t| (t - best).exp()).sum::<f64>().ln()
}
