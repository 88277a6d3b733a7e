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
        Self::of_voice(1.0)
    }
}

/// A warp of the vocal tract's length holds up to this share of half the sampling rate; above, it bends so that 8 kHz stays where it is.
const WARPED: f64 = 0.8;

impl Filterbank {
    /// Channels that hear a voice as if all its frequencies were `factor` times as high: above 1 a shorter vocal tract, as of women and children.
    pub fn of_voice(factor: f64) -> Self {
        Self::of_points(FFT_POINTS, factor)
    }

    /// [`Filterbank::of_voice`] over the magnitudes of a transform of `points` points.
    pub fn of_points(points: usize, factor: f64) -> Self {
        let half = f64::from(lipstream_core::SAMPLE_RATE_HZ) / 2.0;
        let edge = WARPED * half * (1.0 / factor).min(1.0);
        let warped = |hz: f64| match hz <= edge {
            true => factor * hz,
            false => factor * edge + (half - factor * edge) / (half - edge) * (hz - edge),
        };
        let rate = f64::from(lipstream_core::SAMPLE_RATE_HZ);
        let spacing = mel(rate / 2.0) / (N_MEL + 1) as f64;
        let below = (1..points / 2)
            .map(|bin| {
                let position = mel(warped(bin as f64 * rate / points as f64)) / spacing;
                let channel = (position.floor() as usize).min(N_MEL);
                (channel, (channel + 1) as f64 - position)
            })
            .collect();
        Self { below }
    }

    /// Points of the transform whose magnitudes it sums.
    pub fn points(&self) -> usize {
        2 * (self.below.len() + 1)
    }

    /// Channel below each bin, counted from 1 (0 = none), and its share of the bin; bins 1..=255 of the front end's own transform.
    pub fn shares(&self) -> &[(usize, f64)] {
        &self.below
    }

    /// 26 channel sums of the transform's magnitudes (257 of the front end's own).
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Channel with the largest sum when a single bin sounds.
    fn loudest(bank: &Filterbank, bin: usize) -> usize {
        let mut magnitudes = [0.0; FFT_POINTS / 2 + 1];
        magnitudes[bin] = 1.0;
        let sums = bank.apply(&magnitudes);
        (0..N_MEL).max_by(|a, b| sums[*a].total_cmp(&sums[*b])).unwrap()
    }

    #[test]
    fn another_voice_is_heard_higher_or_lower() {
        let (own, short, long) = (
            Filterbank::default(),
            Filterbank::of_voice(1.2),
            Filterbank::of_voice(0.85),
        );
        assert_eq!(own.shares(), Filterbank::of_voice(1.0).shares());
        for bin in [30, 60, 100, 180] {
            let [own_at, up, down] = [&own, &short, &long].map(|bank| loudest(bank, bin));
            assert!(up > own_at && down < own_at, "{bin}: {down} {own_at} {up}");
        }
        // What a tone of 1.2 times the frequency is to one voice, the tone itself is to the other.
        assert_eq!(loudest(&short, 100), loudest(&own, 120));
        // Nothing falls off the upper end.
        assert!(
            [&own, &short, &long]
                .iter()
                .all(|bank| loudest(bank, N_BINS) == N_MEL - 1)
        );
    }
}
