//! From speech to appearance in clusters (sections 4.2 to 4.4).
//!
//! Cluster i knows the mean speech s̄ᵢ and the mean appearance c̄ᵢ of its members and the principal components Rᵢ of their joint vectors
//! [W_c·c; s] (eq. 6 and 7). The cluster nearest to the speech is chosen by Mahalanobis distance under the covariance S of all
//! training speech (eq. 8); there d = R_sᵀ(s − s̄ᵢ) (eq. 11), W_c·c = W_c·c̄ᵢ + R_c·d (eq. 9).
//!
//! Eq. 11 is the least-squares fit of a joint vector to the cluster's plane when its unknown half is taken for the cluster's mean: R has orthonormal
//! columns, so that min over d of |[0; s − s̄ᵢ] − R·d|² is at Rᵀ[0; s − s̄ᵢ]. With all components kept R is square, R_c·R_sᵀ is 0 and speech moves
//! nothing within a cluster; that is why a cluster keeps few ([`SpeechMap::modes`]).
//!
//! A cluster of one member has no component and says its mean. A direction in which training speech does not vary has no weight in the distance.
use ndarray::{Array1, Array2, Array3, ArrayView1, s};

use super::linear::Linear;
use crate::error::{Result, bail};
use crate::tensors::{Tensors, TensorsBuilder};

/// Standard deviations within which d and c are held.
pub const LIMIT: f32 = 3.0;

/// Appearance and speech of some training pictures that look alike.
#[derive(Clone, Debug, PartialEq)]
pub struct Cluster {
    /// Joint vectors [W_c·c; s] of the members.
    pub joint: Linear,
    /// Standard deviation of each c of the members, `[C]`.
    pub deviation: Array1<f32>,
}

/// What turns speech parameters of one picture into appearance parameters of a node.
#[derive(Clone, Debug, PartialEq)]
pub struct SpeechMap {
    /// W_c: what appearance parameters are multiplied with to vary as much as speech.
    pub weight: f32,
    /// Inverse variances of the speech parameters, `[S]`: S⁻¹, which is diagonal because they are principal components. 0 where nothing varies.
    pub precision: Array1<f32>,
    /// One at least.
    pub clusters: Vec<Cluster>,
}

impl SpeechMap {
    /// Numbers of an appearance.
    pub fn appearance_size(&self) -> usize {
        self.clusters[0].deviation.len()
    }

    /// Most components that a cluster keeps.
    pub fn modes(&self) -> usize {
        self.clusters
            .iter()
            .map(|cluster| cluster.joint.modes())
            .max()
            .unwrap_or(0)
    }

    /// The squared Mahalanobis distance of speech to a cluster's mean speech (eq. 8).
    pub fn distance(&self, cluster: &Cluster, speech: ArrayView1<f32>) -> f32 {
        let mean = cluster.joint.mean.slice(s![self.appearance_size()..]);
        std::iter::zip(&speech, &mean)
            .zip(&self.precision)
            .map(|((s, m), precision)| precision * (s - m).powi(2))
            .sum()
    }

    /// The nearest cluster; the first of several.
    pub fn choose(&self, speech: ArrayView1<f32>) -> usize {
        let mut best = (0, f32::INFINITY);
        for (index, cluster) in self.clusters.iter().enumerate() {
            let distance = self.distance(cluster, speech);
            if distance < best.1 {
                best = (index, distance);
            }
        }
        best.0
    }

    /// The appearance that a cluster gives speech (eq. 9 to 11), within [`LIMIT`] deviations of its mean.
    pub fn estimate(&self, cluster: usize, speech: ArrayView1<f32>) -> Array1<f32> {
        let Cluster { joint, deviation } = &self.clusters[cluster];
        let n = self.appearance_size();
        let of_speech = joint.components.slice(s![.., n..]);
        let mut d = of_speech.dot(&(&speech - &joint.mean.slice(s![n..])));
        joint.hold(&mut d, LIMIT);
        let mut c = d.dot(&joint.components.slice(s![.., ..n])) / self.weight;
        for (c, deviation) in c.iter_mut().zip(deviation) {
            *c = c.clamp(-LIMIT * deviation, LIMIT * deviation);
        }
        c + &joint.mean.slice(s![..n]) / self.weight
    }

    /// Appearance for a row of speech parameters of each picture, `[pictures, C]`: choice and estimate picture by picture, not yet smoothed.
    pub fn convert(&self, speech: &Array2<f32>) -> Array2<f32> {
        self.convert_by(speech, speech.outer_iter().map(|heard| self.choose(heard)))
    }

    /// [`SpeechMap::convert`] with the cluster of each picture chosen elsewhere.
    pub fn convert_by(&self, speech: &Array2<f32>, chosen: impl Iterator<Item = usize>) -> Array2<f32> {
        let mut out = Array2::zeros((speech.nrows(), self.appearance_size()));
        for ((heard, cluster), mut said) in speech.outer_iter().zip(chosen).zip(out.outer_iter_mut()) {
            said.assign(&self.estimate(cluster, heard));
        }
        out
    }

    pub(super) fn put(&self, out: &mut TensorsBuilder, name: &str) {
        let (k, n, modes) = (self.clusters.len(), self.appearance_size(), self.modes());
        let size = self.clusters[0].joint.size();
        let mut means = Array2::zeros((k, size));
        // One row at least: a file's array cannot be without an element.
        let mut components = Array3::zeros((k, modes.max(1), size));
        let mut variances = Array2::zeros((k, modes.max(1)));
        let mut deviations = Array2::zeros((k, n));
        for (i, Cluster { joint, deviation }) in self.clusters.iter().enumerate() {
            means.row_mut(i).assign(&joint.mean);
            components
                .slice_mut(s![i, ..joint.modes(), ..])
                .assign(&joint.components);
            variances
                .slice_mut(s![i, ..joint.modes()])
                .assign(&joint.variances);
            deviations.row_mut(i).assign(deviation);
        }
        out.note(&format!("{name}.weight"), self.weight);
        out.put(&format!("{name}.precision"), &self.precision);
        out.put(&format!("{name}.means"), &means);
        out.put(&format!("{name}.components"), &components);
        out.put(&format!("{name}.variances"), &variances);
        out.put(&format!("{name}.deviations"), &deviations);
    }

    pub(super) fn read(from: &Tensors, name: &str) -> Result<Self> {
        let means: Array2<f32> = from.array(&format!("{name}.means"))?;
        let components: Array3<f32> = from.array(&format!("{name}.components"))?;
        let variances: Array2<f32> = from.array(&format!("{name}.variances"))?;
        let deviations: Array2<f32> = from.array(&format!("{name}.deviations"))?;
        let precision: Array1<f32> = from.array(&format!("{name}.precision"))?;
        let weight: f32 = from.noted(&format!("{name}.weight"))?;
        let (k, size) = means.dim();
        let fits = k > 0
            && components.dim() == (k, variances.ncols(), size)
            && variances.nrows() == k
            && deviations.nrows() == k
            && deviations.ncols() + precision.len() == size
            && weight.is_finite()
            && weight > 0.0
            && variances
                .iter()
                .chain(&deviations)
                .chain(&precision)
                .all(|v| *v >= 0.0);
        if !fits {
            bail!(
                File,
                "{name}: the clusters' sizes do not fit each other, or a variance or weight is negative"
            );
        }
        let clusters = (0..k)
            .map(|i| {
                // What is left of the table's width was filled with zeros.
                let modes = variances.row(i).iter().take_while(|v| **v > 0.0).count();
                Cluster {
                    joint: Linear {
                        mean: means.row(i).to_owned(),
                        components: components.slice(s![i, ..modes, ..]).to_owned(),
                        variances: variances.slice(s![i, ..modes]).to_owned(),
                    },
                    deviation: deviations.row(i).to_owned(),
                }
            })
            .collect();
        Ok(Self {
            weight,
            precision,
            clusters,
        })
    }
}

/// Local smoothing (end of section 4.4): each picture with a quarter of each neighbour; the first and the last stand in for what is beyond them.
pub fn smooth(rows: &Array2<f32>) -> Array2<f32> {
    let last = rows.nrows().saturating_sub(1);
    let mut out = rows.clone();
    for (n, mut row) in out.outer_iter_mut().enumerate() {
        let (before, after) = (rows.row(n.saturating_sub(1)), rows.row((n + 1).min(last)));
        row *= 0.5;
        row.scaled_add(0.25, &before);
        row.scaled_add(0.25, &after);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    fn cluster(mean: Array1<f32>, component: Array1<f32>, variance: f32) -> Cluster {
        let components = component.clone().insert_axis(ndarray::Axis(0));
        Cluster {
            joint: Linear {
                mean,
                components,
                variances: array![variance],
            },
            deviation: array![5.0],
        }
    }

    /// One appearance number, two of speech, W_c = 2.
    fn map() -> SpeechMap {
        SpeechMap {
            weight: 2.0,
            precision: array![1.0, 0.25],
            clusters: vec![
                cluster(array![4.0, 0.0, 0.0], array![0.6, 0.8, 0.0], 100.0),
                cluster(array![-2.0, 5.0, 2.0], array![0.8, 0.0, 0.6], 100.0),
            ],
        }
    }

    #[test]
    fn the_nearest_cluster_is_that_of_the_inverse_covariance() {
        // S is diagonal, with variances 1 and 4.
        let map = map();
        for speech in [[1.0, 3.0], [4.0, -3.0], [2.4, 9.0], [2.5, -40.0]] {
            let by_hand: Vec<f32> = [[0.0, 0.0], [5.0, 2.0]]
                .iter()
                .map(|mean: &[f32; 2]| {
                    let (x, y): (f32, f32) = (speech[0] - mean[0], speech[1] - mean[1]);
                    x * x + y * y / 4.0
                })
                .collect();
            let speech = ArrayView1::from(&speech);
            for (cluster, distance) in map.clusters.iter().zip(&by_hand) {
                assert!((map.distance(cluster, speech) - distance).abs() < 1e-3 * distance.max(1.0));
            }
            assert_eq!(map.choose(speech), usize::from(by_hand[1] < by_hand[0]));
        }
    }

    /// Eq. 11 against the least squares that it solves: the joint vector [W_c·c̄; s] on the cluster's plane.
    #[test]
    fn the_estimate_is_the_constrained_least_squares_fit() {
        let map = map();
        let speech = array![1.5, 0.5];
        for (index, cluster) in map.clusters.iter().enumerate() {
            let r = cluster.joint.components.row(0);
            let off = array![
                0.0,
                speech[0] - cluster.joint.mean[1],
                speech[1] - cluster.joint.mean[2]
            ];
            let error = |d: f32| -> f32 { (&off - &(&r * d)).iter().map(|e| e * e).sum() };
            // The parabola through three errors has its least at the best d, whatever the equations say.
            let (left, middle, right) = (error(-1.0), error(0.0), error(1.0));
            let best = 0.5 * (left - right) / (left - 2.0 * middle + right);
            let wanted = (cluster.joint.mean[0] + r[0] * best) / map.weight;
            let said = map.estimate(index, speech.view());
            assert!((said[0] - wanted).abs() < 1e-5, "{said} {wanted}");
        }
    }

    #[test]
    fn limits_hold_and_a_lone_member_says_its_mean() {
        let mut map = map();
        let far = array![1e6, 0.0];
        // d is held at 3·10, of which 0.6 / 2 becomes 9; the members' own spread allows 15.
        assert!((map.estimate(0, far.view())[0] - (2.0 + 9.0)).abs() < 1e-4);
        map.clusters[0].deviation = array![1.0];
        assert!((map.estimate(0, far.view())[0] - (2.0 + 3.0)).abs() < 1e-4);
        map.clusters[0].joint.components = Array2::zeros((0, 3));
        map.clusters[0].joint.variances = Array1::zeros(0);
        map.clusters[0].deviation = array![0.0];
        map.precision = array![0.0, 0.0];
        let said = map.convert(&array![[1e6, -7.0], [0.0, 0.0]]);
        assert_eq!(said, array![[2.0], [2.0]]);
    }

    #[test]
    fn smoothing_keeps_lines_and_spreads_a_spike() {
        let spike = array![[0.0], [0.0], [4.0], [0.0], [0.0]];
        assert_eq!(smooth(&spike), array![[0.0], [1.0], [2.0], [1.0], [0.0]]);
        assert_eq!(smooth(&array![[3.0]]), array![[3.0]]);
        assert_eq!(smooth(&Array2::zeros((0, 2))).nrows(), 0);
    }
}
