//! From speech to appearance: clusters and their joint components (COS sections 4.2 and 4.3, eq. 6 and 7).
//!
//! What the paper leaves to experiments is chosen on clips that took no part in the fit: the number of clusters, the start of the k-means search and how
//! many components a cluster keeps (with all of them eq. 9 to 11 move nothing inside a cluster). The error is that of appearances as they will be drawn, smoothed.
use lipstream::kinds::hierarchical::clusters::{Cluster, SpeechMap, smooth};
use ndarray::{Array1, Array2, Axis, concatenate, s};
use rand::SeedableRng as _;
use rand_pcg::Pcg64;
use rayon::prelude::*;

use super::clustering::{Clustering, k_means};
use super::principal::{Keep, components};
use crate::error::{Result, ensure};

/// Appearance and speech of pictures.
#[derive(Clone, Debug)]
pub struct Pairs {
    /// c `[n, C]`.
    pub appearance: Array2<f32>,
    /// s `[n, S]`.
    pub speech: Array2<f32>,
    /// Rows of each clip, in the order of time.
    pub clips: Vec<std::ops::Range<usize>>,
}

/// What is tried.
#[derive(Clone, Debug, PartialEq)]
pub struct Search {
    /// Numbers of clusters.
    pub clusters: Vec<usize>,
    /// Starts of each.
    pub starts: usize,
    /// Most components of a cluster; all numbers of them from 0 are tried.
    pub modes: usize,
    /// Seed of the starts.
    pub seed: u64,
}

impl Default for Search {
    fn default() -> Self {
        Self {
            clusters: vec![15, 30, 60, 90, 120, 180],
            starts: 5,
            modes: 8,
            seed: 0,
        }
    }
}

/// One attempt: a number of clusters from one start with one number of components.
#[derive(Clone, Debug, PartialEq)]
pub struct Trial {
    /// Clusters that were asked for.
    pub clusters: usize,
    /// Which start.
    pub start: usize,
    /// Most components of a cluster.
    pub modes: usize,
    /// Mean squared error of the smoothed appearance on the validation clips, over their variance: 1 is as bad as the mean picture.
    pub error: f64,
}

/// W_c: what appearance is multiplied with to vary as much as speech. The paper's ratio for each element is not defined where the two have different numbers of
/// components; one number stands in all of them.
fn weight(pairs: &Pairs) -> f32 {
    let variance = |rows: &Array2<f32>| rows.var_axis(Axis(0), 0.0).sum();
    (variance(&pairs.speech) / variance(&pairs.appearance)).sqrt()
}

/// The joint models of all clusters (eq. 6 and 7), with at most `modes` components each. A lone member has none.
fn models(pairs: &Pairs, weight: f32, clustering: &Clustering, modes: usize) -> Result<Vec<Cluster>> {
    let joint = concatenate![Axis(1), &pairs.appearance * weight, pairs.speech];
    let keep = Keep {
        share: 1.0,
        most: modes,
    };
    (0..clustering.centres.nrows())
        .map(|cluster| {
            let members: Vec<usize> = (0..joint.nrows())
                .filter(|row| clustering.of_row[*row] == cluster)
                .collect();
            Ok(Cluster {
                joint: components(&joint.select(Axis(0), &members), keep)?,
                deviation: pairs.appearance.select(Axis(0), &members).std_axis(Axis(0), 0.0),
            })
        })
        .collect()
}

/// The same map with at most `modes` components in each cluster.
fn within(map: &SpeechMap, modes: usize) -> SpeechMap {
    let mut map = map.clone();
    for Cluster { joint, .. } in &mut map.clusters {
        let kept = joint.modes().min(modes);
        joint.components = joint.components.slice(s![..kept, ..]).to_owned();
        joint.variances = joint.variances.slice(s![..kept]).to_owned();
    }
    map
}

/// Mean squared error of what a map says, smoothed clip by clip, over the variance of the truth.
pub fn error(map: &SpeechMap, pairs: &Pairs) -> f64 {
    error_of(&map.convert(&pairs.speech), pairs)
}

/// [`error`] of what is said already, not yet smoothed.
pub fn error_of(said: &Array2<f32>, pairs: &Pairs) -> f64 {
    let mut sum = 0.0;
    for clip in &pairs.clips {
        let rows = s![clip.clone(), ..];
        let off = smooth(&said.slice(rows).to_owned()) - pairs.appearance.slice(rows);
        sum += off.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
    }
    let variance = pairs.appearance.var_axis(Axis(0), 0.0).sum();
    sum / pairs.appearance.nrows().max(1) as f64 / f64::from(variance.max(f32::MIN_POSITIVE))
}

/// The map that does best on `validation` of all that are tried, and every trial.
///
/// # Errors
///
/// No training picture, or speech or appearance that is always the same.
pub fn fit(train: &Pairs, validation: &Pairs, search: &Search) -> Result<(SpeechMap, Vec<Trial>)> {
    let n = train.speech.nrows();
    let weight = weight(train);
    ensure!(
        n > 0 && weight.is_finite() && weight > 0.0,
        Data,
        "speech or appearance of the {n} training pictures is always the same: there is nothing to learn"
    );
    let precision: Array1<f32> = train
        .speech
        .var_axis(Axis(0), 0.0)
        .mapv(|v| if v > 0.0 { 1.0 / v } else { 0.0 });
    let wanted: Vec<(usize, usize)> = search
        .clusters
        .iter()
        .flat_map(|k| (0..search.starts.max(1)).map(move |start| (*k, start)))
        .collect();
    let tried: Vec<(SpeechMap, Vec<Trial>)> = wanted
        .into_par_iter()
        .map(|(clusters, start)| {
            let seed = search.seed.wrapping_mul(1009).wrapping_add(start as u64);
            let clustering = k_means(&train.appearance, clusters, &mut Pcg64::seed_from_u64(seed));
            let map = SpeechMap {
                weight,
                precision: precision.clone(),
                clusters: models(train, weight, &clustering, search.modes)?,
            };
            let trial = |modes: usize| Trial {
                clusters,
                start,
                modes,
                error: error(&within(&map, modes), validation),
            };
            let trials = (0..=search.modes).map(trial).collect();
            Ok((map, trials))
        })
        .collect::<Result<_>>()?;
    let best = tried
        .iter()
        .flat_map(|(map, trials)| trials.iter().map(move |trial| (map, trial)))
        .min_by(|a, b| a.1.error.total_cmp(&b.1.error));
    let Some((map, trial)) = best else {
        crate::error::bail!(Choice, "no number of clusters is to be tried");
    };
    let map = within(map, trial.modes);
    Ok((map, tried.into_iter().flat_map(|(_, trials)| trials).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;
    use rand::RngExt as _;

    /// Two mouths that sound different, and inside each a slope of its own from speech to appearance.
    fn pairs(n: usize, seed: u64) -> Pairs {
        let mut rng = Pcg64::seed_from_u64(seed);
        let (mut appearance, mut speech) = (Array2::zeros((n, 2)), Array2::zeros((n, 2)));
        for t in 0..n {
            let along: f32 = rng.random_range(-1.0..1.0);
            // Long stretches of one mouth, so that smoothing hurts little.
            let (c, s, slope) = if t / 20 % 2 == 0 {
                (8.0, 5.0, 1.0)
            } else {
                (-8.0, -5.0, -1.0)
            };
            appearance.row_mut(t).assign(&array![c, slope * along]);
            speech.row_mut(t).assign(&array![s, along]);
        }
        Pairs {
            appearance,
            speech,
            clips: std::iter::once(0..n).collect(),
        }
    }

    /// One number of one cluster by hand: the joint vectors lie on a line, along which speech tells appearance.
    #[test]
    fn eq_9_to_11_follow_the_line_of_a_cluster() {
        let train = pairs(400, 1);
        let clustering = k_means(&train.appearance, 2, &mut Pcg64::seed_from_u64(3));
        let map = SpeechMap {
            weight: weight(&train),
            precision: array![1.0, 1.0],
            clusters: models(&train, weight(&train), &clustering, 1).unwrap(),
        };
        for (heard, wanted) in [(array![5.0, 0.5], [8.0, 0.5]), (array![-5.0, 0.5], [-8.0, -0.5])] {
            let said = map.estimate(map.choose(heard.view()), heard.view());
            // On [W_c·c; s] the line is (W_c·slope, 1); the projection of speech alone gives 1/(1 + W_c²) of the way (eq. 11).
            let share = 1.0 / (1.0 + map.weight.powi(2));
            assert!((said[0] - wanted[0]).abs() < 0.05, "{said}");
            assert!((said[1] - share * wanted[1]).abs() < 0.05, "{said}");
        }
        // W_c brings c to the variance of s.
        let variance = |rows: &Array2<f32>| rows.var_axis(Axis(0), 0.0).sum();
        assert!((variance(&(&train.appearance * map.weight)) / variance(&train.speech) - 1.0).abs() < 1e-3);
    }

    #[test]
    fn with_all_components_speech_moves_nothing_inside_a_cluster() {
        let train = pairs(400, 1);
        let clustering = k_means(&train.appearance, 6, &mut Pcg64::seed_from_u64(3));
        let models = models(&train, 1.0, &clustering, 9).unwrap();
        for cluster in models.iter().filter(|cluster| cluster.joint.modes() == 4) {
            let components = &cluster.joint.components;
            let product = components
                .slice(s![.., ..2])
                .t()
                .dot(&components.slice(s![.., 2..]));
            assert!(product.iter().all(|v| v.abs() < 1e-4), "R_c·R_sᵀ is not 0");
        }
    }

    #[test]
    fn the_best_of_all_trials_is_taken() {
        let (train, validation) = (pairs(400, 1), pairs(200, 2));
        let search = Search {
            clusters: vec![1, 2, 8],
            starts: 3,
            modes: 2,
            seed: 4,
        };
        let (map, trials) = fit(&train, &validation, &search).unwrap();
        assert_eq!(trials.len(), 3 * 3 * 3);
        let best = trials.iter().map(|t| t.error).fold(f64::INFINITY, f64::min);
        assert!((error(&map, &validation) - best).abs() < 1e-9);
        // One cluster without components is the mean picture.
        let mean = trials.iter().find(|t| (t.clusters, t.modes) == (1, 0)).unwrap();
        assert!(
            (mean.error - 1.0).abs() < 0.1 && best < 0.1,
            "{} {best}",
            mean.error
        );
        assert_eq!(fit(&train, &validation, &search).unwrap().0, map);
    }

    #[test]
    fn lone_members_and_singular_speech_end_in_means_and_never_in_nan() {
        // Four pictures, each its own cluster; the second number of speech never changes.
        let train = Pairs {
            appearance: array![[1.0, 0.0], [5.0, 1.0], [9.0, 2.0], [20.0, 3.0]],
            speech: array![[0.0, 7.0], [1.0, 7.0], [2.0, 7.0], [3.0, 7.0]],
            clips: std::iter::once(0..4).collect(),
        };
        let search = Search {
            clusters: vec![4],
            starts: 1,
            ..Search::default()
        };
        let (map, _) = fit(&train, &train, &search).unwrap();
        assert_eq!((map.clusters.len(), map.modes(), map.precision[1]), (4, 0, 0.0));
        let said = map.estimate(map.choose(array![2.1, -1e9].view()), array![2.1, -1e9].view());
        assert!((&said - &array![9.0, 2.0]).iter().all(|d| d.abs() < 1e-4));
        let still = Pairs {
            speech: Array2::zeros((4, 2)),
            ..train
        };
        assert!(fit(&still, &still, &search).is_err());
    }
}
