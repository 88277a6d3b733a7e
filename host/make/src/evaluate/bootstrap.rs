//! How sure a score is: percentile bootstrap over clips, and a paired test of two systems on the same clips.
//!
//! A clip is the unit, because frames of one clip are anything but independent. Every system is judged on the
//! same draws, so differences are paired. The test of a difference exchanges the two systems' sums of a clip by a fair
//! coin: if both were equally good, which of them said what would not matter. Unlike a test on clip means it fits
//! any number that follows from summed scores, such as the ACC.
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::Serialize;

use super::metrics::Score;

/// Share of the resamples inside an interval.
const COVERAGE: f64 = 0.95;

/// A number with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Interval {
    /// The number measured on all clips.
    pub value: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

/// One system less another on the same clips.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// The difference measured on all clips.
    pub difference: f64,
    /// Lower end of its 95 % interval.
    pub low: f64,
    /// Upper end of its 95 % interval.
    pub high: f64,
    /// Share of exchanges with at least this difference, two-sided; never below 1/(resamples + 1).
    pub p: f64,
}

/// Which clips each resample takes, and which it exchanges: the same for every system.
pub struct Draws {
    clips: Vec<Vec<usize>>,
    exchanged: Vec<Vec<bool>>,
}

impl Draws {
    /// Makes `resamples` draws of `clips` clips, with replacement; the same seed gives the same draws.
    pub fn new(clips: usize, resamples: usize, seed: u64) -> Self {
        let mut rng = Pcg64::seed_from_u64(seed);
        let row = |rng: &mut Pcg64| (0..clips).map(|_| rng.random_range(0..clips)).collect();
        let coins = |rng: &mut Pcg64| (0..clips).map(|_| rng.random::<bool>()).collect();
        Self {
            clips: (0..resamples).map(|_| row(&mut rng)).collect(),
            exchanged: (0..resamples).map(|_| coins(&mut rng)).collect(),
        }
    }

    /// A number that follows from something of each of `clips`, in the order of the draws, with its 95 % interval.
    pub fn interval<T>(&self, clips: &[T], metric: impl Fn(&mut dyn Iterator<Item = &T>) -> f64) -> Interval {
        let drawn = self.clips.iter();
        let (low, high) = middle(
            drawn
                .map(|row| metric(&mut row.iter().map(|&c| &clips[c])))
                .collect(),
        );
        Interval {
            value: metric(&mut clips.iter()),
            low,
            high,
        }
    }
}

/// A system's score on every clip, and on every resample.
pub struct Resampled {
    clips: Vec<Score>,
    /// The score of all clips together.
    pub whole: Score,
    drawn: Vec<Score>,
}

/// Sum of scores of `size` parameters.
pub fn total<'a>(scores: impl IntoIterator<Item = &'a Score>, size: usize) -> Score {
    let mut sum = Score::new(size);
    scores.into_iter().for_each(|score| sum.merge(score));
    sum
}

impl Resampled {
    /// `clips` holds one score a clip, in the order of the draws.
    pub fn new(clips: Vec<Score>, draws: &Draws) -> Self {
        let size = clips.first().map_or(0, Score::size);
        let drawn = draws.clips.iter();
        Self {
            whole: total(&clips, size),
            drawn: drawn
                .map(|row| total(row.iter().map(|&c| &clips[c]), size))
                .collect(),
            clips,
        }
    }

    /// A number that follows from the score, with its 95 % interval over the resamples.
    pub fn interval(&self, metric: impl Fn(&Score) -> f64) -> Interval {
        let (low, high) = middle(self.drawn.iter().map(&metric).collect());
        Interval {
            value: metric(&self.whole),
            low,
            high,
        }
    }

    /// This system's number less the other's.
    pub fn against(&self, other: &Self, draws: &Draws, metric: impl Fn(&Score) -> f64) -> Difference {
        let difference = metric(&self.whole) - metric(&other.whole);
        let pairs = self.drawn.iter().zip(&other.drawn);
        let (low, high) = middle(pairs.map(|(a, b)| metric(a) - metric(b)).collect());
        let size = self.whole.size();
        let mut as_large = 0;
        for coins in &draws.exchanged {
            let (mut a, mut b) = (Score::new(size), Score::new(size));
            for ((ours, theirs), &swap) in self.clips.iter().zip(&other.clips).zip(coins) {
                let (x, y) = if swap { (theirs, ours) } else { (ours, theirs) };
                a.merge(x);
                b.merge(y);
            }
            // Sums in another order round otherwise.
            let slack = 1e-9 * metric(&a).abs().max(difference.abs());
            as_large += usize::from((metric(&a) - metric(&b)).abs() + slack >= difference.abs());
        }
        Difference {
            difference,
            low,
            high,
            p: (1 + as_large) as f64 / (1 + draws.exchanged.len()) as f64,
        }
    }
}

/// The middle 95 % of some numbers, linear between ranks.
pub(crate) fn middle(mut values: Vec<f64>) -> (f64, f64) {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| {
        let Some(last) = values.len().checked_sub(1) else {
            return f64::NAN;
        };
        let place = share * last as f64;
        let (below, part) = (place.floor() as usize, place.fract());
        values[below] + part * (values[(below + 1).min(last)] - values[below])
    };
    let tail = (1.0 - COVERAGE) / 2.0;
    (at(tail), at(1.0 - tail))
}

#[cfg(test)]
mod tests {
    use super::*;
    use lipstream::random::normal_f64;
    use ndarray::Array2;

    /// Clips of one frame whose squared errors are `errors`.
    fn clips(errors: &[f64]) -> Vec<Score> {
        errors
            .iter()
            .map(|e| {
                Score::of(
                    &Array2::zeros((1, 1)),
                    &Array2::from_elem((1, 1), e.sqrt() as f32),
                )
            })
            .collect()
    }

    #[test]
    fn the_interval_of_a_mean_is_two_standard_errors_wide() {
        let mut rng = Pcg64::seed_from_u64(1);
        let errors: Vec<f64> = (0..400).map(|_| 10.0 + normal_f64(&mut rng)).collect();
        let n = errors.len() as f64;
        let mean = errors.iter().sum::<f64>() / n;
        let deviation = (errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
        let half = 1.96 * deviation / n.sqrt();
        let draws = Draws::new(errors.len(), 2000, 2);
        let found = Resampled::new(clips(&errors), &draws).interval(Score::amse);
        assert!((found.value - mean).abs() < 1e-5);
        assert!((found.low - (mean - half)).abs() < 0.15 * half, "{found:?}");
        assert!((found.high - (mean + half)).abs() < 0.15 * half, "{found:?}");
    }

    /// Intervals hold the truth about as often as they say, and the test cries wolf about as often as it may.
    #[test]
    fn coverage_and_false_alarms() {
        let mut rng = Pcg64::seed_from_u64(3);
        let (mut held, mut alarms, trials) = (0, 0, 200);
        for trial in 0..trials {
            let ours: Vec<f64> = (0..40).map(|_| 10.0 + normal_f64(&mut rng)).collect();
            let theirs: Vec<f64> = (0..40).map(|_| 10.0 + normal_f64(&mut rng)).collect();
            let draws = Draws::new(40, 200, trial);
            let (a, b) = (
                Resampled::new(clips(&ours), &draws),
                Resampled::new(clips(&theirs), &draws),
            );
            let interval = a.interval(Score::amse);
            held += usize::from(interval.low <= 10.0 && 10.0 <= interval.high);
            alarms += usize::from(a.against(&b, &draws, Score::amse).p <= 0.05);
        }
        assert!((176..=198).contains(&held), "{held} of {trials}");
        assert!((2..=20).contains(&alarms), "{alarms} of {trials}");
    }

    /// All 2^8 exchanges of eight clips by hand: only the two that leave all signs alike reach the difference.
    #[test]
    fn a_clear_difference_has_the_exact_p() {
        let (ours, theirs) = (clips(&[1.0; 8]), clips(&[2.0; 8]));
        let draws = Draws::new(8, 20_000, 4);
        let (a, b) = (Resampled::new(ours, &draws), Resampled::new(theirs, &draws));
        let found = a.against(&b, &draws, Score::amse);
        assert!((found.difference + 1.0).abs() < 1e-6);
        assert!((found.p - 2.0 / 256.0).abs() < 0.002, "{found:?}");
        assert!((found.low + 1.0).abs() < 1e-6 && (found.high + 1.0).abs() < 1e-6);
        let same = a.against(&Resampled::new(clips(&[1.0; 8]), &draws), &draws, Score::amse);
        assert_eq!((same.difference, same.p), (0.0, 1.0));
    }

    #[test]
    fn the_same_seed_draws_the_same() {
        let errors: Vec<f64> = (0..20).map(f64::from).collect();
        let of = |seed| {
            let draws = Draws::new(20, 100, seed);
            Resampled::new(clips(&errors), &draws).interval(Score::amse)
        };
        assert_eq!(of(5), of(5));
        assert_ne!(of(5), of(6));
    }

    #[test]
    fn ranks_are_interpolated() {
        let (low, high) = middle((0..=100).map(f64::from).collect());
        assert!((low - 2.5).abs() < 1e-9 && (high - 97.5).abs() < 1e-9);
    }
}
