//! Performance refinement (X&L section 6.1): the fine detail that eigenmouths leave out, taken from recorded mouths.
//!
//! The paper keeps 500 typical mouths by all of their 980 coefficients g = [gʳ, gᵈ] (eq. 14), chooses for every picture the one whose gʳ is nearest to the
//! predicted coefficients (eq. 15), and draws with that one's gᵈ (eq. 16). The 980 eigenmouths of 980 images span these images, so that A·[0, gᵈ] is exactly
//! what the first 30 leave of candidate j: its image less its own reconstruction. That difference is kept here, and no 980 eigenmouths are needed; nor need
//! it have their resolution.
//!
//! Chosen picture by picture the detail jumps. So it may be chosen over time: Viterbi over the candidates, with the distances of eq. 15 and, for each change,
//! the distance between the two details, both in the same unit (squared levels, summed over the pixels).
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis};

use crate::error::{Result, bail};

/// Candidates of the paper.
pub const CANDIDATES: usize = 500;

/// How a candidate is chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Choice {
    /// For each picture the nearest (eq. 15).
    FrameWise,
    /// Over time: a change costs so many times the squared distance between the details.
    OverTime {
        /// Charge of a change; 0 is frame-wise.
        change: f32,
    },
}

impl Default for Choice {
    fn default() -> Self {
        Self::OverTime { change: CHANGE }
    }
}

/// Chosen on validation clips (docs/rendering.md).
const CHANGE: f32 = 1.0;
/// Where the next pictures are not known, a change costs so much of its charge: at the whole of it the choice follows late, since what a change would
/// save in pictures to come cannot be counted. Chosen by what it makes of Viterbi's own costs (docs/rendering.md).
const BLIND: f32 = 0.5;
/// There, so much of the detail before is still in the next picture. More would flicker less and follow later (docs/rendering.md).
const FADES: f32 = 0.25;

/// Typical mouths: their weights, and what the eigenmouths leave of their images.
#[derive(Clone, Debug)]
pub struct Candidates {
    /// `[K, D]`.
    weights: Array2<f32>,
    /// `[K, P]`, levels, saturated at ±127.
    details: Array2<i8>,
    /// Squared distance between details, `[K, K]`.
    apart: Array2<f32>,
}

impl Candidates {
    /// From weights `[K, D]` and details `[K, P]` in levels; more than ±127 are cut.
    ///
    /// # Errors
    ///
    /// [`Error::Data`](crate::Error::Data): none, or not as many of the one as of the other.
    pub fn new(weights: Array2<f32>, details: ArrayView2<f32>) -> Result<Self> {
        if weights.nrows() == 0 || weights.nrows() != details.nrows() {
            bail!(
                Data,
                "{} weights and {} details are no candidates",
                weights.nrows(),
                details.nrows()
            );
        }
        let details = details.mapv(|v| v.round().clamp(-127.0, 127.0) as i8);
        let floats = details.mapv(f32::from);
        let gram = floats.dot(&floats.t());
        let apart = Array2::from_shape_fn(gram.dim(), |(i, j)| {
            (gram[(i, i)] + gram[(j, j)] - 2.0 * gram[(i, j)]).max(0.0)
        });
        Ok(Self {
            weights,
            details,
            apart,
        })
    }

    /// Number of candidates K.
    pub fn len(&self) -> usize {
        self.weights.nrows()
    }

    /// Never.
    pub fn is_empty(&self) -> bool {
        self.weights.is_empty()
    }

    /// Weights that a candidate is found by, D.
    pub fn n_parameters(&self) -> usize {
        self.weights.ncols()
    }

    /// Numbers of a detail, P.
    pub fn n_levels(&self) -> usize {
        self.details.ncols()
    }

    /// What the eigenmouths leave of candidate `index`, `[P]`, in levels.
    pub fn detail(&self, index: usize) -> ArrayView1<'_, i8> {
        self.details.row(index)
    }

    /// The detail shown in picture `n` of a way of candidates, `[P]`, levels: chosen over time, a change is spread over three pictures.
    pub fn shown(&self, way: &[usize], n: usize, choice: Choice) -> Vec<f32> {
        let last = way.len().saturating_sub(1);
        let around: &[(usize, f32)] = match choice {
            Choice::FrameWise => &[(n, 1.0)],
            Choice::OverTime { .. } => &[(n.saturating_sub(1), 0.25), (n, 0.5), ((n + 1).min(last), 0.25)],
        };
        self.mixed(around.iter().map(|(at, weight)| (way[*at], *weight)))
    }

    /// The detail shown where the next picture's candidate is not known, `[P]`, levels: chosen over time, the one before fades out over a picture.
    pub fn shown_now(&self, before: Option<usize>, now: usize, choice: Choice) -> Vec<f32> {
        match (choice, before) {
            (Choice::OverTime { .. }, Some(before)) => self.mixed([(before, FADES), (now, 1.0 - FADES)]),
            _ => self.mixed([(now, 1.0)]),
        }
    }

    /// Some candidates' details, each by its weight.
    fn mixed(&self, some: impl IntoIterator<Item = (usize, f32)>) -> Vec<f32> {
        let mut sum = vec![0.0f32; self.n_levels()];
        for (candidate, weight) in some {
            let detail = self.detail(candidate);
            sum.iter_mut()
                .zip(detail)
                .for_each(|(sum, level)| *sum += weight * f32::from(*level));
        }
        sum
    }

    /// A candidate for each picture of `tracks` `[T, D]`.
    pub fn choose(&self, tracks: ArrayView2<f32>, choice: Choice) -> Vec<usize> {
        match choice {
            Choice::FrameWise => tracks
                .outer_iter()
                .map(|row| nearest(&self.distances(row)))
                .collect(),
            Choice::OverTime { change } => self.choose_over_time(tracks, change),
        }
    }

    /// The candidate for weights `[D]` after the one `before`, where nothing is known of the pictures that follow: one step of Viterbi's costs.
    pub fn next(&self, before: Option<usize>, weights: ArrayView1<f32>, choice: Choice) -> usize {
        let mut costs = self.distances(weights);
        if let (Choice::OverTime { change }, Some(before)) = (choice, before) {
            let charge = BLIND * change;
            costs
                .iter_mut()
                .zip(self.apart.row(before))
                .for_each(|(cost, apart)| *cost += charge * apart);
        }
        nearest(&costs)
    }

    /// Squared distances of weights to all candidates'.
    fn distances(&self, weights: ArrayView1<f32>) -> Vec<f32> {
        let apart = |of: ArrayView1<f32>| of.iter().zip(weights).map(|(a, b)| (a - b) * (a - b)).sum();
        self.weights.outer_iter().map(apart).collect()
    }

    fn choose_over_time(&self, tracks: ArrayView2<f32>, change: f32) -> Vec<usize> {
        // Cost of the best way to each candidate, less that of the best of all, so that hours of pictures lose no digits.
        let mut costs = vec![0.0f32; self.len()];
        let mut from: Vec<Vec<u16>> = Vec::with_capacity(tracks.nrows());
        for row in tracks.outer_iter() {
            let local = self.distances(row);
            let mut next = Vec::with_capacity(costs.len());
            let mut before = Vec::with_capacity(costs.len());
            for (j, distance) in local.iter().enumerate() {
                let (mut best, mut cost) = (j, costs[j]);
                for (i, (way, apart)) in costs.iter().zip(self.apart.row(j)).enumerate() {
                    let through = way + change * apart;
                    if through < cost {
                        (best, cost) = (i, through);
                    }
                }
                next.push(cost + distance);
                before.push(best as u16);
            }
            let least = next.iter().copied().fold(f32::INFINITY, f32::min);
            next.iter_mut().for_each(|cost| *cost -= least);
            costs = next;
            from.push(before);
        }
        let mut at = nearest(&costs);
        let mut way = Vec::with_capacity(from.len());
        for before in from.iter().rev() {
            way.push(at);
            at = usize::from(before[at]);
        }
        way.reverse();
        way
    }
}

/// Place of the least; the first of several.
fn nearest(costs: &[f32]) -> usize {
    let mut best = 0;
    for (at, cost) in costs.iter().enumerate() {
        if *cost < costs[best] {
            best = at;
        }
    }
    best
}

/// `count` typical ones of weights `[N, D]`: those nearest to the centres of as many clusters (k-means, begun at points that lie far from each other).
/// All of them, where there are no more.
pub fn typical(weights: ArrayView2<f32>, count: usize) -> Vec<usize> {
    let n = weights.nrows();
    if n <= count {
        return (0..n).collect();
    }
    let apart = |a: ArrayView1<f32>, b: ArrayView1<f32>| -> f32 {
        a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum()
    };
    // Each next centre is the point that is furthest from those before; the first is the one nearest to the middle.
    let middle = weights
        .mean_axis(Axis(0))
        .unwrap_or_else(|| Array1::zeros(weights.ncols()));
    let first = (0..n)
        .min_by(|a, b| {
            let of = |at: usize| apart(weights.row(at), middle.view());
            of(*a).total_cmp(&of(*b))
        })
        .unwrap_or(0);
    let mut chosen = vec![first];
    let mut furthest: Vec<f32> = (0..n)
        .map(|at| apart(weights.row(at), weights.row(first)))
        .collect();
    while chosen.len() < count {
        let next = (0..n)
            .max_by(|a, b| furthest[*a].total_cmp(&furthest[*b]))
            .unwrap_or(0);
        chosen.push(next);
        for (at, least) in furthest.iter_mut().enumerate() {
            *least = least.min(apart(weights.row(at), weights.row(next)));
        }
    }
    let mut centres = weights.select(Axis(0), &chosen);
    let mut of = vec![0usize; n];
    for _ in 0..ROUNDS {
        let squares: Vec<f32> = centres.outer_iter().map(|c| c.dot(&c)).collect();
        let products = weights.dot(&centres.t());
        for (at, row) in products.outer_iter().enumerate() {
            let costs: Vec<f32> = row.iter().zip(&squares).map(|(p, s)| s - 2.0 * p).collect();
            of[at] = nearest(&costs);
        }
        let mut sums = Array2::<f32>::zeros(centres.dim());
        let mut counts = vec![0.0f32; count];
        for (at, cluster) in of.iter().enumerate() {
            sums.row_mut(*cluster).scaled_add(1.0, &weights.row(at));
            counts[*cluster] += 1.0;
        }
        for (k, n) in counts.iter().enumerate() {
            if *n > 0.0 {
                centres.row_mut(k).assign(&(&sums.row(k) / *n));
            }
        }
    }
    let mut best: Vec<Option<(f32, usize)>> = vec![None; count];
    for (at, cluster) in of.iter().enumerate() {
        let away = apart(weights.row(at), centres.row(*cluster));
        if best[*cluster].is_none_or(|(least, _)| away < least) {
            best[*cluster] = Some((away, at));
        }
    }
    let mut typical: Vec<usize> = best.into_iter().flatten().map(|(_, at)| at).collect();
    typical.sort_unstable();
    typical
}

const ROUNDS: usize = 8;

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, array};

    fn candidates() -> Candidates {
        let weights = array![[0.0, 0.0], [10.0, 0.0], [10.0, 1.0]];
        let details = array![[0.0, 0.0, 0.0], [8.0, 0.0, 0.0], [0.0, 300.0, 0.0]];
        Candidates::new(weights, details.view()).unwrap()
    }

    #[test]
    fn the_nearest_is_chosen_picture_by_picture() {
        let all = candidates();
        let tracks = array![[1.0, 0.0], [9.0, 0.4], [9.0, 0.6]];
        assert_eq!(all.choose(tracks.view(), Choice::FrameWise), [0, 1, 2]);
        assert_eq!(
            all.choose(tracks.view(), Choice::OverTime { change: 0.0 }),
            [0, 1, 2]
        );
        assert_eq!(all.detail(2).to_vec(), [0, 127, 0]);
    }

    /// Over time, what flips between two mouths that are nearly as near stays with one, and a true change still comes.
    #[test]
    fn over_time_a_flicker_costs_and_a_change_does_not() {
        let all = candidates();
        let tracks = Array2::from_shape_fn((20, 2), |(t, d)| match d {
            0 => {
                if t < 10 {
                    0.0
                } else {
                    10.0
                }
            }
            _ => 0.5 + if t % 2 == 0 { 0.1 } else { -0.1 },
        });
        let jumps = |way: &[usize]| way.windows(2).filter(|w| w[0] != w[1]).count();
        let frame_wise = all.choose(tracks.view(), Choice::FrameWise);
        assert!(jumps(&frame_wise) > 8, "{frame_wise:?}");
        let over_time = all.choose(tracks.view(), Choice::OverTime { change: 0.5 });
        assert_eq!(jumps(&over_time), 1, "{over_time:?}");
        assert_eq!((over_time[0], over_time[19]), (0, 1));
        // Without the pictures that follow, too.
        let mut before = None;
        let blind: Vec<usize> = tracks
            .outer_iter()
            .map(|row| {
                let now = all.next(before, row, Choice::OverTime { change: 0.5 });
                before = Some(now);
                now
            })
            .collect();
        assert_eq!(blind, over_time);
    }

    /// Against every way there is.
    #[test]
    fn viterbi_finds_the_cheapest_way() {
        let weights = Array2::from_shape_fn((4, 3), |(k, d)| ((7 * k + 3 * d) % 5) as f32);
        let details = Array2::from_shape_fn((4, 6), |(k, p)| ((5 * k + 2 * p) % 7) as f32);
        let all = Candidates::new(weights.clone(), details.view()).unwrap();
        let tracks = Array2::from_shape_fn((5, 3), |(t, d)| ((3 * t + d) % 4) as f32);
        let square = |a: ArrayView1<f32>, b: ArrayView1<f32>| -> f32 {
            a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum()
        };
        let change = 0.3;
        let cost = |way: &[usize]| -> f32 {
            let near: f32 = (0..5).map(|t| square(weights.row(way[t]), tracks.row(t))).sum();
            let steps: f32 = way
                .windows(2)
                .map(|w| square(details.row(w[0]), details.row(w[1])))
                .sum();
            near + change * steps
        };
        let found = all.choose(tracks.view(), Choice::OverTime { change });
        for number in 0..4usize.pow(5) {
            let way: Vec<usize> = (0..5).map(|t| number / 4usize.pow(t) % 4).collect();
            assert!(cost(&found) <= cost(&way) + 1e-3, "{found:?} {way:?}");
        }
    }

    #[test]
    fn typical_ones_are_one_of_each_cluster() {
        let weights = Array2::from_shape_fn((60, 2), |(n, d)| {
            let cluster = n % 3;
            [[0.0, 0.0], [50.0, 0.0], [0.0, 50.0]][cluster][d] + (n / 3) as f32 * 0.1
        });
        let mut clusters: Vec<usize> = typical(weights.view(), 3).iter().map(|n| n % 3).collect();
        clusters.sort_unstable();
        assert_eq!(clusters, [0, 1, 2]);
        assert_eq!(typical(weights.view(), 100).len(), 60);
        assert!(Candidates::new(Array2::zeros((0, 2)), Array2::zeros((0, 3)).view()).is_err());
    }
}
