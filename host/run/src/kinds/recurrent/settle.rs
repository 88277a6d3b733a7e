//! The core's `mge::settle` in floats: a mouth that hardly moves is followed slowly.
use ndarray::Array2;

/// Root mean square way, in deviations, of a mouth that is followed at once.
const LEAST_MOTION: f32 = 0.1;
/// Least share of its way that a mouth goes in a frame.
const LEAST_SHARE: f32 = 1.0 / 16.0;

/// Moves `now` (`[D]`) to where a stream shows it after `before`, the mouth that it has shown last.
pub fn settle_frame(before: &[f32], now: &mut [f32], deviation: &[f32]) {
    let squares = now
        .iter()
        .zip(before)
        .zip(deviation)
        .map(|((y, s), d)| ((y - s) / d).powi(2));
    let mean = squares.sum::<f32>() / deviation.len() as f32;
    let share = (mean / LEAST_MOTION.powi(2)).clamp(LEAST_SHARE, 1.0);
    for (y, s) in now.iter_mut().zip(before) {
        *y = s + share * (*y - s);
    }
}

/// Settles mouths `[frames, D]`, one after the other; `deviation` is that of each parameter.
pub fn settle(parameters: &mut Array2<f32>, deviation: &[f32]) {
    for t in 1..parameters.nrows() {
        let before = parameters.row(t - 1).to_vec();
        let mut now = parameters.row(t).to_vec();
        settle_frame(&before, &mut now, deviation);
        parameters.row_mut(t).assign(&ndarray::aview1(&now));
    }
}
