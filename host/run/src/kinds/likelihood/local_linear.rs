//! Local linear visual densities (`docs/design.md` section 6; COS eq. 9-11 with the cluster chosen by the HMM):
//! ôᵛ_t = W₀x_t + b₀ + Σ_v γ_t(v)·(W_v x_t + b_v), x a whitened projection of stacked cepstra.
use ndarray::{Array2, ArrayView2, Axis, s};

use super::{ContextMap, LocalLinear};

/// Statics of the frames t + taps side by side, `[frames, taps·13]`; edges replicated.
pub fn stack(statics: ArrayView2<f32>, taps: &[i32]) -> Array2<f32> {
    let (frames, n) = statics.dim();
    let mut out = Array2::zeros((frames, taps.len() * n));
    for t in 0..frames {
        for (k, &tap) in taps.iter().enumerate() {
            let from = (t as i64 + i64::from(tap)).clamp(0, frames as i64 - 1) as usize;
            out.slice_mut(s![t, k * n..(k + 1) * n])
                .assign(&statics.row(from));
        }
    }
    out
}

/// x_t of every frame, `[frames, X]`.
pub fn project(context: &ContextMap, statics: ArrayView2<f32>) -> Array2<f32> {
    (stack(statics, &context.taps) - &context.mean).dot(&context.projection.t())
}

/// The maps applied under occupancies `[frames, visual states]`.
pub fn apply(maps: &LocalLinear, x: &Array2<f32>, occupancy: &Array2<f32>) -> Array2<f32> {
    let x = with_bias(x);
    let mut out = x.dot(&maps.global.t());
    for (t, gamma) in occupancy.outer_iter().enumerate() {
        for (state, &g) in gamma.iter().enumerate() {
            // An occupancy this small moves nothing by a visible amount.
            if g > 1e-4 {
                let residual = maps.state.index_axis(Axis(0), state).dot(&x.row(t));
                out.row_mut(t).scaled_add(g, &residual);
            }
        }
    }
    out
}

/// `x` with a column of ones behind it.
pub fn with_bias(x: &Array2<f32>) -> Array2<f32> {
    ndarray::concatenate(Axis(1), &[x.view(), Array2::ones((x.nrows(), 1)).view()])
        .expect("a column of ones has as many rows")
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn stacking_replicates_the_edges() {
        let statics = array![[1.0f32, 10.0], [2.0, 20.0], [3.0, 30.0]];
        let stacked = stack(statics.view(), &[-1, 0, 2]);
        assert_eq!(stacked.row(0).to_vec(), [1.0, 10.0, 1.0, 10.0, 3.0, 30.0]);
        assert_eq!(stacked.row(2).to_vec(), [2.0, 20.0, 3.0, 30.0, 3.0, 30.0]);
    }
}
