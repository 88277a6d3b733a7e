//! Log energy of the raw window: E = ln max(Σ x², 1).
//!
//! HTK's floor for digital silence is −1e10; ours is 0, which only a window of zeros reaches.

/// E of one window of int16-scaled samples, with so much energy under it, in [0, 26.8].
pub fn log_energy(frame: &[f64], floor: f64) -> f64 {
    (frame.iter().map(|x| x * x).sum::<f64>() + floor).max(1.0).ln()
}
