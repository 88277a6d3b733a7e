//! Mixtures of diagonal Gaussians (X&L eq. 1): accumulators, re-estimation (eq. A.12-A.14), splitting.
use ndarray::{Array1, Array2, Array3, Axis};
use rand::RngExt;
use rand_pcg::Pcg64;

use lipstream::hmm::mixtures::Mixtures;

/// Every number of an observation with its square.
pub fn powers(observation: &[f32]) -> impl Iterator<Item = [f64; 2]> + '_ {
    observation.iter().map(|&x| {
        let x = f64::from(x);
        [x, x * x]
    })
}

/// Sums of the E step; two of them add up to the sums of both data.
#[derive(Clone, Debug, PartialEq)]
pub struct Accumulator {
    /// Σγ, `[states, K]`
    pub occupancy: Array2<f64>,
    /// Σγ·o, `[states, K, dimensions]`
    pub first: Array3<f64>,
    /// Σγ·o²
    pub second: Array3<f64>,
}

impl Accumulator {
    /// Empty sums for so many states, components a state, and numbers in an observation.
    pub fn new(states: usize, components: usize, dimensions: usize) -> Self {
        Self {
            occupancy: Array2::zeros((states, components)),
            first: Array3::zeros((states, components, dimensions)),
            second: Array3::zeros((states, components, dimensions)),
        }
    }

    /// Empty sums of the shape of `mixtures`.
    pub fn for_mixtures(mixtures: &Mixtures) -> Self {
        let (s, k, d) = mixtures.mean.dim();
        Self::new(s, k, d)
    }

    /// Adds an observation with occupancy γ(s, k).
    pub fn add(&mut self, state: usize, component: usize, occupancy: f64, observation: &[f32]) {
        let powers: Vec<[f64; 2]> = powers(observation).collect();
        self.add_powers(state, component, occupancy, &powers);
    }

    /// [`Accumulator::add`] of an observation whose [`powers`] are at hand.
    pub fn add_powers(&mut self, state: usize, component: usize, occupancy: f64, powers: &[[f64; 2]]) {
        let (_, components, d) = self.first.dim();
        let row = state * components + component;
        self.occupancy[[state, component]] += occupancy;
        let (Some(first), Some(second)) = (self.first.as_slice_mut(), self.second.as_slice_mut()) else {
            unreachable!("sums are made in standard layout");
        };
        let first = &mut first[row * d..][..d];
        let second = &mut second[row * d..][..d];
        for ((first, second), [x, square]) in first.iter_mut().zip(second).zip(powers) {
            *first += occupancy * x;
            *second += occupancy * square;
        }
    }

    /// Adds the sums of other data; both have the same shape.
    pub fn merge(&mut self, other: &Accumulator) {
        self.occupancy += &other.occupancy;
        self.first += &other.first;
        self.second += &other.second;
    }

    /// Mean and variance of all that was added, over all states.
    pub fn pooled(&self) -> (Array1<f64>, Array1<f64>) {
        let total = self.occupancy.sum().max(f64::MIN_POSITIVE);
        let mean = self.first.sum_axis(Axis(0)).sum_axis(Axis(0)) / total;
        let square = self.second.sum_axis(Axis(0)).sum_axis(Axis(0)) / total;
        let variance = &square - &(&mean * &mean);
        (mean, variance)
    }
}

/// Variances and occupancies below which the data say nothing.
#[derive(Clone, Debug, PartialEq)]
pub struct Floors {
    /// Smallest variance per dimension.
    pub variance: Array1<f32>,
    /// A component seen less than this many frames keeps what it had.
    pub occupancy: f64,
}

impl Floors {
    /// `share` of the pooled variance (0.01 as HTK's vFloors), and three frames.
    pub fn from_pooled(variance: &Array1<f64>, share: f64) -> Self {
        Self {
            variance: variance.mapv(|v| (v * share).max(1e-6) as f32),
            occupancy: 3.0,
        }
    }
}

/// M step (eq. A.12-A.14, the variance of the diagonal). Components with too little data keep their old values.
pub fn reestimate(mixtures: &mut Mixtures, sums: &Accumulator, floors: &Floors) {
    let (states, components, dimensions) = mixtures.mean.dim();
    for s in 0..states {
        let total: f64 = sums.occupancy.row(s).sum();
        if total < floors.occupancy {
            continue;
        }
        for k in 0..components {
            let n = sums.occupancy[[s, k]];
            mixtures.log_weight[[s, k]] = if n > 0.0 {
                (n / total).ln().max(-1e3) as f32
            } else {
                Mixtures::NO_WEIGHT
            };
            if n < floors.occupancy {
                continue;
            }
            for i in 0..dimensions {
                let mean = sums.first[[s, k, i]] / n;
                let variance = sums.second[[s, k, i]] / n - mean * mean;
                mixtures.mean[[s, k, i]] = mean as f32;
                mixtures.variance[[s, k, i]] = (variance as f32).max(floors.variance[i]);
            }
        }
    }
}

/// Doubles the number of components: each becomes two, ±0.2 standard deviations apart (HTK's MU).
///
/// A component with fewer than `enough` frames in `sums` is not split; its other half has no weight. `signs` draws the
/// direction along every dimension; without it the components part along the diagonal.
pub fn split(
    mixtures: &Mixtures,
    sums: &Accumulator,
    enough: f64,
    mut signs: Option<&mut Pcg64>,
) -> Mixtures {
    let (states, components, dimensions) = mixtures.mean.dim();
    let mut out = Mixtures {
        mean: Array3::zeros((states, 2 * components, dimensions)),
        variance: Array3::ones((states, 2 * components, dimensions)),
        log_weight: Array2::from_elem((states, 2 * components), Mixtures::NO_WEIGHT),
    };
    for s in 0..states {
        for k in 0..components {
            let divide =
                sums.occupancy[[s, k]] >= enough && mixtures.log_weight[[s, k]] > Mixtures::NO_WEIGHT;
            let side: Vec<f32> = (0..dimensions)
                .map(|_| {
                    let reversed = signs.as_mut().is_some_and(|rng| rng.random_bool(0.5));
                    if reversed { -0.2 } else { 0.2 }
                })
                .collect();
            for half in 0..2 {
                let to = 2 * k + half;
                for i in 0..dimensions {
                    let variance = mixtures.variance[[s, k, i]];
                    let side = if half == 0 { side[i] } else { -side[i] };
                    let shift = if divide { side * variance.sqrt() } else { 0.0 };
                    out.mean[[s, to, i]] = mixtures.mean[[s, k, i]] + shift;
                    out.variance[[s, to, i]] = variance;
                }
                out.log_weight[[s, to]] = match (divide, half) {
                    (true, _) => mixtures.log_weight[[s, k]] - std::f32::consts::LN_2,
                    (false, 0) => mixtures.log_weight[[s, k]],
                    (false, _) => Mixtures::NO_WEIGHT,
                };
            }
        }
    }
    out
}

/// One Gaussian per state, all alike: the flat start.
pub fn flat(states: usize, mean: &Array1<f64>, variance: &Array1<f64>, floors: &Floors) -> Mixtures {
    let d = mean.len();
    Mixtures {
        mean: Array3::from_shape_fn((states, 1, d), |(_, _, i)| mean[i] as f32),
        variance: Array3::from_shape_fn((states, 1, d), |(_, _, i)| {
            (variance[i] as f32).max(floors.variance[i])
        }),
        log_weight: Array2::zeros((states, 1)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two_components() -> Mixtures {
        Mixtures {
            mean: ndarray::array![[[0.0, 1.0], [2.0, -1.0]]],
            variance: ndarray::array![[[1.0, 0.5], [2.0, 1.0]]],
            log_weight: ndarray::array![[0.25f32.ln(), 0.75f32.ln()]],
        }
    }

    #[test]
    fn merged_sums_are_the_sums_of_all() {
        let mut whole = Accumulator::new(2, 1, 2);
        let (mut a, mut b) = (whole.clone(), whole.clone());
        for (n, x) in [[1.0, 2.0], [3.0, -1.0], [0.5, 0.25]].iter().enumerate() {
            let part = if n < 1 { &mut a } else { &mut b };
            part.add(n % 2, 0, 0.5, x);
            whole.add(n % 2, 0, 0.5, x);
        }
        a.merge(&b);
        assert_eq!(a, whole);
    }

    #[test]
    fn reestimation_recovers_mean_and_variance() {
        let mut sums = Accumulator::new(1, 1, 1);
        for x in [1.0, 2.0, 3.0, 4.0] {
            sums.add(0, 0, 1.0, &[x]);
        }
        let floors = Floors {
            variance: ndarray::array![0.01],
            occupancy: 3.0,
        };
        let mut m = flat(1, &ndarray::array![0.0], &ndarray::array![1.0], &floors);
        reestimate(&mut m, &sums, &floors);
        assert!((m.mean[[0, 0, 0]] - 2.5).abs() < 1e-6 && (m.variance[[0, 0, 0]] - 1.25).abs() < 1e-6);
    }

    #[test]
    fn a_state_seen_once_keeps_its_values_and_a_constant_is_floored() {
        let floors = Floors {
            variance: ndarray::array![0.5],
            occupancy: 3.0,
        };
        let mut m = flat(2, &ndarray::array![7.0], &ndarray::array![1.0], &floors);
        let mut sums = Accumulator::new(2, 1, 1);
        sums.add(0, 0, 1.0, &[100.0]);
        for _ in 0..5 {
            sums.add(1, 0, 1.0, &[3.0]);
        }
        reestimate(&mut m, &sums, &floors);
        assert_eq!(m.mean[[0, 0, 0]], 7.0);
        assert_eq!((m.mean[[1, 0, 0]], m.variance[[1, 0, 0]]), (3.0, 0.5));
    }

    #[test]
    fn splitting_keeps_the_total_weight() {
        let m = two_components();
        let mut sums = Accumulator::for_mixtures(&m);
        sums.occupancy.fill(100.0);
        sums.occupancy[[0, 1]] = 1.0;
        let halves = split(&m, &sums, 10.0, None);
        let total: f32 = halves.log_weight.iter().map(|w| w.exp()).sum();
        assert!((total - 1.0).abs() < 1e-6);
        assert_eq!(halves.log_weight[[0, 3]], Mixtures::NO_WEIGHT);
    }
}
