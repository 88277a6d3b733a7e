//! The coupled HMM's step over the phone loop, factored: ≈ 10 k multiply-adds instead of 17 k arcs.
//!
//! The joint states are those of [`crate::hmm::graph`] over the loop of all phones: 13 pairs (i, j), |i − j| ≤ 1, inside
//! each phone, `MouthLeads(p, m)` and `SoundLeads(p, m)` for every viseme m. Slot k of phone p lies at k·stride + p, so
//! that every arc is a vector operation over the phones. With x the mass that leaves a phone and B the bigram,
//! ```text
//! SoundLeads(q, m) ← Σ_{p: vis(p)=m} x_S(p)·B(p, q)
//! MouthLeads(p, m) ← x_M(p)·Σ_{q: vis(q)=m} B(p, q)                                              (M3)
//! (q, 1, 1)        ← Σ_p B(p, q)·[x_B(p) + MouthLeads(p, vis(q))·T / Σ_{q': vis(q')=vis(q)} B(p, q')]
//! ```
use ndarray::{Array2, Array3};

use crate::hmm::joint::{MOUTH_LEADS, N_EMITTING, N_TRANSITION_CLASSES, SOUND_LEADS, choice, pair_class};
use crate::hmm::mixtures::Mixtures;
use crate::phones::{Phone, VISEMES};

/// Visemes.
pub const ATOMS: usize = VISEMES.len();
/// Visual states.
pub const VISUAL: usize = ATOMS * N_EMITTING;
/// Pairs inside a phone.
const INSIDE: usize = 13;
/// Slots of one phone.
pub const SLOTS: usize = INSIDE + 2 * ATOMS;
/// Row of a pair class and a choice in the transition table.
const fn row(class: usize, choice: usize) -> usize {
    4 * class + choice
}
/// Rows of the transition table.
pub const ROWS: usize = 4 * N_TRANSITION_CLASSES;

/// (from slot, to slot, row) of the arcs that stay inside a phone.
fn inside_arcs() -> Vec<(usize, usize, usize)> {
    let mut arcs = Vec::new();
    for i in 0..N_EMITTING {
        for j in i.saturating_sub(1)..(i + 2).min(N_EMITTING) {
            for (choice, di, dj) in [
                (choice::STAY, 0, 0),
                (choice::AUDIO_ADVANCES, 1, 0),
                (choice::VISUAL_ADVANCES, 0, 1),
                (choice::BOTH_ADVANCE, 1, 1),
            ] {
                let (i2, j2) = (i + di, j + dj);
                if i2 < N_EMITTING && j2 < N_EMITTING && i2.abs_diff(j2) <= 1 {
                    let from = pair_class(i, j);
                    arcs.push((from, pair_class(i2, j2), row(from, choice)));
                }
            }
        }
    }
    arcs
}

/// Pairs inside a phone, in the order of their slots.
pub fn inside_pairs() -> [(usize, usize); INSIDE] {
    let mut pairs = [(0, 0); INSIDE];
    for i in 0..N_EMITTING {
        for j in i.saturating_sub(1)..(i + 2).min(N_EMITTING) {
            pairs[pair_class(i, j)] = (i, j);
        }
    }
    pairs
}

/// Σ aᵢbᵢ in eight lanes: the order of the sum is fixed, and the compiler can use vectors.
pub fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut lanes = [0.0f32; 8];
    let (ca, cb) = (a.chunks_exact(8), b.chunks_exact(8));
    let (ra, rb) = (ca.remainder(), cb.remainder());
    for (x, y) in ca.zip(cb) {
        for l in 0..8 {
            lanes[l] += x[l] * y[l];
        }
    }
    let rest: f32 = ra.iter().zip(rb).map(|(x, y)| x * y).sum();
    lanes.iter().sum::<f32>() + rest
}

/// y += a·x.
pub fn axpy(a: f32, x: &[f32], y: &mut [f32]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += a * x;
    }
}

/// y += a∘b.
fn fused(a: &[f32], b: &[f32], y: &mut [f32]) {
    for ((y, a), b) in y.iter_mut().zip(a).zip(b) {
        *y += a * b;
    }
}

/// Classes of the pairs (audio, visual) at a phone's borders, counted from 0.
const LAST: usize = N_EMITTING - 1;
const PAIR_44: usize = pair_class(LAST, LAST);
const PAIR_43: usize = pair_class(LAST, LAST - 1);
const PAIR_34: usize = pair_class(LAST - 1, LAST);
const PAIR_00: usize = pair_class(0, 0);
const PAIR_01: usize = pair_class(0, 1);
const PAIR_10: usize = pair_class(1, 0);

/// What does not change while a clip is followed.
#[derive(Clone, Debug)]
pub struct Chain {
    /// Number of phones.
    pub phones: usize,
    /// Phones rounded up to eight.
    pub stride: usize,
    /// Viseme of each phone.
    pub atom: Vec<usize>,
    /// Probabilities, `[ROWS][stride]`.
    transition: Vec<f32>,
    /// P(q | p), `[p][stride]`, and its transpose `[q][stride]`.
    bigram: Vec<f32>,
    bigram_to: Vec<f32>,
    /// Σ_{q: vis(q)=m} P(q | p), `[m][stride]`, and one over it (0 where it is 0).
    by_atom: Vec<f32>,
    by_atom_inverse: Vec<f32>,
    arcs: Vec<(usize, usize, usize)>,
    /// Audio and visual state (i, j) of each pair inside a phone, in the order of the slots.
    pub pairs: [(usize, usize); INSIDE],
}

/// Room for one step and its transpose.
#[derive(Clone, Debug)]
pub struct Scratch {
    a: Vec<f32>,
    b: Vec<f32>,
    c: Vec<f32>,
    wide: Vec<f32>,
    wide2: Vec<f32>,
}

impl Chain {
    /// `transition` `[phones, 15, 4]` and `bigram` `[phones, phones]` in natural logs, as in [`crate::kinds::likelihood::Model`].
    pub fn new(phones: &[Phone], transition: &Array3<f32>, bigram: &Array2<f32>) -> Self {
        let n = phones.len();
        let stride = n.next_multiple_of(8);
        let atom: Vec<usize> = phones.iter().map(|p| usize::from(p.viseme().0)).collect();
        let mut chain = Chain {
            phones: n,
            stride,
            atom,
            transition: vec![0.0; ROWS * stride],
            bigram: vec![0.0; n * stride],
            bigram_to: vec![0.0; n * stride],
            by_atom: vec![0.0; ATOMS * stride],
            by_atom_inverse: vec![0.0; ATOMS * stride],
            arcs: inside_arcs(),
            pairs: inside_pairs(),
        };
        for p in 0..n {
            for q in 0..n {
                let b = bigram[[p, q]].exp();
                chain.bigram[p * stride + q] = b;
                chain.bigram_to[q * stride + p] = b;
                chain.by_atom[chain.atom[q] * stride + p] += b;
            }
        }
        for (inverse, sum) in chain.by_atom_inverse.iter_mut().zip(&chain.by_atom) {
            *inverse = if *sum > 0.0 { 1.0 / sum } else { 0.0 };
        }
        let logs: Vec<f32> = transition.iter().copied().collect();
        chain.set_transitions(&logs);
        chain
    }

    /// Natural logs `[phones][15][4]`, side by side; what is [`Mixtures::NO_WEIGHT`] becomes 0.
    pub fn set_transitions(&mut self, logs: &[f32]) {
        for (p, of_phone) in logs.chunks_exact(ROWS).enumerate() {
            for (r, log) in of_phone.iter().enumerate() {
                let possible = *log > Mixtures::NO_WEIGHT / 2.0;
                self.transition[r * self.stride + p] = if possible { log.exp() } else { 0.0 };
            }
        }
    }

    /// Length of a vector of joint states: every slot of every phone, padding included.
    pub fn states(&self) -> usize {
        SLOTS * self.stride
    }

    /// Room of this chain's size.
    pub fn scratch(&self) -> Scratch {
        let s = self.stride;
        Scratch {
            a: vec![0.0; s],
            b: vec![0.0; s],
            c: vec![0.0; s],
            wide: vec![0.0; ATOMS * s],
            wide2: vec![0.0; ATOMS * s],
        }
    }

    fn t(&self, class: usize, choice: usize) -> &[f32] {
        let at = row(class, choice) * self.stride;
        &self.transition[at..at + self.stride]
    }

    fn slot<'a>(&self, v: &'a [f32], k: usize) -> &'a [f32] {
        &v[k * self.stride..(k + 1) * self.stride]
    }

    fn slot_mut<'a>(&self, v: &'a mut [f32], k: usize) -> &'a mut [f32] {
        &mut v[k * self.stride..(k + 1) * self.stride]
    }

    /// π = Aᵀα (M3): where the mass of `alpha` goes in one step. Both `[SLOTS][stride]`.
    pub fn predict(&self, alpha: &[f32], out: &mut [f32], scratch: &mut Scratch) {
        let n = self.phones;
        out.fill(0.0);
        for &(from, to, row) in &self.arcs {
            let (from, row) = (self.slot(alpha, from), self.slot(&self.transition, row));
            fused(from, row, self.slot_mut(out, to));
        }
        // Sound leads.
        let x = &mut scratch.a;
        x.fill(0.0);
        fused(
            self.slot(alpha, PAIR_44),
            self.t(PAIR_44, choice::AUDIO_ADVANCES),
            x,
        );
        fused(
            self.slot(alpha, PAIR_43),
            self.t(PAIR_43, choice::BOTH_ADVANCE),
            x,
        );
        for p in 0..n {
            let to = self.slot_mut(out, INSIDE + ATOMS + self.atom[p]);
            axpy(x[p], self.slot(&self.bigram, p), to);
        }
        // Mouth leads.
        x.fill(0.0);
        fused(
            self.slot(alpha, PAIR_44),
            self.t(PAIR_44, choice::VISUAL_ADVANCES),
            x,
        );
        fused(
            self.slot(alpha, PAIR_34),
            self.t(PAIR_34, choice::BOTH_ADVANCE),
            x,
        );
        for m in 0..ATOMS {
            let share = self.slot(&self.by_atom, m);
            fused(x, share, self.slot_mut(out, INSIDE + m));
        }
        // The next phone: both chains enter together, or the sound follows the mouth.
        let both = &mut scratch.b;
        both.fill(0.0);
        fused(
            self.slot(alpha, PAIR_44),
            self.t(PAIR_44, choice::BOTH_ADVANCE),
            both,
        );
        for m in 0..ATOMS {
            let leads = self.slot(alpha, INSIDE + m);
            let inverse = self.slot(&self.by_atom_inverse, m);
            let (follow, both_on) = (
                self.t(MOUTH_LEADS, choice::AUDIO_ADVANCES),
                self.t(MOUTH_LEADS, choice::BOTH_ADVANCE),
            );
            let at = m * self.stride;
            for p in 0..self.stride {
                let mass = leads[p] * inverse[p];
                scratch.wide[at + p] = both[p] + mass * follow[p];
                scratch.wide2[at + p] = mass * both_on[p];
            }
        }
        for q in 0..n {
            let b = self.slot(&self.bigram_to, q);
            out[PAIR_00 * self.stride + q] += dot(b, self.slot(&scratch.wide, self.atom[q]));
            out[PAIR_01 * self.stride + q] += dot(b, self.slot(&scratch.wide2, self.atom[q]));
        }
        // Leaders that stay, and mouths that follow.
        let mouth_stays = self.t(MOUTH_LEADS, choice::STAY);
        let sound_stays = self.t(SOUND_LEADS, choice::STAY);
        let sum = &mut scratch.c;
        sum.fill(0.0);
        for m in 0..ATOMS {
            fused(
                self.slot(alpha, INSIDE + m),
                mouth_stays,
                self.slot_mut(out, INSIDE + m),
            );
            let sound = INSIDE + ATOMS + m;
            fused(self.slot(alpha, sound), sound_stays, self.slot_mut(out, sound));
            axpy(1.0, self.slot(alpha, sound), sum);
        }
        fused(
            sum,
            self.t(SOUND_LEADS, choice::VISUAL_ADVANCES),
            self.slot_mut(out, PAIR_00),
        );
        fused(
            sum,
            self.t(SOUND_LEADS, choice::BOTH_ADVANCE),
            self.slot_mut(out, PAIR_10),
        );
    }

    /// g_α = A·g_π, the transpose of [`Chain::predict`]; adds α∘g to `g_transition` `[ROWS][stride]`.
    pub fn transposed(
        &self,
        alpha: &[f32],
        g: &[f32],
        g_alpha: &mut [f32],
        g_transition: &mut [f32],
        scratch: &mut Scratch,
    ) {
        let n = self.phones;
        g_alpha.fill(0.0);
        for &(from, to, row) in &self.arcs {
            let g = self.slot(g, to);
            fused(g, self.slot(&self.transition, row), self.slot_mut(g_alpha, from));
            fused(g, self.slot(alpha, from), self.slot_mut(g_transition, row));
        }
        let mut leave = |from: usize, choice: usize, class: usize, g: &[f32], g_alpha: &mut [f32]| {
            fused(g, self.t(class, choice), self.slot_mut(g_alpha, from));
            fused(
                g,
                self.slot(alpha, from),
                self.slot_mut(g_transition, row(class, choice)),
            );
        };
        // Sound leads.
        let x = &mut scratch.a;
        x.fill(0.0);
        for p in 0..n {
            x[p] = dot(
                self.slot(&self.bigram, p),
                self.slot(g, INSIDE + ATOMS + self.atom[p]),
            );
        }
        leave(PAIR_44, choice::AUDIO_ADVANCES, PAIR_44, x, g_alpha);
        leave(PAIR_43, choice::BOTH_ADVANCE, PAIR_43, x, g_alpha);
        // Mouth leads.
        x.fill(0.0);
        for m in 0..ATOMS {
            fused(self.slot(&self.by_atom, m), self.slot(g, INSIDE + m), x);
        }
        leave(PAIR_44, choice::VISUAL_ADVANCES, PAIR_44, x, g_alpha);
        leave(PAIR_34, choice::BOTH_ADVANCE, PAIR_34, x, g_alpha);
        // The next phone.
        let (wide, wide2) = (&mut scratch.wide, &mut scratch.wide2);
        wide.fill(0.0);
        wide2.fill(0.0);
        for q in 0..n {
            let b = self.slot(&self.bigram_to, q);
            axpy(g[PAIR_00 * self.stride + q], b, self.slot_mut(wide, self.atom[q]));
            axpy(
                g[PAIR_01 * self.stride + q],
                b,
                self.slot_mut(wide2, self.atom[q]),
            );
        }
        x.fill(0.0);
        for m in 0..ATOMS {
            axpy(1.0, self.slot(wide, m), x);
        }
        leave(PAIR_44, choice::BOTH_ADVANCE, PAIR_44, x, g_alpha);
        for m in 0..ATOMS {
            let inverse = self.slot(&self.by_atom_inverse, m);
            for (w, i) in self.slot_mut(wide, m).iter_mut().zip(inverse) {
                *w *= i;
            }
            for (w, i) in self.slot_mut(wide2, m).iter_mut().zip(inverse) {
                *w *= i;
            }
            let (mouth, sound) = (INSIDE + m, INSIDE + ATOMS + m);
            leave(
                mouth,
                choice::AUDIO_ADVANCES,
                MOUTH_LEADS,
                self.slot(wide, m),
                g_alpha,
            );
            leave(
                mouth,
                choice::BOTH_ADVANCE,
                MOUTH_LEADS,
                self.slot(wide2, m),
                g_alpha,
            );
            leave(mouth, choice::STAY, MOUTH_LEADS, self.slot(g, mouth), g_alpha);
            leave(sound, choice::STAY, SOUND_LEADS, self.slot(g, sound), g_alpha);
            leave(
                sound,
                choice::VISUAL_ADVANCES,
                SOUND_LEADS,
                self.slot(g, PAIR_00),
                g_alpha,
            );
            leave(
                sound,
                choice::BOTH_ADVANCE,
                SOUND_LEADS,
                self.slot(g, PAIR_10),
                g_alpha,
            );
        }
    }

    /// Calls `visit(slot, audio state i, visual)` for every slot; `visual` is a state j of the phone's own viseme or
    /// one state of all the visual chain.
    pub fn for_slots(&self, mut visit: impl FnMut(usize, usize, Visual)) {
        let last = N_EMITTING - 1;
        for (k, &(i, j)) in self.pairs.iter().enumerate() {
            visit(k, i, Visual::Own(j));
        }
        for m in 0..ATOMS {
            visit(INSIDE + m, last, Visual::State(N_EMITTING * m));
            visit(INSIDE + ATOMS + m, 0, Visual::State(N_EMITTING * m + last));
        }
    }

    /// Where an utterance begins: a phone's share evenly over its 13 pairs.
    pub fn first(&self, initial: &[f32], out: &mut [f32]) {
        out.fill(0.0);
        for k in 0..INSIDE {
            for (o, p) in self.slot_mut(out, k).iter_mut().zip(initial) {
                *o = p / INSIDE as f32;
            }
        }
    }

    /// Transpose of [`Chain::first`].
    pub fn first_transposed(&self, g: &[f32], out: &mut [f32]) {
        for k in 0..INSIDE {
            for (o, g) in out.iter_mut().zip(self.slot(g, k)) {
                *o += g / INSIDE as f32;
            }
        }
    }
}

/// Visual state of a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Visual {
    /// State j of the phone's own viseme.
    Own(usize),
    /// One of the 65.
    State(usize),
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hmm::graph::Graph;
    use crate::hmm::network::PhoneNetwork;
    use crate::hmm::topology::Topology;
    use crate::kinds::recurrent::log_sums::{LogSums, Sums, slots};
    use crate::synthetic::phones_and_arcs;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    #[test]
    fn a_step_equals_the_graphs_arcs() {
        for n in [3, 11, 47] {
            let (phones, transition, bigram) = phones_and_arcs(n, 5);
            let chain = Chain::new(&phones, &transition, &bigram);
            let network = PhoneNetwork::phone_loop(&vec![0.0; n], &bigram);
            let graph = Graph::build(&network, Topology::PH_VI_CHMM, &phones);
            let probability = graph.probabilities(&transition);
            let slot = slots(&chain, &graph);
            let mut distinct = slot.clone();
            distinct.sort_unstable();
            distinct.dedup();
            assert_eq!(distinct.len(), graph.states.len());
            if n == 47 {
                assert_eq!(graph.states.len(), SLOTS * n);
            }
            let mut rng = Pcg64::seed_from_u64(1);
            let mut alpha = vec![0.0f32; chain.states()];
            for &s in &slot {
                alpha[s] = rng.random_range(0.0..1.0);
            }
            let mut expected = vec![0.0f64; chain.states()];
            for (arc, p) in graph.arcs.iter().zip(&probability) {
                expected[slot[arc.to as usize]] += f64::from(alpha[slot[arc.from as usize]]) * p;
            }
            let mut out = vec![0.0f32; chain.states()];
            chain.predict(&alpha, &mut out, &mut chain.scratch());
            for (have, want) in out.iter().zip(&expected) {
                assert!((f64::from(*have) - want).abs() < 1e-5, "{have} {want}");
            }
            for (sums, bound) in [(Sums::Exact, 0.005), (Sums::Table, 0.02)] {
                LogSums::new(&chain, &graph, &probability, sums).predict(&alpha, &mut out);
                for (have, want) in out.iter().zip(&expected) {
                    let error = (f64::from(*have) - want).abs();
                    assert!(error <= bound * want, "{sums:?}: {have} {want}");
                }
            }
        }
    }

    #[test]
    fn the_transpose_is_one() {
        let (phones, transition, bigram) = phones_and_arcs(20, 9);
        let chain = Chain::new(&phones, &transition, &bigram);
        let mut rng = Pcg64::seed_from_u64(2);
        let mut fill = || -> Vec<f32> {
            let live = |s: usize| s % chain.stride < chain.phones;
            (0..chain.states())
                .map(|s| {
                    if live(s) {
                        rng.random_range(-1.0f32..1.0)
                    } else {
                        0.0
                    }
                })
                .collect()
        };
        let (alpha, g) = (fill(), fill());
        let mut scratch = chain.scratch();
        let mut out = vec![0.0; chain.states()];
        chain.predict(&alpha, &mut out, &mut scratch);
        let mut back = vec![0.0; chain.states()];
        let mut g_transition = vec![0.0; ROWS * chain.stride];
        chain.transposed(&alpha, &g, &mut back, &mut g_transition, &mut scratch);
        let sum = |a: &[f32], b: &[f32]| -> f64 {
            a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
        };
        let forward = sum(&out, &g);
        assert!((forward - sum(&alpha, &back)).abs() < 1e-3);
        // The step is linear in the transition table too.
        assert!((forward - sum(&chain.transition, &g_transition)).abs() < 1e-3);
    }
}
