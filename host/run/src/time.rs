//! The time axis, in one place: frames, samples and seconds.
//!
//! Frame t is what the window of samples 160·t to 160·t + 399 says; it belongs to the window's centre, sample 160·t + 200.
use lipstream_core::{FRAME_SAMPLES, HOP_SAMPLES, SAMPLE_RATE_HZ};

/// Parameter frames a second.
pub const FRAME_RATE_HZ: usize = SAMPLE_RATE_HZ as usize / HOP_SAMPLES;

/// Whole windows in `samples` samples.
pub fn frame_count(samples: usize) -> usize {
    match samples.checked_sub(FRAME_SAMPLES) {
        Some(rest) => rest / HOP_SAMPLES + 1,
        None => 0,
    }
}

/// Samples that `frames` frames cover, from the first window's start to the last one's end.
pub fn samples_covered(frames: usize) -> usize {
    match frames {
        0 => 0,
        n => (n - 1) * HOP_SAMPLES + FRAME_SAMPLES,
    }
}

/// Sample at the centre of a frame's window.
pub fn frame_sample(frame: usize) -> usize {
    frame * HOP_SAMPLES + FRAME_SAMPLES / 2
}

/// The centre of a frame's window, seconds.
pub fn frame_seconds(frame: usize) -> f64 {
    seconds(frame_sample(frame))
}

/// Half-way between the centres of a frame and of the one before it, seconds.
pub fn border_seconds(frame: usize) -> f64 {
    (frame_sample(frame) as f64 - HOP_SAMPLES as f64 / 2.0) / f64::from(SAMPLE_RATE_HZ)
}

/// The frame, fractions included, whose centre a moment is.
pub fn frame_at(seconds: f64) -> f64 {
    (seconds * f64::from(SAMPLE_RATE_HZ) - FRAME_SAMPLES as f64 / 2.0) / HOP_SAMPLES as f64
}

/// How long so many samples last.
pub fn seconds(samples: usize) -> f64 {
    samples as f64 / f64::from(SAMPLE_RATE_HZ)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_and_samples_agree() {
        for frames in [1, 2, 77] {
            assert_eq!(frame_count(samples_covered(frames)), frames);
            assert_eq!(frame_count(samples_covered(frames) - 1), frames - 1);
            assert!((frame_at(frame_seconds(frames)) - frames as f64).abs() < 1e-9);
        }
        assert_eq!((frame_count(399), samples_covered(0)), (0, 0));
        assert_eq!(frame_seconds(0), 0.0125);
        assert_eq!(border_seconds(1), 0.0175);
    }
}
