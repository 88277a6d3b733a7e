//! Δ by regression over ±2 frames: d_t = Σ_{k=1,2} k·(c_{t+k} − c_{t−k}) / 10, edges replicated.
use ndarray::{Array2, ArrayView2};

/// Frames on each side.
pub const WIDTH: usize = 2;

/// Δ of every column, same shape. ΔΔ is Δ of Δ, whose edges are replicated in turn (as HTK does).
pub fn deltas(columns: ArrayView2<f64>) -> Array2<f64> {
    let last = columns.nrows().saturating_sub(1);
    let norm: usize = 2 * (1..=WIDTH).map(|k| k * k).sum::<usize>();
    Array2::from_shape_fn(columns.dim(), |(t, i)| {
        (1..=WIDTH)
            .map(|k| k as f64 * (columns[[(t + k).min(last), i]] - columns[[t.saturating_sub(k), i]]))
            .sum::<f64>()
            / norm as f64
    })
}
