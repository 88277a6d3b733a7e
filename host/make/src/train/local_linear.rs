//! Local linear visual densities fitted: the context's whitened projection and the ridge maps of
//! [`lipstream::kinds::likelihood::local_linear`].
use crate::error::{Error, Result};
use lipstream::kinds::likelihood::local_linear::with_bias;
use lipstream::kinds::likelihood::{ContextMap, LocalLinear};
use nalgebra::DMatrix;
use ndarray::{Array1, Array2, Array3, Axis};

/// Sums for a whitened PCA of stacked statics.
pub struct ContextSums {
    n: f64,
    first: Array1<f64>,
    second: Array2<f64>,
}

impl ContextSums {
    /// Empty sums for rows of `stacked` numbers.
    pub fn new(stacked: usize) -> Self {
        Self {
            n: 0.0,
            first: Array1::zeros(stacked),
            second: Array2::zeros((stacked, stacked)),
        }
    }

    /// Adds the rows of one utterance.
    pub fn add(&mut self, rows: &Array2<f32>) {
        self.n += rows.nrows() as f64;
        self.first += &rows.sum_axis(Axis(0)).mapv(f64::from);
        self.second += &rows.t().dot(rows).mapv(f64::from);
    }

    /// The `size` largest principal components, scaled to variance one.
    pub fn solve(&self, taps: &[i32], size: usize) -> Result<ContextMap> {
        let d = self.first.len();
        if self.n < 2.0 || size == 0 || size > d {
            return Err(Error::Numbers(format!(
                "cannot find {size} context components in {} frames of {d} numbers",
                self.n
            )));
        }
        let mean = &self.first / self.n;
        let covariance = DMatrix::from_fn(d, d, |i, j| self.second[[i, j]] / self.n - mean[i] * mean[j]);
        let eigen = covariance.symmetric_eigen();
        let mut order: Vec<usize> = (0..d).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let mut projection = Array2::zeros((size, d));
        for (row, &column) in order.iter().take(size).enumerate() {
            let deviation = eigen.eigenvalues[column].max(1e-9).sqrt();
            // An eigenvector's sign is arbitrary: make its largest entry positive, so that runs agree.
            let vector = eigen.eigenvectors.column(column);
            let largest = vector
                .iter()
                .fold(0.0f64, |m, v| if v.abs() > m.abs() { *v } else { m });
            for i in 0..d {
                projection[[row, i]] = (vector[i] * largest.signum() / deviation) as f32;
            }
        }
        Ok(ContextMap {
            taps: taps.to_vec(),
            mean: mean.mapv(|v| v as f32),
            projection,
        })
    }
}

/// Sums for the global map and the residual map of every visual state.
pub struct MapSums {
    /// Σ x xᵀ and Σ x vᵀ over all frames, bias in x.
    all: Ridge,
    state: Vec<Ridge>,
}

#[derive(Clone)]
struct Ridge {
    xx: Array2<f64>,
    xv: Array2<f64>,
}

impl Ridge {
    fn new(x: usize, d: usize) -> Self {
        Self {
            xx: Array2::zeros((x, x)),
            xv: Array2::zeros((x, d)),
        }
    }

    fn add(&mut self, x: &Array2<f32>, v: &Array2<f32>) {
        self.xx += &x.t().dot(x).mapv(f64::from);
        self.xv += &x.t().dot(v).mapv(f64::from);
    }

    /// argmin Σ|v − Wx|² + penalty·|W|² (bias included), `[D, X + 1]`.
    fn solve(&self, penalty: f64) -> Result<Array2<f64>> {
        let n = self.xx.nrows();
        let a = DMatrix::from_fn(n, n, |i, j| self.xx[[i, j]] + if i == j { penalty } else { 0.0 });
        let b = DMatrix::from_fn(n, self.xv.ncols(), |i, j| self.xv[[i, j]]);
        let w = a
            .cholesky()
            .ok_or_else(|| Error::Numbers("ridge regression on singular data".into()))?
            .solve(&b);
        Ok(Array2::from_shape_fn((self.xv.ncols(), n), |(i, j)| w[(j, i)]))
    }
}

impl MapSums {
    /// Empty sums for contexts of `x` numbers, mouths of `d` parameters and so many visual states.
    pub fn new(x: usize, d: usize, states: usize) -> Self {
        Self {
            all: Ridge::new(x + 1, d),
            state: vec![Ridge::new(x + 1, d); states],
        }
    }

    /// Adds one utterance: context `[frames, X]`, visual `[frames, D]`, occupancies `[frames, visual states]`.
    pub fn add(&mut self, x: &Array2<f32>, visual: &Array2<f32>, occupancy: &Array2<f32>) {
        let x = with_bias(x);
        self.all.add(&x, visual);
        for (state, sums) in self.state.iter_mut().enumerate() {
            let frames: Vec<usize> = (0..x.nrows()).filter(|&t| occupancy[[t, state]] > 1e-3).collect();
            if frames.is_empty() {
                continue;
            }
            let root =
                Array1::from_iter(frames.iter().map(|&t| occupancy[[t, state]].sqrt())).insert_axis(Axis(1));
            sums.add(
                &(x.select(Axis(0), &frames) * &root),
                &(visual.select(Axis(0), &frames) * &root),
            );
        }
    }

    /// Adds the sums of other utterances, of the same shape.
    pub fn merge(&mut self, other: &MapSums) {
        self.all.xx += &other.all.xx;
        self.all.xv += &other.all.xv;
        for (mine, theirs) in self.state.iter_mut().zip(&other.state) {
            mine.xx += &theirs.xx;
            mine.xv += &theirs.xv;
        }
    }

    /// Global ridge map, then per state a residual map shrunk towards zero with `penalty` frames' weight.
    pub fn solve(&self, global_penalty: f64, penalty: f64) -> Result<LocalLinear> {
        let global = self.all.solve(global_penalty)?;
        let (d, x) = global.dim();
        let mut state = Array3::zeros((self.state.len(), d, x));
        for (index, sums) in self.state.iter().enumerate() {
            // Residuals v − W₀x: Σ x(v − W₀x)ᵀ = Σ xvᵀ − Σ xxᵀ·W₀ᵀ.
            let residual = Ridge {
                xx: sums.xx.clone(),
                xv: &sums.xv - &sums.xx.dot(&global.t()),
            };
            state
                .index_axis_mut(Axis(0), index)
                .assign(&residual.solve(penalty)?.mapv(|v| v as f32));
        }
        Ok(LocalLinear {
            global: global.mapv(|v| v as f32),
            state,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lipstream::kinds::likelihood::local_linear::apply;
    use ndarray::array;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn the_context_is_white() {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(5);
        let rows = Array2::from_shape_fn((500, 6), |(_, j)| {
            rng.random_range(-1.0f32..1.0) * (j + 1) as f32 + 3.0
        });
        let mut sums = ContextSums::new(6);
        sums.add(&rows);
        let context = sums.solve(&[0, 1, 2], 4).unwrap();
        let x = (rows - &context.mean).dot(&context.projection.t());
        let covariance = x.t().dot(&x) / 500.0;
        for ((i, j), v) in covariance.indexed_iter() {
            assert!((v - f32::from(u8::from(i == j))).abs() < 1e-3, "{covariance}");
        }
    }

    #[test]
    fn maps_recover_what_made_the_data() {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(6);
        let truth = [
            array![[1.0f32, 2.0, 0.5], [0.0, -1.0, 1.0]],
            array![[-1.0f32, 0.5, 0.0], [2.0, 1.0, -1.0]],
        ];
        let x = Array2::from_shape_fn((4000, 2), |_| rng.random_range(-1.0f32..1.0));
        let mut occupancy = Array2::zeros((4000, 2));
        let mut v = Array2::zeros((4000, 2));
        let biased = with_bias(&x);
        for t in 0..4000 {
            let state = usize::from(rng.random_bool(0.5));
            occupancy[[t, state]] = 1.0;
            v.row_mut(t).assign(&truth[state].dot(&biased.row(t)));
        }
        let mut sums = MapSums::new(2, 2, 2);
        sums.add(&x, &v, &occupancy);
        let maps = sums.solve(1e-3, 1e-3).unwrap();
        let said = apply(&maps, &x, &occupancy);
        assert!((&said - &v).iter().all(|d| d.abs() < 1e-3));
    }

    #[test]
    fn a_state_without_data_adds_nothing() {
        let sums = {
            let mut sums = MapSums::new(2, 1, 3);
            let x = array![[1.0f32, 0.0], [0.0, 1.0], [1.0, 1.0]];
            sums.add(
                &x,
                &array![[1.0f32], [2.0], [3.0]],
                &array![[1.0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            );
            sums
        };
        let maps = sums.solve(1.0, 1.0).unwrap();
        assert!(maps.state.index_axis(Axis(0), 2).iter().all(|w| *w == 0.0));
    }
}
