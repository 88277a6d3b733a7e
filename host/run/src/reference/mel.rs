//! Mel filterbank: 26 triangles, equally wide and half overlapping in mel, over 0 Hz to 8 kHz.
//!
//! mel(f) = 1127·ln(1 + f/700). A bin between the centres of channels j and j + 1 gives the share
//! (m_{j+1} − m)/(m_{j+1} − m_j) of its magnitude to j and the rest to j + 1. As in HTK the bins at 0 Hz
//! and at 8 kHz belong to no channel.
use super::fft::FFT_POINTS;

/// Channels.
pub const N_MEL: usize = 26;

/// Bins of the transform that lie on a triangle: 1..=255.
pub const N_BINS: usize = FFT_POINTS / 2 - 1;

/// Frequency in mel.
pub fn mel(hz: f64) -> f64 {
    1127.0 * (1.0 + hz / 700.0).ln()
}

/// For bin 1 + i: the channel below it (0 = below the first centre) and that channel's share of it.
pub struct Filterbank {
    below: Vec<(usize, f64)>,
}

impl Default for Filterbank {
    fn default() -> Self {
        let rate = f64::from(lipstream_core::SAMPLE_RATE_HZ);
        let spacing = mel(rate / 2.0) / (N_MEL + 1) as f64;
        let below = (1..=N_BINS)
            .map(|bin| {
                let position = mel(bin as f64 * rate / FFT_POINTS as f64) / spacing;
                let channel = (position.floor() as usize).min(N_MEL);
                (channel, (channel + 1) as f64 - position)
            })
            .collect();
        Self { below }
    }
}

impl Filterbank {
    /// Channel below each bin, counted from 1 (0 = none), and its share of the bin; bins 1..=255.
    pub fn shares(&self) -> &[(usize, f64)] {
        &self.below
    }

    /// 26 channel sums of 257 magnitudes.
    pub fn apply(&self, magnitudes: &[f64]) -> [f64; N_MEL] {
        let mut sums = [0.0; N_MEL];
        for (&(channel, share), &magnitude) in self.below.iter().zip(&magnitudes[1..]) {
            let lower = share * magnitude;
            if channel > 0 {
                sums[channel - 1] += lower;
            }
            if channel < N_MEL {
                sums[channel] += magnitude - lower;
            }
        }
        sums
    }
}
