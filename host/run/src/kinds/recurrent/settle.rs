//! The core's `mge::settle` in floats: a mouth that hardly moves is followed slowly.
use ndarray::Array2;

/// Root mean square way, in deviations, of a mouth that is followed at once.
const LEAST_MOTION: f32 = 0.1;
/// Least share of its way that a mouth goes in a frame.
const LEAST_SHARE: f32 = 1.0 / 16.0;

/// Settles mouths `[frames, D]`, one after the other; `deviation` is that of each parameter.
pub fn settle(parameters: &mut Array2<f32>, deviation: &[f32]) {
    for t in 1..parameters.nrows() {
        let (before, mut now) = parameters.multi_slice_mut((ndarray::s![t - 1, ..], ndarray::s![t, ..]));
        let squares = now
            .iter()
            .zip(&before)
            .zip(deviation)
            .map(|((y, s), d)| ((y - s) / d).powi(2));
        let mean = squares.sum::<f32>() / deviation.len() as f32;
        let share = (mean / LEAST_MOTION.powi(2)).clamp(LEAST_SHARE, 1.0);
        now.zip_mut_with(&before, |y, s| *y = s + share * (*y - s));
    }
}
