//! Speech as the hierarchical model hears it (section 3): 12 mel-cepstra a picture from a Hamming window of 40 ms.
//!
//! At 25 pictures a second the windows lie side by side: picture n hears samples 640·n to 640·n + 639. Pre-emphasis, the 26 triangles, the logarithm, cosines and lifter
//! are the front end's own (`reference`), over a transform of 1024 points; so is the floor under every sound, without which silence would be anything.
use lipstream_core::{N_CEPSTRA, SAMPLE_RATE_HZ};
use ndarray::{Array2, ArrayView1};

use crate::reference::{dct, fft, floor, log, mel, preemphasis, window};

/// Samples of a window: 40 ms.
pub const WINDOW: usize = 640;
/// Points of the transform.
const POINTS: usize = 1024;
/// Pictures a second that speech is turned into.
pub const PICTURES_HZ: u32 = SAMPLE_RATE_HZ / WINDOW as u32;

/// Everything that does not depend on the sound.
pub struct Cepstra {
    window: Vec<f64>,
    fft: fft::Magnitude,
    mel: mel::Filterbank,
    floor: [f64; mel::N_MEL],
    dct: dct::Cosines,
}

impl Default for Cepstra {
    fn default() -> Self {
        let window = window::hamming_of(WINDOW);
        let mel = mel::Filterbank::of_points(POINTS, 1.0);
        Self {
            floor: floor::channels(&mel, &window),
            fft: fft::Magnitude::of_points(POINTS),
            dct: dct::Cosines::default(),
            window,
            mel,
        }
    }
}

impl Cepstra {
    /// c1..c12 of a window of [`WINDOW`] samples.
    pub fn window(&self, samples: &[i16]) -> [f32; N_CEPSTRA] {
        let mut frame: Vec<f64> = samples.iter().map(|s| f64::from(*s)).collect();
        frame.resize(WINDOW, 0.0);
        preemphasis::apply(&mut frame);
        window::apply(&mut frame, &self.window);
        let mut channels = self.mel.apply(&self.fft.magnitudes(&frame));
        for (channel, floor) in channels.iter_mut().zip(&self.floor) {
            *channel += floor;
        }
        self.dct.cepstra(&log::log_mel(&channels)).map(|c| c as f32)
    }

    /// One row for each of `pictures` pictures of a whole sound, `rate_hz` a second, the window around the middle of each; beyond the sound there is silence.
    pub fn of_pictures(&self, samples: &[i16], pictures: usize, rate_hz: f32) -> Array2<f32> {
        let mut rows = Array2::zeros((pictures, N_CEPSTRA));
        for (n, mut row) in rows.outer_iter_mut().enumerate() {
            let middle = (n as f64 + 0.5) / f64::from(rate_hz) * f64::from(SAMPLE_RATE_HZ);
            let begin = middle.round() as i64 - WINDOW as i64 / 2;
            let heard: Vec<i16> = (begin..begin + WINDOW as i64)
                .map(|at| {
                    usize::try_from(at)
                        .ok()
                        .and_then(|at| samples.get(at))
                        .copied()
                        .unwrap_or(0)
                })
                .collect();
            row.assign(&ArrayView1::from(&self.window(&heard)));
        }
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each cepstrum against the definition, written out: windowed sum of cosines, triangles, logarithm, cosine transform.
    #[test]
    fn cepstra_are_those_of_the_definition() {
        // Loud noise beside a tone: no channel is so quiet that the floor counts.
        let mut state = 1u32;
        let samples: Vec<i16> = (0..WINDOW)
            .map(|i| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let tone = 6000.0 * (std::f64::consts::TAU * 440.0 * i as f64 / 16_000.0).sin();
                (tone + f64::from(state >> 17) / 2.0 - 8192.0) as i16
            })
            .collect();
        let said = Cepstra::default().window(&samples);
        let mut x: Vec<f64> = samples.iter().map(|s| f64::from(*s)).collect();
        for i in (1..WINDOW).rev() {
            x[i] -= 0.97 * x[i - 1];
        }
        x[0] *= 1.0 - 0.97;
        let weigh = |i: usize| 0.54 - 0.46 * (std::f64::consts::TAU * i as f64 / (WINDOW - 1) as f64).cos();
        let mel = |hz: f64| 1127.0 * (1.0 + hz / 700.0).ln();
        let spacing = mel(8000.0) / 27.0;
        let mut channels = [0.0; 26];
        for bin in 1..POINTS / 2 {
            let (mut re, mut im) = (0.0, 0.0);
            for (i, v) in x.iter().enumerate() {
                let angle = std::f64::consts::TAU * (bin * i) as f64 / POINTS as f64;
                re += weigh(i) * v * angle.cos();
                im += weigh(i) * v * angle.sin();
            }
            let place = mel(bin as f64 * 16_000.0 / POINTS as f64) / spacing;
            for (j, channel) in channels.iter_mut().enumerate() {
                let share = (1.0 - (place - (j + 1) as f64).abs()).max(0.0);
                *channel += share * f64::hypot(re, im);
            }
        }
        for n in 1..=N_CEPSTRA {
            let lifter = 1.0 + 11.0 * (std::f64::consts::PI * n as f64 / 22.0).sin();
            let sum: f64 = channels
                .iter()
                .enumerate()
                .map(|(j, m)| m.ln() * (std::f64::consts::PI * n as f64 * (j as f64 + 0.5) / 26.0).cos())
                .sum();
            let wanted = lifter * (2.0f64 / 26.0).sqrt() * sum;
            // The floor lies 55 dB below the noise.
            assert!(
                (f64::from(said[n - 1]) - wanted).abs() < 0.1,
                "c{n}: {} {wanted}",
                said[n - 1]
            );
        }
    }

    #[test]
    fn pictures_hear_their_own_time_and_silence_beyond_the_sound() {
        let cepstra = Cepstra::default();
        let samples: Vec<i16> = (0..3 * WINDOW)
            .map(|i| ((i * i * 31) % 9001) as i16 - 4500)
            .collect();
        let rows = cepstra.of_pictures(&samples, 4, 25.0);
        for n in 0..3 {
            let own = cepstra.window(&samples[n * WINDOW..][..WINDOW]);
            assert_eq!(rows.row(n).to_vec(), own);
        }
        assert_eq!(rows.row(3).to_vec(), cepstra.window(&[0; WINDOW]));
        assert!(rows.iter().all(|c| c.is_finite()));
    }
}
