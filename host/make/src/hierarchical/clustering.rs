//! k-means of appearance parameters (COS section 4.2): pictures that look alike make a cluster.
use ndarray::{Array1, Array2, ArrayView1, Axis};
use rand::seq::index::sample;
use rand_pcg::Pcg64;

/// Rounds after which centres are taken as they are.
const ROUNDS: usize = 100;

/// Which cluster each row belongs to.
#[derive(Clone, Debug, PartialEq)]
pub struct Clustering {
    /// Centre of each cluster, `[k, C]`; every cluster has a member.
    pub centres: Array2<f32>,
    /// The cluster of each row.
    pub of_row: Vec<usize>,
    /// Mean squared distance of rows from their centres.
    pub error: f64,
}

fn distance(a: ArrayView1<f32>, b: ArrayView1<f32>) -> f32 {
    std::iter::zip(a, b).map(|(a, b)| (a - b).powi(2)).sum()
}

/// The centre nearest to each row and its distance.
pub(super) fn nearest(rows: &Array2<f32>, centres: &Array2<f32>) -> Vec<(usize, f32)> {
    // |row − centre|² without |row|², which is the same for all centres.
    let products = rows.dot(&centres.t());
    let squares: Array1<f32> = centres.map_axis(Axis(1), |c| c.dot(&c));
    let of_row = |(row, along): (ArrayView1<f32>, ArrayView1<f32>)| {
        let mut best = (0, f32::INFINITY);
        for (k, (square, product)) in std::iter::zip(&squares, along).enumerate() {
            let off = square - 2.0 * product;
            if off < best.1 {
                best = (k, off);
            }
        }
        (best.0, distance(row, centres.row(best.0)))
    };
    rows.outer_iter().zip(products.outer_iter()).map(of_row).collect()
}

/// `k` clusters of `rows` from drawn rows as first centres, fewer where there are fewer different rows.
///
/// A centre that loses its last member goes to the row that is farthest from its own.
pub fn k_means(rows: &Array2<f32>, k: usize, rng: &mut Pcg64) -> Clustering {
    let k = k.clamp(1, rows.nrows().max(1)).min(rows.nrows());
    let mut centres = rows.select(Axis(0), &sample(rng, rows.nrows(), k).into_vec());
    let mut found = nearest(rows, &centres);
    for _ in 0..ROUNDS {
        let mut sums = Array2::<f32>::zeros(centres.dim());
        let mut counts = vec![0usize; k];
        for (row, (cluster, _)) in rows.outer_iter().zip(&found) {
            let mut sum = sums.row_mut(*cluster);
            sum += &row;
            counts[*cluster] += 1;
        }
        let mut taken = Vec::new();
        for cluster in 0..k {
            if counts[cluster] > 0 {
                let mean = &sums.row(cluster) / counts[cluster] as f32;
                centres.row_mut(cluster).assign(&mean);
                continue;
            }
            let free = found.iter().enumerate().filter(|(row, _)| !taken.contains(row));
            if let Some((row, _)) = free.max_by(|a, b| a.1.1.total_cmp(&b.1.1)) {
                taken.push(row);
                centres.row_mut(cluster).assign(&rows.row(row));
            }
        }
        let next = nearest(rows, &centres);
        let settled = std::iter::zip(&next, &found).all(|(a, b)| a.0 == b.0);
        found = next;
        if settled && taken.is_empty() {
            break;
        }
    }
    without_empty(&centres, &found)
}

/// Rows that are the same leave centres without a member: those are dropped.
fn without_empty(centres: &Array2<f32>, found: &[(usize, f32)]) -> Clustering {
    let mut number = vec![None; centres.nrows()];
    let mut kept = Vec::new();
    for (cluster, _) in found {
        if number[*cluster].is_none() {
            number[*cluster] = Some(kept.len());
            kept.push(*cluster);
        }
    }
    let error = found.iter().map(|(_, d)| f64::from(*d)).sum::<f64>() / found.len().max(1) as f64;
    Clustering {
        centres: centres.select(Axis(0), &kept),
        of_row: found.iter().filter_map(|(cluster, _)| number[*cluster]).collect(),
        error,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;
    use rand::SeedableRng as _;

    #[test]
    fn heaps_that_lie_apart_are_found_and_the_error_is_that_of_the_definition() {
        let middles = [[0.0, 0.0], [50.0, 0.0], [0.0, 50.0]];
        let rows = Array2::from_shape_fn((30, 2), |(n, axis)| {
            middles[n % 3][axis] + [(n / 3) as f32 * 0.3, (n * 7 % 5) as f32 * 0.2][axis]
        });
        // From some start: others may put two centres into one heap, which is why there are several.
        let starts = (0..8).map(|seed| k_means(&rows, 3, &mut Pcg64::seed_from_u64(seed)));
        let best = starts.min_by(|a, b| a.error.total_cmp(&b.error)).unwrap();
        for n in 0..30 {
            assert_eq!(best.of_row[n], best.of_row[n % 3]);
        }
        let mut error = 0.0;
        for (row, cluster) in rows.outer_iter().zip(&best.of_row) {
            error += f64::from(distance(row, best.centres.row(*cluster)));
        }
        assert!((best.error - error / 30.0).abs() < 1e-4);
        // A centre is the mean of its members.
        let members: Vec<usize> = (0..30).filter(|n| best.of_row[*n] == best.of_row[0]).collect();
        let mean = rows.select(Axis(0), &members).mean_axis(Axis(0)).unwrap();
        assert!(distance(mean.view(), best.centres.row(best.of_row[0])) < 1e-6);
    }

    #[test]
    fn as_many_clusters_as_rows_have_no_error_and_equal_rows_share_one() {
        let rows = array![[1.0f32], [5.0], [9.0]];
        let each = k_means(&rows, 3, &mut Pcg64::seed_from_u64(1));
        assert_eq!((each.centres.nrows(), each.error), (3, 0.0));
        assert_eq!(
            k_means(&rows, 99, &mut Pcg64::seed_from_u64(1)).centres.nrows(),
            3
        );
        let alike = k_means(&Array2::from_elem((6, 2), 4.0), 3, &mut Pcg64::seed_from_u64(1));
        assert_eq!((alike.centres.nrows(), alike.error), (1, 0.0));
        assert_eq!(alike.of_row, [0; 6]);
        let none = k_means(&Array2::zeros((0, 2)), 3, &mut Pcg64::seed_from_u64(1));
        assert_eq!(none.centres.nrows(), 0);
    }
}
