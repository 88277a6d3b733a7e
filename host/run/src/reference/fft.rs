//! Magnitudes of the 512-point transform of a window padded with zeros.
use std::sync::Arc;

use realfft::{RealFftPlanner, RealToComplex};

/// Points of the transform.
pub const FFT_POINTS: usize = 512;

/// The transform and its scratch space.
pub struct Magnitude {
    plan: Arc<dyn RealToComplex<f64>>,
}

impl Default for Magnitude {
    fn default() -> Self {
        Self::of_points(FFT_POINTS)
    }
}

impl Magnitude {
    /// The transform of `points` points.
    pub fn of_points(points: usize) -> Self {
        Self {
            plan: RealFftPlanner::new().plan_fft_forward(points),
        }
    }

    /// |X\[k\]| for k from 0 to half the number of points (256 of the front end's own).
    pub fn magnitudes(&self, frame: &[f64]) -> Vec<f64> {
        let mut input = self.plan.make_input_vec();
        input[..frame.len()].copy_from_slice(frame);
        let mut spectrum = self.plan.make_output_vec();
        self.plan
            .process(&mut input, &mut spectrum)
            .expect("buffers made by the plan itself");
        spectrum.iter().map(|x| x.norm()).collect()
    }
}
