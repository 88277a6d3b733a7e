//! How sure a mean opinion is: a bootstrap over viewers and clips at once.
//!
//! Viewers differ in how strict they are and clips in how hard they are, and other viewers and other clips would give other means. Each
//! resample therefore draws viewers and clips, both with replacement, and takes the scores that the drawn viewers gave the drawn clips
//! (A. B. Owen, "The pigeonhole bootstrap", Annals of Applied Statistics 1 (2), 2007): intervals are a little too wide rather than too
//! narrow. All systems are judged on the same draws, so that what viewers and clips have in common drops out of differences.
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;

use super::CRITERIA;
use crate::evaluate::bootstrap::{Difference, Interval, middle};

/// All scores of one test.
pub(super) struct Opinions {
    viewers: usize,
    clips: usize,
    systems: usize,
    /// `[viewer, clip, system, criterion]`.
    scores: Vec<f64>,
}

/// Means of one draw, `[system, criterion]`.
type Means = Vec<[f64; CRITERIA]>;

/// Means of all scores and of every resample.
pub(super) struct Resampled {
    whole: Means,
    drawn: Vec<Means>,
}

impl Opinions {
    /// `scores` gives what a viewer thought of a system's clip.
    pub(super) fn new(
        (viewers, clips, systems): (usize, usize, usize),
        scores: impl Fn(usize, usize, usize) -> [u8; CRITERIA],
    ) -> Self {
        let mut all = Vec::with_capacity(viewers * clips * systems * CRITERIA);
        for viewer in 0..viewers {
            for clip in 0..clips {
                for system in 0..systems {
                    all.extend(scores(viewer, clip, system).map(f64::from));
                }
            }
        }
        Self {
            viewers,
            clips,
            systems,
            scores: all,
        }
    }

    /// Means where each viewer and each clip counts so many times.
    fn means(&self, viewers: &[usize], clips: &[usize]) -> Means {
        let mut sums = vec![[0.0; CRITERIA]; self.systems];
        let of_clips = self.scores.chunks_exact(self.systems * CRITERIA);
        let times = viewers.iter().flat_map(|v| clips.iter().map(move |c| v * c));
        for (scores, times) in of_clips.zip(times).filter(|(_, times)| *times > 0) {
            for (sum, scores) in sums.iter_mut().zip(scores.as_chunks::<CRITERIA>().0) {
                for (sum, score) in sum.iter_mut().zip(scores) {
                    *sum += times as f64 * score;
                }
            }
        }
        let count = (viewers.iter().sum::<usize>() * clips.iter().sum::<usize>()) as f64;
        sums.iter_mut().flatten().for_each(|sum| *sum /= count);
        sums
    }

    /// The same seed draws the same.
    pub(super) fn resampled(&self, resamples: usize, seed: u64) -> Resampled {
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut counts = |n: usize| {
            let mut counts = vec![0; n];
            for _ in 0..n {
                counts[rng.random_range(0..n)] += 1;
            }
            counts
        };
        Resampled {
            whole: self.means(&vec![1; self.viewers], &vec![1; self.clips]),
            drawn: (0..resamples)
                .map(|_| self.means(&counts(self.viewers), &counts(self.clips)))
                .collect(),
        }
    }
}

impl Resampled {
    fn interval_of(&self, number: impl Fn(&Means) -> f64) -> Interval {
        let (low, high) = middle(self.drawn.iter().map(&number).collect());
        Interval {
            value: number(&self.whole),
            low,
            high,
        }
    }

    /// A system's mean opinion score.
    pub(super) fn mean(&self, system: usize, criterion: usize) -> Interval {
        self.interval_of(|means| means[system][criterion])
    }

    /// By how many parts in a hundred a system is better than another.
    pub(super) fn improvement(&self, system: usize, other: usize, criterion: usize) -> Interval {
        self.interval_of(|means| 100.0 * (means[system][criterion] / means[other][criterion] - 1.0))
    }

    /// A system less another. `p` is twice the share of the resamples in which the difference has the other sign or is none.
    pub(super) fn difference(&self, system: usize, other: usize, criterion: usize) -> Difference {
        let number = |means: &Means| means[system][criterion] - means[other][criterion];
        let Interval { value, low, high } = self.interval_of(number);
        let count = |holds: fn(f64) -> bool| self.drawn.iter().filter(|m| holds(number(m))).count();
        let turned = count(|d| d <= 1e-12).min(count(|d| d >= -1e-12));
        Difference {
            difference: value,
            low,
            high,
            p: (2.0 * (1 + turned) as f64 / (1 + self.drawn.len()) as f64).min(1.0),
        }
    }
}

/// Holm's correction: what each p is worth among so many (S. Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal
/// of Statistics 6, 1979).
pub(super) fn holm(p: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|&a, &b| p[a].total_cmp(&p[b]));
    let mut corrected = vec![1.0; p.len()];
    let mut largest: f64 = 0.0;
    for (rank, &k) in order.iter().enumerate() {
        largest = largest.max(p[k] * (p.len() - rank) as f64);
        corrected[k] = largest.min(1.0);
    }
    corrected
}
