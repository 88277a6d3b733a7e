//! The front end in `f64`: the twin of `lipstream_core::frontend`, stage by stage under the same file names.
//!
//! HTK's `MFCC_E_D_A` (X&L section 5; `docs/design.md` section 2): 39 numbers, 100 frames a second, of 16 kHz mono
//! samples at int16 scale. It agrees with HTK's own HCopy within 1e-3 in every coefficient.
use lipstream_core::{FRAME_SAMPLES, HOP_SAMPLES, N_OBSERVATION, N_STATIC};
use ndarray::{Array2, ArrayView2, Axis, concatenate, s};

pub mod dct;
pub mod delta;
pub mod energy;
pub mod fft;
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
}

impl Default for Analyser {
    fn default() -> Self {
        Self {
            window: window::hamming(),
            fft: fft::Magnitude::default(),
            mel: mel::Filterbank::default(),
            dct: dct::Cosines::default(),
        }
    }
}

impl Analyser {
    /// One that hears a voice as if all its frequencies were `factor` times as high ([`mel::Filterbank::of_voice`]).
    pub fn of_voice(factor: f64) -> Self {
        Self {
            mel: mel::Filterbank::of_voice(factor),
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
        let energy = energy::log_energy(&frame);
        preemphasis::apply(&mut frame);
        window::apply(&mut frame, &self.window);
        let spectrum = self.fft.magnitudes(&frame);
        let log_mel = log::log_mel(&self.mel.apply(&spectrum));
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

/// Raw statics of a whole sound less its offset: those that the causal mean is taken of.
pub fn live_statics(samples: &[i16]) -> Array2<f64> {
    statics(&without_offset(samples))
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
