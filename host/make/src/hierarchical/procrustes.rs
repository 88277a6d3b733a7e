//! Shapes laid onto each other by translation and rotation, not by scale (COS section 4.1): size is information about a shape when the camera stands still.
//!
//! Generalised Procrustes analysis: every centred shape is turned to the mean, the mean is taken anew and turned back to the reference, until it
//! stays. The best angle in the least-squares sense is atan2(Σ xᵢ·y'ᵢ − yᵢ·x'ᵢ, Σ xᵢ·x'ᵢ + yᵢ·y'ᵢ) from a shape (x, y) to a mean (x', y').
use ndarray::{Array1, Array2, ArrayView1, ArrayViewMut1, Axis};

use crate::error::{Result, bail};

/// Rounds after which the mean is taken as it is; it settles within a few.
const ROUNDS: usize = 50;
/// The mean has settled when no landmark moves by more, in pixels.
const SETTLED: f32 = 1e-4;

/// Shapes around the origin and their mean.
#[derive(Clone, Debug)]
pub struct Aligned {
    /// x₀, y₀, x₁, …, one row a shape.
    pub shapes: Array2<f32>,
    /// Their mean, turned as the reference is.
    pub mean: Array1<f32>,
}

/// Aligns `shapes` `[n, 2 × landmarks]`; the mean will be turned as `reference` is, of an area the mean shape that its parent has of it, else any of the shapes.
///
/// # Errors
///
/// No shape, or a reference of another number of landmarks.
pub fn align(shapes: &Array2<f32>, reference: ArrayView1<f32>) -> Result<Aligned> {
    if shapes.is_empty() || shapes.ncols() != reference.len() || !reference.len().is_multiple_of(2) {
        bail!(
            Data,
            "{} shapes of {} numbers cannot be aligned with one of {}",
            shapes.nrows(),
            shapes.ncols(),
            reference.len()
        );
    }
    let mut reference = reference.to_owned();
    centre(reference.view_mut());
    let mut shapes = shapes.clone();
    shapes.outer_iter_mut().for_each(centre);
    let mut mean = reference.clone();
    for _ in 0..ROUNDS {
        for mut shape in shapes.outer_iter_mut() {
            let angle = angle(shape.view(), mean.view());
            turn(&mut shape, angle);
        }
        let mut next = shapes.mean_axis(Axis(0)).expect("there is a shape");
        let back = angle(next.view(), reference.view());
        turn(&mut next.view_mut(), back);
        let moved = std::iter::zip(&next, &mean)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f32::max);
        mean = next;
        if moved < SETTLED {
            break;
        }
    }
    for mut shape in shapes.outer_iter_mut() {
        let angle = angle(shape.view(), mean.view());
        turn(&mut shape, angle);
    }
    Ok(Aligned { shapes, mean })
}

/// A shape laid onto a mean around the origin: moved, turned, not scaled.
pub fn laid(shape: ArrayView1<f32>, mean: ArrayView1<f32>) -> Array1<f32> {
    let mut shape = shape.to_owned();
    centre(shape.view_mut());
    let angle = angle(shape.view(), mean);
    turn(&mut shape.view_mut(), angle);
    shape
}

/// Moves a shape's centre of gravity to the origin.
fn centre(mut shape: ArrayViewMut1<f32>) {
    let count = (shape.len() / 2).max(1) as f32;
    for axis in 0..2 {
        let middle = shape.iter().skip(axis).step_by(2).sum::<f32>() / count;
        shape.iter_mut().skip(axis).step_by(2).for_each(|v| *v -= middle);
    }
}

/// The angle that a centred shape must be turned by to lie best on another; 0 for shapes without extent.
fn angle(from: ArrayView1<f32>, to: ArrayView1<f32>) -> f32 {
    let (mut across, mut along) = (0.0f64, 0.0f64);
    for k in (0..from.len()).step_by(2) {
        let [x, y, u, v] = [from[k], from[k + 1], to[k], to[k + 1]].map(f64::from);
        across += x * v - y * u;
        along += x * u + y * v;
    }
    across.atan2(along) as f32
}

fn turn(shape: &mut ArrayViewMut1<f32>, angle: f32) {
    let (sin, cos) = angle.sin_cos();
    for k in (0..shape.len()).step_by(2) {
        let (x, y) = (shape[k], shape[k + 1]);
        shape[k] = cos * x - sin * y;
        shape[k + 1] = sin * x + cos * y;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn moves_and_turns_are_undone_and_sizes_stay() {
        let base = array![0.0, 0.0, 10.0, 0.0, 12.0, 7.0, -1.0, 9.0];
        let mut shapes = Array2::zeros((5, 8));
        for (n, mut row) in shapes.outer_iter_mut().enumerate() {
            // The fourth and fifth are of other sizes.
            let size = [1.0, 1.0, 1.0, 0.8, 1.2][n];
            row.assign(&(&base * size));
            turn(&mut row, 0.4 * n as f32 - 0.9);
            for k in 0..8 {
                row[k] += [30.0, -7.0][k % 2] * n as f32;
            }
        }
        let aligned = align(&shapes, base.view()).unwrap();
        let mut wanted = base.clone();
        centre(wanted.view_mut());
        assert!((&aligned.mean - &wanted).iter().all(|d| d.abs() < 1e-3));
        for (row, size) in aligned.shapes.outer_iter().zip([1.0, 1.0, 1.0, 0.8, 1.2]) {
            assert!((&row - &(&wanted * size)).iter().all(|d| d.abs() < 1e-3));
        }
        // What is laid alone lies as it does among the others.
        for (shape, row) in shapes.outer_iter().zip(aligned.shapes.outer_iter()) {
            let alone = laid(shape, aligned.mean.view());
            assert!((&alone - &row).iter().all(|d| d.abs() < 1e-3));
        }
    }

    #[test]
    fn what_cannot_be_aligned_is_refused_and_points_without_extent_are_no_trouble() {
        assert!(align(&Array2::zeros((0, 4)), array![0.0, 0.0, 1.0, 1.0].view()).is_err());
        assert!(align(&Array2::zeros((2, 4)), array![0.0, 0.0].view()).is_err());
        let aligned = align(&Array2::from_elem((2, 4), 3.0), array![0.0, 0.0, 1.0, 1.0].view()).unwrap();
        assert!(aligned.mean.iter().all(|v| v.abs() < 1e-6));
    }
}
