//! Pre-emphasis inside the window: s\[i\] −= 0.97·s\[i−1\], s\[0\] ×= 1 − 0.97 (HTK's `PREEMCOEF`).

/// Share of the previous sample that is taken off.
pub const COEFFICIENT: f64 = 0.97;

/// Pre-emphasises one window in place.
pub fn apply(frame: &mut [f64]) {
    for i in (1..frame.len()).rev() {
        frame[i] -= COEFFICIENT * frame[i - 1];
    }
    if let Some(first) = frame.first_mut() {
        *first *= 1.0 - COEFFICIENT;
    }
}
