//! Forward-backward over the arcs of a joint-state graph (X&L eq. A.1-A.11), scaled frame by frame.
//!
//! Scaling: the forward variable of every frame sums to one, so it is P(q_t | o_1..t); what it was divided by adds up
//! to the log likelihood.
//!
//! Nothing is pruned but what a double-precision number could not carry anyway: states whose forward variable is below
//! `NOTHING`. In a left-right graph that alone leaves a narrow band of states alive in each frame; only they are
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
    /// Natural log of the emission of joint state `state` at frame `t`.
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
    forward_from(graph, probability, None, frames, emission)
}

/// [`forward`] on from the forward variables `before` of the frame before; none: from the graph's entries.
pub fn forward_from(
    graph: &Graph,
    probability: &[f64],
    before: Option<&[f64]>,
    frames: usize,
    emission: &impl Emission,
) -> Option<Forward> {
    let n = graph.states.len();
    let mut alpha = Array2::<f64>::zeros((frames, n));
    let mut scaled = Array2::<f64>::zeros((frames, n));
    let mut window = vec![Window::EMPTY; frames];
    let mut predicted = vec![0.0f64; n];
    let predict = |from: std::ops::Range<usize>, before: &[f64], predicted: &mut [f64]| {
        let mut reached = Window::EMPTY;
        for s in from {
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
        reached
    };
    let mut reached = Window::EMPTY;
    match before {
        Some(before) => reached = predict(0..n, before, &mut predicted),
        None => {
            for &(state, log) in &graph.entries {
                predicted[state] += f64::from(log).exp();
                reached.take_in(state);
            }
        }
    }
    let to_exit = frames_to_exit(graph);
    let mut log_likelihood = 0.0;
    let mut logs = vec![0.0f64; n];
    let mut emitted = vec![0.0f64; n];
    for t in 0..frames {
        if t > 0 {
            let before = alpha.row(t - 1);
            let before = before.as_slice().unwrap_or(&[]);
            reached = predict(window[t - 1].states(), before, &mut predicted);
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
    let best = BestPaths::find(graph, probability, frames, emission, None);
    let ends: Vec<usize> = graph
        .exits
        .clone()
        .unwrap_or_else(|| (0..best.last.len()).collect());
    let end = ends
        .into_iter()
        .max_by(|&a, &b| best.last[a].total_cmp(&best.last[b]))?;
    if best.last[end] == f64::NEG_INFINITY || frames == 0 {
        return None;
    }
    Some((best.path(frames - 1, end, frames), best.last[end]))
}

/// The state of every frame on the path that was best `lag` frames later: what a stream can know.
pub fn viterbi_within(
    graph: &Graph,
    probability: &[f64],
    frames: usize,
    emission: &impl Emission,
    lag: usize,
) -> Option<Vec<usize>> {
    let mut leaders = Vec::with_capacity(frames);
    let best = BestPaths::find(graph, probability, frames, emission, Some(&mut leaders));
    if leaders.iter().any(Option::is_none) {
        return None;
    }
    let path = (0..frames).map(|t| {
        let end = (t + lag).min(frames - 1);
        let leader = leaders[end].unwrap_or_default();
        best.path(end, leader, end - t + 1)[0]
    });
    Some(path.collect())
}

/// The best path into every state.
struct BestPaths {
    /// State before, `[frames, states]`.
    back: Array2<u32>,
    /// Log likelihood of the best path into each state of the last frame.
    last: Vec<f64>,
}

impl BestPaths {
    /// `leaders` receives the best state of every frame, none where no path is left.
    fn find(
        graph: &Graph,
        probability: &[f64],
        frames: usize,
        emission: &impl Emission,
        mut leaders: Option<&mut Vec<Option<usize>>>,
    ) -> Self {
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
            if let Some(leaders) = &mut leaders {
                let leader = (0..n).max_by(|&a, &b| best[a].total_cmp(&best[b]));
                leaders.push(leader.filter(|l| best[*l] > f64::NEG_INFINITY));
            }
        }
        Self { back, last: best }
    }

    /// The last `length` states of the path that ends at frame `t` in `end`.
    fn path(&self, t: usize, end: usize, length: usize) -> Vec<usize> {
        let mut path = vec![end; length];
        for i in (1..length).rev() {
            path[i - 1] = self.back[[t + 1 + i - length, path[i]]] as usize;
        }
        path
    }
}

#[cfg(test)]
mod tests;
