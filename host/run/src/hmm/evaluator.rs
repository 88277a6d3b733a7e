//! Likelihoods of mixtures (X&L eq. 1), sixteen frames at a time.
//!
//! A block holds the same number of sixteen frames side by side, so that one Gaussian is a loop over lanes that any
//! compiler turns into vector instructions, whatever the number of components is. Every lane adds its squared distances in
//! the order of the dimensions: the result does not depend on the width of the machine's vectors.
use std::cell::{Cell, RefCell};

use ndarray::{Array2, Array3, ArrayView2};

use crate::hmm::mixtures::Mixtures;

/// Frames in a block.
pub const BLOCK: usize = 16;

/// One number of sixteen frames.
pub type Lanes = [f32; BLOCK];

/// A mixture set made ready for likelihoods: precisions and constants computed once.
pub struct Evaluator {
    dimensions: usize,
    components: usize,
    /// `[state][component]`: ln w − ½ Σ ln 2πσ².
    constant: Vec<f32>,
    /// `[state][component][dimension]`: μ and ½/σ².
    gaussian: Vec<[f32; 2]>,
    /// Whether this machine has the vectors that [`wide`] is compiled for.
    #[cfg(target_arch = "x86_64")]
    wide: bool,
}

impl Evaluator {
    /// Makes `mixtures` ready.
    pub fn new(mixtures: &Mixtures) -> Self {
        let (states, components, dimensions) = mixtures.mean.dim();
        let mut constant = Vec::with_capacity(states * components);
        for s in 0..states {
            for k in 0..components {
                let log_det: f32 = mixtures
                    .variance
                    .slice(ndarray::s![s, k, ..])
                    .iter()
                    .map(|v| (std::f32::consts::TAU * v).ln())
                    .sum();
                let weight = mixtures.log_weight[[s, k]];
                constant.push(if weight <= Mixtures::NO_WEIGHT {
                    f32::NEG_INFINITY
                } else {
                    weight - 0.5 * log_det
                });
            }
        }
        let pairs = mixtures.mean.iter().zip(&mixtures.variance);
        Self {
            dimensions,
            components,
            constant,
            gaussian: pairs.map(|(&mean, &variance)| [mean, 0.5 / variance]).collect(),
            #[cfg(target_arch = "x86_64")]
            wide: is_x86_feature_detected!("avx2"),
        }
    }

    /// Components K of each state's mixture.
    pub fn components(&self) -> usize {
        self.components
    }

    /// ln w_k N(o; μ_k, Σ_k) of every component of a state at sixteen frames, into `parts[..components]`; returns their
    /// log sums. −∞ where a state has no component.
    fn log_block(&self, state: usize, observations: &[Lanes], parts: &mut [Lanes]) -> Lanes {
        #[cfg(target_arch = "x86_64")]
        if self.wide {
            return wide::log_block(self, state, observations, parts);
        }
        self.log_block_plain(state, observations, parts)
    }

    #[inline(always)]
    fn log_block_plain(&self, state: usize, observations: &[Lanes], parts: &mut [Lanes]) -> Lanes {
        let d = self.dimensions;
        let rows = state * self.components..(state + 1) * self.components;
        let mut max = [f32::NEG_INFINITY; BLOCK];
        let mut used = 0;
        for (row, part) in rows.zip(parts.iter_mut()) {
            let constant = self.constant[row];
            *part = [constant; BLOCK];
            if constant == f32::NEG_INFINITY {
                continue;
            }
            used += 1;
            let mut distance = [0.0f32; BLOCK];
            for (x, &[mean, precision]) in observations.iter().zip(&self.gaussian[row * d..][..d]) {
                for lane in 0..BLOCK {
                    let z = x[lane] - mean;
                    distance[lane] += z * z * precision;
                }
            }
            for lane in 0..BLOCK {
                part[lane] -= distance[lane];
                max[lane] = if part[lane] > max[lane] {
                    part[lane]
                } else {
                    max[lane]
                };
            }
        }
        if used < 2 {
            return max;
        }
        let mut sum = [0.0f32; BLOCK];
        for part in parts.iter() {
            if part[0] > f32::NEG_INFINITY {
                for lane in 0..BLOCK {
                    sum[lane] += exp(part[lane] - max[lane]);
                }
            }
        }
        let mut total = max;
        for lane in 0..BLOCK {
            total[lane] += sum[lane].ln();
        }
        total
    }

    /// ln b_s(o) for the listed states at every frame, `[frames, states]`.
    pub fn log_likelihoods(&self, states: &[usize], observations: ArrayView2<f32>) -> Array2<f32> {
        let mut out = Array2::zeros((observations.nrows(), states.len()));
        let mut parts = vec![[0.0; BLOCK]; self.components];
        let blocks = Blocks::new(observations);
        for block in 0..blocks.len() {
            for (column, &state) in states.iter().enumerate() {
                let total = self.log_block(state, blocks.block(block), &mut parts);
                let from = block * BLOCK;
                for t in from..(from + BLOCK).min(observations.nrows()) {
                    out[[t, column]] = total[t - from];
                }
            }
        }
        out
    }

    /// ln b_s(o) of every state `[frames, states]`, and ln w_k N(o; μ_k, Σ_k) of every component
    /// `[frames, states, K]`.
    pub fn log_components(&self, observations: ArrayView2<f32>) -> (Array2<f32>, Array3<f32>) {
        let (frames, states) = (observations.nrows(), self.constant.len() / self.components.max(1));
        let mut totals = Array2::zeros((frames, states));
        let mut all = Array3::zeros((frames, states, self.components));
        let mut parts = vec![[0.0; BLOCK]; self.components];
        let blocks = Blocks::new(observations);
        for block in 0..blocks.len() {
            let from = block * BLOCK;
            for state in 0..states {
                let total = self.log_block(state, blocks.block(block), &mut parts);
                for t in from..(from + BLOCK).min(frames) {
                    totals[[t, state]] = total[t - from];
                    for (k, part) in parts.iter().enumerate() {
                        all[[t, state, k]] = part[t - from];
                    }
                }
            }
        }
        (totals, all)
    }
}

/// The same source compiled for wider vectors. Multiplications and additions stay apart, so the bytes are the same (a
/// test holds the two against each other); it is about twice as fast.
#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
mod wide {
    use super::{Evaluator, Lanes};

    pub(super) fn log_block(
        evaluator: &Evaluator,
        state: usize,
        observations: &[Lanes],
        parts: &mut [Lanes],
    ) -> Lanes {
        debug_assert!(evaluator.wide);
        // SAFETY: `wide` is set only where the processor was found to have AVX2.
        unsafe { with_avx2(evaluator, state, observations, parts) }
    }

    #[target_feature(enable = "avx2")]
    fn with_avx2(evaluator: &Evaluator, state: usize, observations: &[Lanes], parts: &mut [Lanes]) -> Lanes {
        evaluator.log_block_plain(state, observations, parts)
    }
}

/// e^x for x ≤ 0 in plain arithmetic; relative error below 3e-7 (asserted by a test), below −87 as at −87.
///
/// x = (n + f) ln 2 with n whole and |f| ≤ ½: 2^n goes into the exponent's bits, e^(f ln 2) is a polynomial.
#[inline(always)]
fn exp(x: f32) -> f32 {
    /// Adding 1.5·2²³ rounds to a whole number, which then stands in the low bits.
    const ROUND: f32 = 12_582_912.0;
    // ln 2 in two parts, so that n times the first is exact.
    const LN_2_HIGH: f32 = 0.693_359_4; // 355/512
    const LN_2_LOW: f32 = -2.121_944_4e-4;
    let x = if x < -87.0 { -87.0 } else { x };
    let rounded = x * std::f32::consts::LOG2_E + ROUND;
    let n = rounded - ROUND;
    let f = x - n * LN_2_HIGH - n * LN_2_LOW;
    let tail = 1.0 / 6.0 + f * (1.0 / 24.0 + f * (1.0 / 120.0 + f * (1.0 / 720.0)));
    let polynomial = 1.0 + f * (1.0 + f * (0.5 + f * tail));
    let power = f32::from_bits(rounded.to_bits().wrapping_add(127) << 23);
    polynomial * power
}

/// Observations with sixteen frames side by side; the last block is filled up with the last frame.
pub struct Blocks {
    dimensions: usize,
    lanes: Vec<Lanes>,
}

impl Blocks {
    /// Takes `[frames, dimensions]` of at least one frame.
    pub fn new(observations: ArrayView2<f32>) -> Self {
        let (frames, dimensions) = observations.dim();
        let blocks = frames.div_ceil(BLOCK);
        let mut lanes = vec![[0.0; BLOCK]; blocks * dimensions];
        for t in 0..blocks * BLOCK {
            let row = observations.row(t.min(frames - 1));
            let block = &mut lanes[t / BLOCK * dimensions..];
            for (to, &x) in block.iter_mut().zip(row) {
                to[t % BLOCK] = x;
            }
        }
        Self { dimensions, lanes }
    }

    /// Number of blocks.
    pub fn len(&self) -> usize {
        self.lanes.len() / self.dimensions.max(1)
    }

    /// Whether there is no block.
    pub fn is_empty(&self) -> bool {
        self.lanes.is_empty()
    }

    fn block(&self, block: usize) -> &[Lanes] {
        &self.lanes[block * self.dimensions..][..self.dimensions]
    }
}

/// Likelihoods of an utterance in the states of its graph, computed when they are first asked for and kept with their
/// components.
pub struct Likelihoods<'a> {
    evaluator: &'a Evaluator,
    blocks: Blocks,
    /// State of the model in each column.
    states: Vec<usize>,
    /// Column of each joint state.
    column: Vec<usize>,
    /// `[column][block]`: where the block's numbers begin in `log` and, times the components, in `parts`; 0 for not yet.
    place: Vec<Cell<u32>>,
    kept: RefCell<Kept>,
}

#[derive(Default)]
struct Kept {
    log: Vec<Lanes>,
    parts: Vec<Lanes>,
}

impl<'a> Likelihoods<'a> {
    /// `of` names the model's state of each joint state.
    pub fn new(
        of: impl Iterator<Item = usize> + Clone,
        evaluator: &'a Evaluator,
        observations: ArrayView2<f32>,
    ) -> Self {
        let mut states: Vec<usize> = of.clone().collect();
        states.sort_unstable();
        states.dedup();
        let column = of
            .map(|s| states.binary_search(&s).expect("the state was just collected"))
            .collect();
        let blocks = Blocks::new(observations);
        Self {
            evaluator,
            place: vec![Cell::new(0); states.len() * blocks.len()],
            blocks,
            states,
            column,
            kept: RefCell::default(),
        }
    }

    /// The model's states that the graph has.
    pub fn states(&self) -> &[usize] {
        &self.states
    }

    /// Column (place in [`Likelihoods::states`]) of a joint state.
    pub fn column(&self, joint: usize) -> usize {
        self.column[joint]
    }

    /// Place of a block, computed if it is not there.
    fn place(&self, column: usize, block: usize) -> usize {
        let place = &self.place[column * self.blocks.len() + block];
        if place.get() == 0 {
            let k = self.evaluator.components;
            let mut kept = self.kept.borrow_mut();
            let at = kept.log.len();
            kept.parts.resize((at + 1) * k, [0.0; BLOCK]);
            let total = self.evaluator.log_block(
                self.states[column],
                self.blocks.block(block),
                &mut kept.parts[at * k..],
            );
            kept.log.push(total);
            place.set(at as u32 + 1);
        }
        place.get() as usize - 1
    }

    /// ln b(o_t) of a joint state.
    pub fn log(&self, t: usize, joint: usize) -> f32 {
        let place = self.place(self.column[joint], t / BLOCK);
        self.kept.borrow().log[place][t % BLOCK]
    }

    /// Calls `share(k, P(k | o_t, state))` for every component of a column's state (eq. A.15).
    pub fn shares(&self, t: usize, column: usize, mut share: impl FnMut(usize, f64)) {
        let k = self.evaluator.components;
        let place = self.place(column, t / BLOCK);
        let kept = self.kept.borrow();
        if k == 1 {
            return share(0, 1.0);
        }
        let total = kept.log[place][t % BLOCK];
        for (k, part) in kept.parts[place * k..][..k].iter().enumerate() {
            let log = part[t % BLOCK] - total;
            if log > -30.0 {
                share(k, f64::from(log).exp());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two_states() -> Mixtures {
        Mixtures {
            mean: ndarray::array![[[0.0, 1.0], [2.0, -1.0]], [[1.0, 1.0], [0.0, 0.0]]],
            variance: ndarray::array![[[1.0, 0.5], [2.0, 1.0]], [[0.1, 3.0], [1.0, 1.0]]],
            log_weight: ndarray::array![[0.25f32.ln(), 0.75f32.ln()], [0.0, Mixtures::NO_WEIGHT]],
        }
    }

    fn density(m: &Mixtures, s: usize, o: &[f32]) -> f64 {
        let normal = |x: f64, m: f64, v: f64| {
            (-(x - m).powi(2) / (2.0 * v)).exp() / (std::f64::consts::TAU * v).sqrt()
        };
        (0..2)
            .map(|k| {
                let each = (0..2).map(|i| {
                    normal(
                        f64::from(o[i]),
                        f64::from(m.mean[[s, k, i]]),
                        f64::from(m.variance[[s, k, i]]),
                    )
                });
                f64::from(m.log_weight[[s, k]]).exp() * each.product::<f64>()
            })
            .sum()
    }

    #[test]
    fn likelihoods_are_the_densities() {
        let m = two_states();
        let evaluator = Evaluator::new(&m);
        // More than a block, and not a whole number of them.
        let o = Array2::from_shape_fn((37, 2), |(t, i)| ((t * 7 + 3 * i) % 11) as f32 * 0.4 - 2.0);
        let all = evaluator.log_likelihoods(&[1, 0], o.view());
        // Joint states in any order, one of them twice.
        let lazy = Likelihoods::new([0, 1, 0].into_iter(), &evaluator, o.view());
        for (t, row) in o.outer_iter().enumerate() {
            for s in 0..2 {
                let want = density(&m, s, row.as_slice().unwrap()).ln();
                assert!((f64::from(all[[t, 1 - s]]) - want).abs() < 2e-5 * want.abs().max(1.0));
                assert_eq!(lazy.log(t, s), all[[t, 1 - s]]);
                assert_eq!(lazy.log(t, 2), all[[t, 1]]);
                let mut sum = 0.0;
                lazy.shares(t, lazy.column(s), |k, share| {
                    assert!(share > 0.0 && (s == 0 || k == 0));
                    sum += share;
                });
                assert!((sum - 1.0).abs() < 1e-5, "{sum}");
            }
        }
    }

    #[test]
    #[cfg(target_arch = "x86_64")]
    fn wide_vectors_give_the_same_bytes() {
        let m = Mixtures {
            mean: ndarray::Array3::from_shape_fn((3, 5, 39), |(s, k, i)| {
                ((7 * s + 3 * k + i) % 13) as f32 * 0.3
            }),
            variance: ndarray::Array3::from_shape_fn((3, 5, 39), |(s, k, i)| {
                0.1 + ((s + 5 * k + i) % 7) as f32 * 0.3
            }),
            log_weight: Array2::from_elem((3, 5), 0.2f32.ln()),
        };
        let mut evaluator = Evaluator::new(&m);
        let o = Array2::from_shape_fn((40, 39), |(t, i)| ((t * 5 + i * i) % 17) as f32 * 0.37 - 3.0);
        let here = evaluator.log_likelihoods(&[0, 1, 2], o.view());
        evaluator.wide = false;
        assert_eq!(here, evaluator.log_likelihoods(&[0, 1, 2], o.view()));
    }

    #[test]
    fn exponential() {
        for n in 0..87_000 {
            let x = -(n as f32) / 1000.0;
            let want = f64::from(x).exp();
            assert!((f64::from(exp(x)) / want - 1.0).abs() < 3e-7, "{x}: {}", exp(x));
        }
        assert_eq!(exp(0.0), 1.0);
        assert!(exp(-1e9) < 2e-38 && exp(f32::NEG_INFINITY) < 2e-38);
    }
}
