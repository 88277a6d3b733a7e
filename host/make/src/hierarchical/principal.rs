//! Principal components of rows of numbers: what every [`Linear`] model of the hierarchy is fitted with.
//!
//! Short rows, or few of them, are solved exactly, from whichever of XᵀX and X·Xᵀ is smaller. Textures are thousands of rows of ten thousand pixels: of them the leading
//! components are found by subspace iteration from a random start (Halko, Martinsson and Tropp 2011, algorithm 4.4), whose error falls with the ratio of a left-out
//! variance to a kept one to the power of twice the iterations.
use lipstream::kinds::hierarchical::Linear;
use nalgebra::{DMatrix, SymmetricEigen};
use ndarray::{Array1, Array2, Axis, s};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;

use crate::error::{Result, bail};

/// The longest side of a matrix that is solved exactly.
const EXACT: usize = 256;
/// Iterations of the subspace.
const ITERATIONS: usize = 6;
/// Directions that the subspace has beyond those that are wanted.
const BEYOND: usize = 12;
/// Components that carry less of all variance are rounding.
const LEAST_SHARE: f64 = 1e-7;

/// How many components are kept: as many as carry a share of the variance, but no more than a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keep {
    /// Of the variance, 0 to 1.
    pub share: f32,
    /// Most components.
    pub most: usize,
}

/// The components of `rows` `[n, D]`, largest variance first; none where the rows are all alike.
///
/// # Errors
///
/// That there is no row.
pub fn components(rows: &Array2<f32>, keep: Keep) -> Result<Linear> {
    let Some(mean) = rows.mean_axis(Axis(0)) else {
        bail!(Data, "principal components of no row at all");
    };
    let centred = rows - &mean;
    let (n, size) = centred.dim();
    let total: f64 = centred.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / n as f64;
    let most = keep.most.min(n.saturating_sub(1)).min(size);
    // What rounding leaves of rows that are alike is no variance.
    let level: f64 = mean.iter().map(|v| f64::from(*v).powi(2)).sum();
    let (vectors, variances) = if most == 0 || total <= 1e-12 * level || total <= 0.0 {
        (Array2::zeros((0, size)), Vec::new())
    } else if n.min(size) <= EXACT {
        exact(&centred)
    } else {
        leading(&centred, most)
    };
    let (mut kept, mut carried) = (0, 0.0);
    for variance in variances.iter().take(most) {
        if *variance <= LEAST_SHARE * total || carried >= f64::from(keep.share) * total {
            break;
        }
        carried += variance;
        kept += 1;
    }
    Ok(Linear {
        components: vectors.slice(s![..kept, ..]).to_owned(),
        variances: variances[..kept].iter().map(|v| *v as f32).collect(),
        mean,
    })
}

/// Eigenvalues of a symmetric matrix, the largest first, and its eigenvectors as columns.
fn eigen(matrix: &Array2<f64>) -> (Vec<f64>, Array2<f64>) {
    let n = matrix.nrows();
    let found = SymmetricEigen::new(DMatrix::from_fn(n, n, |a, b| matrix[(a, b)]));
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|a, b| found.eigenvalues[*b].total_cmp(&found.eigenvalues[*a]));
    let values = order.iter().map(|k| found.eigenvalues[*k].max(0.0)).collect();
    let vectors = Array2::from_shape_fn((n, n), |(row, k)| found.eigenvectors[(row, order[k])]);
    (values, vectors)
}

/// All components of centred rows that have any variance, and the variances.
fn exact(centred: &Array2<f32>) -> (Array2<f32>, Vec<f64>) {
    let (n, size) = centred.dim();
    let rows = centred.mapv(f64::from);
    let of_columns = size <= n;
    let gram = if of_columns {
        rows.t().dot(&rows)
    } else {
        rows.dot(&rows.t())
    };
    let (values, vectors) = eigen(&gram);
    let kept = values
        .iter()
        .take_while(|v| **v > LEAST_SHARE * values[0].max(f64::MIN_POSITIVE))
        .count();
    let mut out = Array2::zeros((kept, size));
    for k in 0..kept {
        let along = vectors.column(k);
        let vector = if of_columns {
            along.to_owned()
        } else {
            along.dot(&rows)
        };
        out.row_mut(k).assign(&unit(vector));
    }
    let variances = values[..kept].iter().map(|v| v / n as f64).collect();
    (out, variances)
}

/// The first `most` components of centred rows, and their variances.
fn leading(centred: &Array2<f32>, most: usize) -> (Array2<f32>, Vec<f64>) {
    let (n, size) = centred.dim();
    let block = (most + BEYOND).min(n.min(size));
    // The start is drawn, always the same: equal rows have equal components.
    let mut rng = Pcg64::seed_from_u64(1);
    let mut basis = Array2::from_shape_fn((block, size), |_| rng.random_range(-1.0f32..1.0));
    orthonormal(&mut basis);
    for _ in 0..ITERATIONS {
        basis = centred.dot(&basis.t()).t().dot(centred);
        orthonormal(&mut basis);
    }
    let inside = centred.dot(&basis.t()).mapv(f64::from);
    let (values, vectors) = eigen(&inside.t().dot(&inside));
    let turned = vectors.mapv(|v| v as f32).t().dot(&basis);
    let mut out = Array2::zeros((most, size));
    for (mut row, found) in out.outer_iter_mut().zip(turned.outer_iter()) {
        row.assign(&unit(found.mapv(f64::from)));
    }
    (out, values[..most].iter().map(|v| v / n as f64).collect())
}

/// A vector of length 1, whose largest number is positive: signs are arbitrary, and results shall be comparable.
fn unit(vector: Array1<f64>) -> Array1<f32> {
    let largest = vector
        .iter()
        .copied()
        .fold(0.0, |best: f64, v| if v.abs() > best.abs() { v } else { best });
    let scale = largest.signum() / vector.dot(&vector).sqrt().max(f64::MIN_POSITIVE);
    vector.mapv(|v| (v * scale) as f32)
}

/// Makes rows orthonormal one after the other, twice over, since once leaves what rounding has done.
fn orthonormal(rows: &mut Array2<f32>) {
    for _ in 0..2 {
        for k in 0..rows.nrows() {
            let (before, mut rest) = rows.view_mut().split_at(Axis(0), k);
            let mut row = rest.row_mut(0);
            let along = before.dot(&row);
            let inside = along.dot(&before);
            row -= &inside;
            let norm = row.dot(&row).sqrt();
            row /= norm.max(f32::MIN_POSITIVE);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: Keep = Keep {
        share: 1.0,
        most: usize::MAX,
    };

    /// Rows of `size` numbers that vary along `patterns` drawn directions, each less than the one before, and a little along all.
    fn rows(n: usize, size: usize, patterns: usize) -> Array2<f32> {
        let mut rng = Pcg64::seed_from_u64(7);
        let basis = Array2::from_shape_fn((patterns, size), |_| rng.random_range(-1.0f32..1.0));
        let strength = Array2::from_shape_fn((n, patterns), |(_, k)| {
            rng.random_range(-1.0f32..1.0) * 0.8f32.powi(k as i32)
        });
        let noise = Array2::from_shape_fn((n, size), |_| rng.random_range(-0.02f32..0.02));
        strength.dot(&basis) + noise + 3.0
    }

    #[test]
    fn all_components_give_every_row_back() {
        for (n, size) in [(40, 9), (9, 40)] {
            let rows = rows(n, size, 6);
            let model = components(&rows, ALL).unwrap();
            assert!(model.modes() <= n.min(size));
            for row in rows.outer_iter() {
                let back = model.expand(model.project(row).view());
                assert!((&back - &row).iter().all(|d| d.abs() < 1e-3));
            }
            let product = model.components.dot(&model.components.t());
            let off = &product - &Array2::<f32>::eye(model.modes());
            assert!(off.iter().all(|d| d.abs() < 1e-5));
            // The variance along a component is that of the rows' parameters.
            let first = model.components.row(0).to_owned();
            let parameters: Array1<f32> = rows
                .outer_iter()
                .map(|row| first.dot(&(&row - &model.mean)))
                .collect();
            let variance = parameters.mapv(|b| b * b).mean().unwrap();
            assert!((variance / model.variances[0] - 1.0).abs() < 1e-3);
        }
    }

    #[test]
    fn many_long_rows_have_the_components_of_the_exact_way() {
        let rows = rows(300, 400, 12);
        let keep = Keep { share: 1.0, most: 10 };
        let found = components(&rows, keep).unwrap();
        let (wanted, variances) = exact(&(&rows - &found.mean));
        assert_eq!(found.modes(), 10);
        for k in 0..10 {
            let along = found.components.row(k).dot(&wanted.row(k));
            assert!(along > 0.9999, "component {k}: {along}");
            assert!((f64::from(found.variances[k]) / variances[k] - 1.0).abs() < 1e-3);
        }
    }

    #[test]
    fn as_many_are_kept_as_carry_the_share() {
        let mut rows = Array2::zeros((8, 3));
        for (n, mut row) in rows.outer_iter_mut().enumerate() {
            let sign = |bit: usize| if n >> bit & 1 == 1 { 1.0 } else { -1.0 };
            row.assign(&ndarray::array![3.0 * sign(0), sign(1), 0.1 * sign(2)]);
        }
        // Variances 9, 1 and 0.01.
        let modes = |share: f32, most: usize| components(&rows, Keep { share, most }).unwrap().modes();
        assert_eq!(
            (modes(0.85, 9), modes(0.95, 9), modes(1.0, 9), modes(1.0, 2)),
            (1, 2, 3, 2)
        );
    }

    #[test]
    fn rows_that_are_alike_have_no_component() {
        let alike = Array2::from_elem((5, 4), 123.456);
        assert_eq!(components(&alike, ALL).unwrap().modes(), 0);
        assert_eq!(
            components(&Array2::from_elem((1, 4), 2.0), ALL).unwrap().modes(),
            0
        );
        assert!(components(&Array2::zeros((0, 4)), ALL).is_err());
    }
}
