//! The front end in `f64`: the twin of `lipstream_core::frontend`, stage by stage under the same file names.
//!
//! HTK's `MFCC_E_D_A` (X&L section 5; `docs/design.md` section 2): 39 numbers, 100 frames a second, of 16 kHz mono
//! samples at int16 scale. It agrees with HTK's own HCopy within 1e-3 in every coefficient.
use lipstream_core::{FRAME_SAMPLES, HOP_SAMPLES, N_OBSERVATION, N_STATIC};
use mel::N_MEL;
use ndarray::{Array2, ArrayView2, Axis, concatenate, s};

pub mod dct;
pub mod delta;
pub mod energy;
pub mod fft;
pub mod floor;
pub mod hmm;
pub mod log;
pub mod mel;
pub mod normalise;
pub mod observer;
pub mod offset;
pub mod preemphasis;
pub mod window;

pub use crate::time::frame_count;
pub use delta::deltas;
pub use normalise::{Normalisation, SpeechMean, speech_mean};
pub use offset::without_offset;

/// Everything that does not depend on the sound, made once.
pub struct Analyser {
    window: Vec<f64>,
    fft: fft::Magnitude,
    mel: mel::Filterbank,
    dct: dct::Cosines,
    /// What lies under every sound: energy and channel sums; zeros in HTK's numbers.
    floor: (f64, [f64; N_MEL]),
}

impl Default for Analyser {
    /// HTK's numbers.
    fn default() -> Self {
        Self {
            window: window::hamming(),
            fft: fft::Magnitude::default(),
            mel: mel::Filterbank::default(),
            dct: dct::Cosines::default(),
            floor: (0.0, [0.0; N_MEL]),
        }
    }
}

impl Analyser {
    /// One that hears as a live stream does, with a floor under every sound, and a voice as if all its frequencies were `factor` times as high
    /// ([`mel::Filterbank::of_voice`]). The offset is taken off before ([`without_offset`]).
    pub fn of_voice(factor: f64) -> Self {
        let mel = mel::Filterbank::of_voice(factor);
        let window = window::hamming();
        Self {
            floor: (floor::ENERGY, floor::channels(&mel, &window)),
            mel,
            window,
            ..Self::default()
        }
    }

    /// Raw statics of a whole sound, `[frames, 13]`: c1..c12, E.
    pub fn statics(&mut self, samples: &[i16]) -> Array2<f64> {
        let mut out = Array2::zeros((frame_count(samples.len()), N_STATIC));
        for (t, mut row) in out.axis_iter_mut(Axis(0)).enumerate() {
            let start = t * HOP_SAMPLES;
            let frame = self.frame(&samples[start..start + FRAME_SAMPLES]);
            row.assign(&ndarray::aview1(&frame));
        }
        out
    }

    /// c1..c12 (liftered), then E, of one window of 400 samples.
    pub fn frame(&mut self, samples: &[i16]) -> [f64; N_STATIC] {
        let mut frame: Vec<f64> = samples.iter().map(|&s| f64::from(s)).collect();
        let energy = energy::log_energy(&frame, self.floor.0);
        preemphasis::apply(&mut frame);
        window::apply(&mut frame, &self.window);
        let spectrum = self.fft.magnitudes(&frame);
        let mut channels = self.mel.apply(&spectrum);
        channels
            .iter_mut()
            .zip(&self.floor.1)
            .for_each(|(m, floor)| *m += floor);
        let log_mel = log::log_mel(&channels);
        let cepstra = self.dct.cepstra(&log_mel);
        let mut statics = [energy; N_STATIC];
        statics[..cepstra.len()].copy_from_slice(&cepstra);
        statics
    }
}

/// Raw statics of a whole sound as it is, `[frames, 13]`: c1..c12, E, as HTK computes them.
pub fn statics(samples: &[i16]) -> Array2<f64> {
    Analyser::default().statics(samples)
}

/// Raw statics of a whole sound as a live stream hears it, less its offset and with a floor under it: those that the causal mean is taken of.
pub fn live_statics(samples: &[i16]) -> Array2<f64> {
    Analyser::of_voice(1.0).statics(&without_offset(samples))
}

/// Statics, Δ and ΔΔ of a whole sound, `[frames, 39]`. Δ and ΔΔ are always those of the raw statics.
pub fn observations(samples: &[i16], normalisation: Normalisation) -> Array2<f32> {
    let raw = match normalisation {
        Normalisation::None => statics(samples),
        Normalisation::Causal { .. } => live_statics(samples),
    };
    observations_of_statics(raw.view(), normalisation)
}

/// [`observations`] from raw statics that are already there.
fn observations_of_statics(raw: ArrayView2<f64>, normalisation: Normalisation) -> Array2<f32> {
    let first = deltas(raw);
    let second = deltas(first.view());
    let mut all = concatenate(Axis(1), &[raw, first.view(), second.view()]).expect("same number of frames");
    debug_assert_eq!(all.ncols(), N_OBSERVATION);
    if let Normalisation::Causal { start_mean } = normalisation {
        let normalised = normalise::causal(raw, &start_mean);
        all.slice_mut(s![.., ..N_STATIC]).assign(&normalised);
    }
    all.mapv(|v| v as f32)
}
