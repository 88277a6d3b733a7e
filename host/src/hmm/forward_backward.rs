//! Forward-backward over the arcs of a joint-state graph (X&L eq. A.1-A.11), scaled frame by frame.
//!
//! Scaling: the forward variable of every frame sums to one, so it is P(q_t | o_1..t); what it was divided by adds up
//! to the log likelihood.
//!
//! Nothing is pruned but what a double-precision number could not carry anyway: states whose forward variable is below
//! [`NOTHING`]. In a left-right graph that alone leaves a narrow band of states alive in each frame; only they are
//! visited, and only their emissions are asked for.
use ndarray::Array2;

use super::graph::Graph;

/// A forward variable below this is taken as zero.
const NOTHING: f64 = 1e-150;

/// Scaled in plain numbers as long as a frame's sum is above this; below it, by way of logarithms.
const PLAIN: f64 = 1e-100;

/// What the forward pass leaves: scaled forward variables and scaled emissions.
pub struct Forward {
    /// P(q_t | o_1..t), `[frames, states]`.
    pub alpha: Array2<f64>,
    /// Emission over the frame's scale: α_t(j) = emission_t(j) · Σ_i α_{t−1}(i) a_ij.
    emission: Array2<f64>,
    /// States that are alive in each frame lie in this range.
    window: Vec<Window>,
    /// ln P(O), or −∞ if no path fits.
    pub log_likelihood: f64,
}

/// A range of states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Window {
    from: usize,
    to: usize,
}

impl Window {
    const EMPTY: Window = Window {
        from: usize::MAX,
        to: 0,
    };

    fn take_in(&mut self, state: usize) {
        self.from = self.from.min(state);
        self.to = self.to.max(state + 1);
    }

    fn states(self) -> std::ops::Range<usize> {
        self.from.min(self.to)..self.to
    }
}

/// Natural log emission of a joint state at a frame.
pub trait Emission {
    fn log(&self, t: usize, state: usize) -> f64;
}

impl<F: Fn(usize, usize) -> f64> Emission for F {
    fn log(&self, t: usize, state: usize) -> f64 {
        self(t, state)
    }
}

/// Forward pass. Returns `None` if no path through the graph explains the frames.
pub fn forward(
    graph: &Graph,
    probability: &[f64],
    frames: usize,
    emission: &impl Emission,
) -> Option<Forward> {
    let n = graph.states.len();
    let mut alpha = Array2::<f64>::zeros((frames, n));
    let mut scaled = Array2::<f64>::zeros((frames, n));
    let mut window = vec![Window::EMPTY; frames];
    let mut predicted = vec![0.0f64; n];
    let mut reached = Window::EMPTY;
    for &(state, log) in &graph.entries {
        predicted[state] += f64::from(log).exp();
        reached.take_in(state);
    }
    let to_exit = frames_to_exit(graph);
    let mut log_likelihood = 0.0;
    let mut logs = vec![0.0f64; n];
    let mut emitted = vec![0.0f64; n];
    for t in 0..frames {
        if t > 0 {
            let before = alpha.row(t - 1);
            let before = before.as_slice().unwrap_or(&[]);
            reached = Window::EMPTY;
            for s in window[t - 1].states() {
                let a = before[s];
                if a > 0.0 {
                    let leaving = graph.first[s]..graph.first[s + 1];
                    for (arc, p) in graph.arcs[leaving.clone()].iter().zip(&probability[leaving]) {
                        let to = arc.to as usize;
                        predicted[to] += a * p;
                        reached.take_in(to);
                    }
                }
            }
        }
        let mut max = f64::NEG_INFINITY;
        for s in reached.states() {
            // A state too far from the end to get there in time explains nothing, and must not crowd out those that can.
            if predicted[s] > NOTHING && to_exit[s] < frames - t {
                logs[s] = emission.log(t, s);
                max = max.max(logs[s]);
            } else {
                predicted[s] = 0.0;
            }
        }
        if !max.is_finite() {
            return None;
        }
        let mut sum = 0.0;
        for s in reached.states() {
            if predicted[s] > 0.0 {
                emitted[s] = (logs[s] - max).exp();
                sum += predicted[s] * emitted[s];
            }
        }
        let mut log_sum = max + sum.ln();
        if sum < PLAIN {
            // The states that emit best are hardly reachable: scale by the best product of the two.
            let product = |s: usize| predicted[s].ln() + logs[s];
            let alive = || reached.states().filter(|&s| predicted[s] > 0.0);
            let best = alive().map(product).fold(f64::NEG_INFINITY, f64::max);
            log_sum = best + alive().map(|s| (product(s) - best).exp()).sum::<f64>().ln();
            alive().for_each(|s| emitted[s] = (logs[s] - log_sum).exp());
            sum = 1.0;
        }
        log_likelihood += log_sum;
        let share = 1.0 / sum;
        let mut alpha_row = alpha.row_mut(t);
        let mut scaled_row = scaled.row_mut(t);
        for s in reached.states() {
            let reachable = std::mem::take(&mut predicted[s]);
            if reachable > 0.0 {
                let e = emitted[s] * share;
                let a = reachable * e;
                if a > NOTHING {
                    alpha_row[s] = a;
                    scaled_row[s] = e;
                    window[t].take_in(s);
                }
            }
        }
    }
    if let (Some(exits), true) = (&graph.exits, frames > 0) {
        let last: f64 = exits.iter().map(|&s| alpha[[frames - 1, s]]).sum();
        if last <= 0.0 {
            return None;
        }
        log_likelihood += last.ln();
    }
    Some(Forward {
        alpha,
        emission: scaled,
        window,
        log_likelihood,
    })
}

/// Fewest arcs from each state to where an utterance may end; 0 everywhere if it may end anywhere.
fn frames_to_exit(graph: &Graph) -> Vec<usize> {
    let Some(exits) = &graph.exits else {
        return vec![0; graph.states.len()];
    };
    let mut before = vec![Vec::new(); graph.states.len()];
    for arc in &graph.arcs {
        before[arc.to as usize].push(arc.from as usize);
    }
    let mut distance = vec![usize::MAX; graph.states.len()];
    exits.iter().for_each(|&s| distance[s] = 0);
    let mut queue: std::collections::VecDeque<usize> = exits.iter().copied().collect();
    while let Some(state) = queue.pop_front() {
        for &from in &before[state] {
            if distance[from] == usize::MAX {
                distance[from] = distance[state] + 1;
                queue.push_back(from);
            }
        }
    }
    distance
}

impl Forward {
    /// One step back: from β at t + 1 to β at t (eq. A.10), over states that α reaches; `arc(index, β-part)` is called
    /// for every arc with what it adds to the β of the state that it leaves.
    ///
    /// `beta` must be zero outside the window of t + 1; `out` is so outside that of t.
    fn step_back(
        &self,
        graph: &Graph,
        probability: &[f64],
        t: usize,
        beta: &mut [f64],
        out: &mut [f64],
        mut arc: impl FnMut(usize, usize, f64),
    ) {
        let ahead = self.window[t + 1].states();
        let emission = self.emission.row(t + 1);
        let emission = emission.as_slice().unwrap_or(&[]);
        for s in ahead.clone() {
            beta[s] *= emission[s];
        }
        let here = self.alpha.row(t);
        let here = here.as_slice().unwrap_or(&[]);
        for s in self.window[t].states() {
            if here[s] > 0.0 {
                let mut sum = 0.0;
                for index in graph.first[s]..graph.first[s + 1] {
                    let part = probability[index] * beta[graph.arcs[index].to as usize];
                    if part > 0.0 {
                        sum += part;
                        arc(s, index, part);
                    }
                }
                out[s] = sum;
            }
        }
        beta[ahead].fill(0.0);
    }

    /// One for the states that are alive.
    fn ones(&self, graph: &Graph, t: usize) -> Vec<f64> {
        let mut out = vec![0.0; graph.states.len()];
        out[self.window[t].states()].fill(1.0);
        out
    }

    /// β of the last frame: where an utterance may end.
    fn last_beta(&self, graph: &Graph) -> Vec<f64> {
        let frames = self.alpha.nrows();
        match &graph.exits {
            None => self.ones(graph, frames - 1),
            Some(exits) => {
                let total: f64 = exits.iter().map(|&s| self.alpha[[frames - 1, s]]).sum();
                let mut beta = vec![0.0; graph.states.len()];
                exits.iter().for_each(|&s| beta[s] = 1.0 / total);
                beta
            }
        }
    }

    /// Backward pass over the whole utterance: occupancies `[frames, states]`; `arc(t, index, ξ)` is called for the
    /// occupancy of every arc from frame t to t + 1.
    pub fn backward(
        &self,
        graph: &Graph,
        probability: &[f64],
        mut arc: impl FnMut(usize, usize, f64),
    ) -> Array2<f64> {
        let mut gamma = Array2::zeros(self.alpha.dim());
        self.backward_each(
            graph,
            probability,
            |t, first, row| {
                row.iter()
                    .enumerate()
                    .for_each(|(i, &g)| gamma[[t, first + i]] = g)
            },
            &mut arc,
        );
        gamma
    }

    /// [`Forward::backward`] that keeps nothing: `frame(t, s, γ_t(s..))` is called from the last frame to the first
    /// with the occupancies of the states that are alive.
    pub fn backward_each(
        &self,
        graph: &Graph,
        probability: &[f64],
        mut frame: impl FnMut(usize, usize, &[f64]),
        mut arc: impl FnMut(usize, usize, f64),
    ) {
        let (frames, n) = self.alpha.dim();
        if frames == 0 {
            return;
        }
        let mut beta = self.last_beta(graph);
        let mut before = vec![0.0; n];
        let mut gamma = vec![0.0; n];
        for t in (0..frames).rev() {
            let alpha = self.alpha.row(t);
            if t + 1 < frames {
                self.step_back(graph, probability, t, &mut beta, &mut before, |s, index, part| {
                    arc(t, index, alpha[s] * part);
                });
                std::mem::swap(&mut beta, &mut before);
            }
            let alive = self.window[t].states();
            for s in alive.clone() {
                gamma[s] = alpha[s] * beta[s];
            }
            frame(t, alive.start, &gamma[alive]);
        }
    }

    /// Occupancies when only `lag` frames after each frame are known: P(q_t | o_1..t+lag).
    pub fn fixed_lag(&self, graph: &Graph, probability: &[f64], lag: usize) -> Array2<f64> {
        let (frames, n) = self.alpha.dim();
        let mut gamma = Array2::zeros((frames, n));
        let (mut beta, mut before) = (vec![0.0; n], vec![0.0; n]);
        for t in 0..frames {
            let end = (t + lag).min(frames - 1);
            if end == frames - 1 {
                beta.copy_from_slice(&self.last_beta(graph));
            } else {
                beta.fill(0.0);
                beta[self.window[end].states()].fill(1.0);
            }
            before.fill(0.0);
            for u in (t..end).rev() {
                self.step_back(graph, probability, u, &mut beta, &mut before, |_, _, _| ());
                std::mem::swap(&mut beta, &mut before);
            }
            let alive = self.window[t].states();
            let sum: f64 = alive.clone().map(|s| self.alpha[[t, s]] * beta[s]).sum();
            for s in alive {
                gamma[[t, s]] = self.alpha[[t, s]] * beta[s] / sum;
            }
        }
        gamma
    }
}

/// Best path (Viterbi): a joint state per frame, and its log likelihood.
pub fn viterbi(
    graph: &Graph,
    probability: &[f64],
    frames: usize,
    emission: &impl Emission,
) -> Option<(Vec<usize>, f64)> {
    let n = graph.states.len();
    let logs: Vec<f64> = probability.iter().map(|p| p.ln()).collect();
    let mut best = vec![f64::NEG_INFINITY; n];
    for &(state, log) in &graph.entries {
        best[state] = f64::from(log);
    }
    let mut back = Array2::<u32>::zeros((frames, n));
    for t in 0..frames {
        if t > 0 {
            let mut next = vec![f64::NEG_INFINITY; n];
            for s in 0..n {
                if best[s] > f64::NEG_INFINITY {
                    for arc in graph.first[s]..graph.first[s + 1] {
                        let to = graph.arcs[arc].to as usize;
                        let score = best[s] + logs[arc];
                        if score > next[to] {
                            next[to] = score;
                            back[[t, to]] = s as u32;
                        }
                    }
                }
            }
            best = next;
        }
        for s in 0..n {
            if best[s] > f64::NEG_INFINITY {
                best[s] += emission.log(t, s);
            }
        }
    }
    let ends: Vec<usize> = graph.exits.clone().unwrap_or_else(|| (0..n).collect());
    let end = ends.into_iter().max_by(|&a, &b| best[a].total_cmp(&best[b]))?;
    if best[end] == f64::NEG_INFINITY || frames == 0 {
        return None;
    }
    let mut path = vec![end; frames];
    for t in (1..frames).rev() {
        path[t - 1] = back[[t, path[t]]] as usize;
    }
    Some((path, best[end]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hmm::network::PhoneNetwork;
    use crate::hmm::topology::Topology;
    use crate::phones::Phone;
    use ndarray::Array3;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    struct Tiny {
        graph: Graph,
        probability: Vec<f64>,
        log: Array2<f64>,
    }

    fn tiny(topology: Topology, frames: usize, whole: bool, seed: u64) -> Tiny {
        let mut rng = Pcg64::seed_from_u64(seed);
        let phones: Vec<Phone> = ["b", "iy", "p"].map(|n| Phone::from_name(n).unwrap()).to_vec();
        let network = if whole {
            let bigram = ndarray::Array2::from_shape_fn((3, 3), |_| (1.0f32 / 3.0).ln());
            PhoneNetwork::phone_loop(&[(1.0f32 / 3.0).ln(); 3], &bigram)
        } else {
            PhoneNetwork::chain(&[0, 1])
        };
        let graph = Graph::build(&network, topology, &phones);
        let table = Array3::from_shape_fn((3, topology.classes_per_phone(), 4), |(_, class, choice)| {
            if topology.allowed(class)[choice] {
                rng.random_range(0.1f32..1.0).ln()
            } else {
                -1e9
            }
        });
        let probability = graph.probabilities(&table);
        let log = Array2::from_shape_fn((frames, graph.states.len()), |_| rng.random_range(-3.0..0.0));
        Tiny {
            graph,
            probability,
            log,
        }
    }

    /// Likelihood, occupancies and arc occupancies by walking every path.
    fn enumerate(tiny: &Tiny) -> (f64, Array2<f64>, Vec<f64>) {
        let (frames, n) = tiny.log.dim();
        let mut total = 0.0;
        let mut gamma = Array2::zeros((frames, n));
        let mut xi = vec![0.0; tiny.graph.arcs.len()];
        let mut stack: Vec<(Vec<usize>, Vec<usize>, f64)> = tiny
            .graph
            .entries
            .iter()
            .map(|&(s, w)| (vec![s], Vec::new(), f64::from(w).exp() * tiny.log[[0, s]].exp()))
            .collect();
        while let Some((path, arcs, p)) = stack.pop() {
            let last = path[path.len() - 1];
            if path.len() == frames {
                if tiny.graph.exits.as_ref().is_none_or(|e| e.contains(&last)) {
                    total += p;
                    path.iter().enumerate().for_each(|(t, &s)| gamma[[t, s]] += p);
                    arcs.iter().for_each(|&a| xi[a] += p);
                }
                continue;
            }
            for arc in tiny.graph.first[last]..tiny.graph.first[last + 1] {
                let to = tiny.graph.arcs[arc].to as usize;
                let q = p * tiny.probability[arc] * tiny.log[[path.len(), to]].exp();
                let (mut path, mut arcs) = (path.clone(), arcs.clone());
                path.push(to);
                arcs.push(arc);
                stack.push((path, arcs, q));
            }
        }
        (total, gamma / total, xi.into_iter().map(|x| x / total).collect())
    }

    #[test]
    fn brute_force_agrees() {
        for (topology, frames, whole) in [
            (Topology::PH_VI_CHMM, 11, false),
            (Topology::PH_VI_CHMM, 5, true),
            (Topology::PH_HMM, 12, false),
            (Topology::PH_HMM, 7, true),
        ] {
            let tiny = tiny(topology, frames, whole, 7);
            let (total, gamma, xi) = enumerate(&tiny);
            let emission = |t: usize, s: usize| tiny.log[[t, s]];
            let f = forward(&tiny.graph, &tiny.probability, frames, &emission).unwrap();
            assert!((f.log_likelihood - total.ln()).abs() < 1e-9);
            let mut arcs = vec![0.0; xi.len()];
            let g = f.backward(&tiny.graph, &tiny.probability, |_, a, x| arcs[a] += x);
            assert!((&g - &gamma).iter().all(|d| d.abs() < 1e-9));
            assert!(arcs.iter().zip(&xi).all(|(a, b)| (a - b).abs() < 1e-9));
            let long = f.fixed_lag(&tiny.graph, &tiny.probability, frames);
            assert!((&long - &gamma).iter().all(|d| d.abs() < 1e-9));
        }
    }

    /// ln Σ exp of two.
    fn log_add(a: f64, b: f64) -> f64 {
        let (low, high) = if a < b { (a, b) } else { (b, a) };
        if low == f64::NEG_INFINITY {
            return high;
        }
        high + (low - high).exp().ln_1p()
    }

    #[test]
    fn what_no_number_can_carry_does_not_count() {
        // Emissions as far apart as those of speech (the right state some 25 nats above the others, sometimes below):
        // here most states die in every frame. The reference keeps every state of every frame, in logarithms.
        let mut rng = Pcg64::seed_from_u64(8);
        let phones: Vec<Phone> = Phone::all().take(9).collect();
        let said: Vec<usize> = (0..20).map(|_| rng.random_range(0..9)).collect();
        let graph = Graph::build(&PhoneNetwork::chain(&said), Topology::PH_HMM, &phones);
        let n = graph.states.len();
        let table = crate::hmm::em::start_transitions(Topology::PH_HMM, 9);
        let probability = graph.probabilities(&table);
        let path: Vec<usize> = (0..n)
            .flat_map(|s| std::iter::repeat_n(s, rng.random_range(1..5)))
            .collect();
        let frames = path.len();
        let log = Array2::from_shape_fn((frames, n), |(t, s)| {
            rng.random_range(-50.0..-20.0) + if s == path[t] { 20.0 } else { 0.0 }
        });
        let f = forward(&graph, &probability, frames, &|t: usize, s: usize| log[[t, s]]).unwrap();
        let mut sums = vec![0.0; graph.arcs.len()];
        let gamma = f.backward(&graph, &probability, |_, a, xi| sums[a] += xi);
        let alive = f.alpha.iter().filter(|a| **a > 0.0).count();
        assert!(alive * 3 < frames * n, "{alive} of {}", frames * n);

        let mut ahead = Array2::from_elem((frames, n), f64::NEG_INFINITY);
        let mut after = ahead.clone();
        ahead[[0, 0]] = log[[0, 0]];
        after[[frames - 1, n - 1]] = 0.0;
        for t in 1..frames {
            for (arc, p) in graph.arcs.iter().zip(&probability) {
                let (from, to) = (arc.from as usize, arc.to as usize);
                ahead[[t, to]] = log_add(ahead[[t, to]], ahead[[t - 1, from]] + p.ln() + log[[t, to]]);
            }
            let u = frames - 1 - t;
            for (arc, p) in graph.arcs.iter().zip(&probability) {
                let (from, to) = (arc.from as usize, arc.to as usize);
                after[[u, from]] = log_add(after[[u, from]], p.ln() + log[[u + 1, to]] + after[[u + 1, to]]);
            }
        }
        let total = ahead[[frames - 1, n - 1]];
        assert!((total - f.log_likelihood).abs() < 1e-9 * total.abs());
        for t in 0..frames {
            for s in 0..n {
                let want = (ahead[[t, s]] + after[[t, s]] - total).exp();
                assert!((gamma[[t, s]] - want).abs() < 1e-9, "{t} {s}");
            }
        }
    }

    #[test]
    fn no_lag_is_the_forward_variable() {
        let tiny = tiny(Topology::PH_VI_CHMM, 6, true, 3);
        let emission = |t: usize, s: usize| tiny.log[[t, s]];
        let f = forward(&tiny.graph, &tiny.probability, 6, &emission).unwrap();
        let g = f.fixed_lag(&tiny.graph, &tiny.probability, 0);
        assert!((&g - &f.alpha).iter().all(|d| d.abs() < 1e-12));
    }

    #[test]
    fn the_best_path_is_the_best_of_all() {
        let tiny = tiny(Topology::PH_VI_CHMM, 10, false, 5);
        let emission = |t: usize, s: usize| tiny.log[[t, s]];
        let (path, log) = viterbi(&tiny.graph, &tiny.probability, 10, &emission).unwrap();
        // By hand: the path's own probability, and no neighbour at a single frame is better.
        let score = |path: &[usize]| -> f64 {
            let mut p = f64::from(
                tiny.graph
                    .entries
                    .iter()
                    .find(|e| e.0 == path[0])
                    .map_or(f32::NEG_INFINITY, |e| e.1),
            );
            for t in 0..path.len() {
                p += tiny.log[[t, path[t]]];
                if t > 0 {
                    let arc = (tiny.graph.first[path[t - 1]]..tiny.graph.first[path[t - 1] + 1])
                        .find(|&a| tiny.graph.arcs[a].to as usize == path[t]);
                    p += arc.map_or(f64::NEG_INFINITY, |a| tiny.probability[a].ln());
                }
            }
            p
        };
        assert!((score(&path) - log).abs() < 1e-9);
        for t in 0..10 {
            for s in 0..tiny.graph.states.len() {
                let mut other = path.clone();
                other[t] = s;
                if tiny.graph.exits.as_ref().unwrap().contains(&other[9]) {
                    assert!(score(&other) <= log + 1e-9);
                }
            }
        }
    }

    #[test]
    fn just_long_enough_is_long_enough() {
        // Ten frames for ten states: one diagonal path and its neighbours, however unlikely each step is.
        let mut tiny = tiny(Topology::PH_HMM, 10, false, 2);
        tiny.log
            .indexed_iter_mut()
            .for_each(|((t, s), l)| *l = if s == t { -400.0 } else { 0.0 });
        let emission = |t: usize, s: usize| tiny.log[[t, s]];
        let f = forward(&tiny.graph, &tiny.probability, 10, &emission).unwrap();
        let g = f.backward(&tiny.graph, &tiny.probability, |_, _, _| ());
        (0..10).for_each(|t| assert!((g[[t, t]] - 1.0).abs() < 1e-9));
    }

    #[test]
    fn too_short_an_utterance_has_no_path() {
        let tiny = tiny(Topology::PH_VI_CHMM, 9, false, 1);
        let emission = |t: usize, s: usize| tiny.log[[t, s]];
        assert!(forward(&tiny.graph, &tiny.probability, 9, &emission).is_none());
        assert!(viterbi(&tiny.graph, &tiny.probability, 9, &emission).is_none());
    }
}
