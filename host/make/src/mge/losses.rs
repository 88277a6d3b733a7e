//! Errors of a filmed mouth beside the squared error of each frame (M10): of its motion, and of what is read off it.
use ndarray::{Array2, ArrayView1, ArrayView2};

/// κ Σ_t Σ_d w_d (e_t − e_{t−1})²: a mouth that trembles errs little in each frame and much from frame to frame.
///
/// `wrong` `[T, D]` is e. The gradient, divided by the batch's `n` frames, is added to `pull` `[T, D]`.
pub(super) fn motion(
    wrong: ArrayView2<f32>,
    weights: &[f32],
    kappa: f32,
    n: f32,
    pull: &mut Array2<f32>,
) -> f64 {
    let mut error = 0.0;
    if kappa == 0.0 {
        return error;
    }
    for t in 1..wrong.nrows() {
        for (d, weight) in weights.iter().enumerate() {
            let change = wrong[[t, d]] - wrong[[t - 1, d]];
            error += f64::from(kappa * weight * change * change);
            let by = 2.0 * kappa * weight * change / n;
            pull[[t, d]] += by;
            pull[[t - 1, d]] -= by;
        }
    }
    error
}

/// κ Σ_t (r·e_t)²: the error of what `slopes` `[D]`, r, read off a mouth, such as the lip gap, which people look at more than at the rest of the picture.
pub(super) fn along(
    wrong: ArrayView2<f32>,
    slopes: ArrayView1<f32>,
    kappa: f32,
    n: f32,
    pull: &mut Array2<f32>,
) -> f64 {
    let mut error = 0.0;
    if kappa == 0.0 {
        return error;
    }
    for (e, mut pull) in wrong.dot(&slopes).iter().zip(pull.outer_iter_mut()) {
        error += f64::from(kappa * e * e);
        pull.scaled_add(2.0 * kappa * e / n, &slopes);
    }
    error
}

#[cfg(test)]
mod tests {
    use ndarray::arr1;
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::*;
    use lipstream::random::normal;

    const N: f32 = 5.0;

    /// The gradient of `loss`, which is `n` times the loss of a batch, against differences in every number.
    fn check(loss: impl Fn(&Array2<f32>, &mut Array2<f32>) -> f64) {
        let mut rng = Pcg64::seed_from_u64(3);
        let wrong = Array2::from_shape_fn((7, 3), |_| normal(&mut rng));
        let mut pull = Array2::zeros(wrong.dim());
        assert!(loss(&wrong, &mut pull) > 0.0);
        for (place, have) in pull.indexed_iter() {
            let at = |step: f32| {
                let mut moved = wrong.clone();
                moved[place] += step;
                loss(&moved, &mut Array2::zeros(wrong.dim()))
            };
            // Exact for a square, but for rounding.
            let expected = (at(0.25) - at(-0.25)) / 0.5 / f64::from(N);
            assert!(
                (f64::from(*have) - expected).abs() < 1e-4,
                "{place:?}: {have}, {expected} by differences"
            );
        }
    }

    #[test]
    fn the_gradient_of_motion_is_its_slope() {
        check(|wrong, pull| motion(wrong.view(), &[0.5, 0.3, 0.2], 0.7, N, pull));
        // A mouth that is off by the same all the time moves as it should.
        let off = Array2::from_elem((4, 3), 2.0);
        let mut pull = Array2::zeros((4, 3));
        assert_eq!(motion(off.view(), &[1.0; 3], 1.0, N, &mut pull), 0.0);
        assert!(pull.iter().all(|p| *p == 0.0));
    }

    #[test]
    fn the_gradient_along_a_reading_is_its_slope() {
        let slopes = arr1(&[0.6, -0.8, 0.0]);
        check(|wrong, pull| along(wrong.view(), slopes.view(), 0.4, N, pull));
        // What the reading does not see costs nothing.
        let unseen = Array2::from_shape_fn((2, 3), |(_, d)| [0.8, 0.6, 5.0][d]);
        let error = along(unseen.view(), slopes.view(), 1.0, N, &mut Array2::zeros((2, 3)));
        assert!(error < 1e-10, "{error}");
    }
}
