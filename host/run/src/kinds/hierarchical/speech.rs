//! Speech as the hierarchical model hears it (section 3): 12 mel-cepstra a picture from a Hamming window of 40 ms.
//!
//! At 25 pictures a second the windows lie side by side: picture n hears samples 640·n to 640·n + 639. Pre-emphasis, the 26 triangles, the logarithm, cosines and lifter
//! are the front end's own (`reference`), over a transform of 1024 points; so is the floor under every sound, without which silence would be anything.
//!
//! A device has one front end, with windows of 25 ms every 10 ms: a model that is to run there hears that one instead ([`Hearing::Frames`]), the statics of the few frames
//! that lie in a picture's 40 ms.
use lipstream_core::context::tables::{FIRST_TAP, LAST_TAP, MAX_TAPS};
use lipstream_core::{N_CEPSTRA, N_STATIC, SAMPLE_RATE_HZ};
use ndarray::{Array1, Array2, ArrayView1, s};

use crate::error::{Result, bail};
use crate::reference::{Normalisation, dct, fft, floor, log, mel, observations, preemphasis, window};
use crate::tensors::{Tensors, TensorsBuilder};
use crate::time;

/// Samples of a window: 40 ms.
pub const WINDOW: usize = 640;
/// Points of the transform.
const POINTS: usize = 1024;
/// Pictures a second that speech is turned into.
pub const PICTURES_HZ: u32 = SAMPLE_RATE_HZ / WINDOW as u32;

/// Frames of the device's front end in a picture.
pub const PICTURE_FRAMES: usize = time::FRAME_RATE_HZ / PICTURES_HZ as usize;
/// Hops whose windows' centres lie in a picture's time, from the hop that begins with the picture on.
pub const OWN_TAPS: [i8; PICTURE_FRAMES] = [-1, 0, 1, 2];

/// What a model hears of each picture.
#[derive(Clone, Debug, PartialEq)]
pub enum Hearing {
    /// The paper's: 12 mel-cepstra of a window of 40 ms.
    Window,
    /// The device's: statics at hops around the one that begins with the picture, normalised from this mean on.
    Frames {
        /// Mean of the raw statics.
        start_mean: Array1<f32>,
        /// Hops, increasing.
        taps: Vec<i8>,
    },
}

impl Hearing {
    /// The device's front end at these hops.
    ///
    /// # Errors
    ///
    /// Hops that do not increase, too many of them, or some that are too far from the picture.
    pub fn frames(start_mean: Array1<f32>, taps: Vec<i8>) -> Result<Self> {
        let increase = taps.windows(2).all(|pair| pair[0] < pair[1]);
        let near = taps.iter().all(|tap| (FIRST_TAP..=LAST_TAP).contains(tap));
        if !increase || !near || taps.is_empty() || taps.len() > MAX_TAPS || start_mean.len() != N_STATIC {
            bail!(
                Choice,
                "taps are 1 to {MAX_TAPS} hops from {FIRST_TAP} to {LAST_TAP} in increasing order"
            );
        }
        Ok(Self::Frames { start_mean, taps })
    }

    /// Numbers of a picture.
    pub fn size(&self) -> usize {
        match self {
            Self::Window => N_CEPSTRA,
            Self::Frames { taps, .. } => N_STATIC * taps.len(),
        }
    }

    /// Pictures of a sound of so many samples at [`PICTURES_HZ`].
    pub fn pictures(&self, samples: usize) -> usize {
        match self {
            Self::Window => samples.div_ceil(WINDOW),
            Self::Frames { .. } => time::frame_count(samples).div_ceil(PICTURE_FRAMES),
        }
    }

    /// One row for each of `pictures` pictures of a whole sound, `rate_hz` a second.
    ///
    /// Frames before the first and behind the last are taken for these, as on the device; a sound without a whole window is heard as the mean.
    pub fn of_pictures(&self, samples: &[i16], pictures: usize, rate_hz: f32) -> Array2<f32> {
        let (start_mean, taps) = match self {
            Self::Window => return Cepstra::default().of_pictures(samples, pictures, rate_hz),
            Self::Frames { start_mean, taps } => (start_mean, taps),
        };
        let start_mean = std::array::from_fn(|i| start_mean[i]);
        let heard = observations(samples, Normalisation::Causal { start_mean });
        let mut rows = Array2::zeros((pictures, self.size()));
        let Some(last) = heard.nrows().checked_sub(1) else {
            return rows;
        };
        for (n, mut row) in rows.outer_iter_mut().enumerate() {
            let begin = (n as f64 * time::FRAME_RATE_HZ as f64 / f64::from(rate_hz)).round() as i64;
            for (k, tap) in taps.iter().enumerate() {
                let frame = (begin + i64::from(*tap)).clamp(0, last as i64) as usize;
                row.slice_mut(s![k * N_STATIC..(k + 1) * N_STATIC])
                    .assign(&heard.slice(s![frame, ..N_STATIC]));
            }
        }
        rows
    }

    pub(super) fn put(&self, out: &mut TensorsBuilder) {
        if let Self::Frames { start_mean, taps } = self {
            out.put_start_mean(start_mean);
            let taps: Vec<String> = taps.iter().map(i8::to_string).collect();
            out.note(TAPS, taps.join(","));
        }
    }

    pub(super) fn read(from: &Tensors) -> Result<Self> {
        if !from.has_note(TAPS) {
            return Ok(Self::Window);
        }
        let noted: String = from.noted(TAPS)?;
        let taps: Option<Vec<i8>> = noted.split(',').map(|tap| tap.parse().ok()).collect();
        let Some(taps) = taps else {
            bail!(File, "note {TAPS} is {noted:?}");
        };
        Self::frames(from.start_mean()?, taps)
    }
}

/// The note of a model that hears the device's front end.
const TAPS: &str = "hierarchical.taps";

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

    /// The device's frames of each picture, in the middle of a sound and at its ends.
    #[test]
    fn frames_are_those_of_the_front_end_around_the_picture() {
        let samples: Vec<i16> = (0..400 + 22 * 160)
            .map(|i| ((i * i * 31) % 9001) as i16 - 4500)
            .collect();
        let start_mean = Array1::from_elem(N_STATIC, 1.0);
        let hearing = Hearing::frames(start_mean, vec![-1, 0, 2]).unwrap();
        assert_eq!((hearing.size(), hearing.pictures(samples.len())), (39, 6));
        let normalisation = Normalisation::Causal {
            start_mean: [1.0; N_STATIC],
        };
        let frames = observations(&samples, normalisation);
        assert_eq!(frames.nrows(), 23);
        let rows = hearing.of_pictures(&samples, 6, 25.0);
        for (picture, wanted) in [(0, [0, 0, 2]), (3, [11, 12, 14]), (5, [19, 20, 22])] {
            let said = rows.row(picture).to_vec();
            for (frame, said) in wanted.iter().zip(said.chunks(N_STATIC)) {
                assert_eq!(said, frames.slice(s![*frame, ..N_STATIC]).to_vec());
            }
        }
        // Thirty pictures a second: the twelfth begins after 0.4 s.
        assert_eq!(
            hearing.of_pictures(&samples, 7, 30.0).row(6).to_vec()[..13],
            frames.slice(s![19, ..13]).to_vec()
        );
        assert_eq!(
            hearing.of_pictures(&[0; 399], 1, 25.0),
            Array2::<f32>::zeros((1, 39))
        );
        for taps in [vec![], vec![1, 0], vec![0, 0], vec![-41], vec![17]] {
            assert!(Hearing::frames(Array1::zeros(N_STATIC), taps).is_err());
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
