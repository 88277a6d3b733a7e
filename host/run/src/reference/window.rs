//! Hamming window over N − 1: w\[i\] = 0.54 − 0.46·cos(2πi/(N−1)), N = 400.
use lipstream_core::FRAME_SAMPLES;

/// The 400 weights, in [0.08, 1].
pub fn hamming() -> Vec<f64> {
    hamming_of(FRAME_SAMPLES)
}

/// A window of `samples` weights, two at least.
pub fn hamming_of(samples: usize) -> Vec<f64> {
    let step = std::f64::consts::TAU / (samples - 1) as f64;
    (0..samples)
        .map(|i| 0.54 - 0.46 * (step * i as f64).cos())
        .collect()
}

/// Weighs one window in place.
pub fn apply(frame: &mut [f64], window: &[f64]) {
    for (x, w) in frame.iter_mut().zip(window) {
        *x *= w;
    }
}
