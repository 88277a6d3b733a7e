//! The audio front end: 16 kHz samples to HTK's `MFCC_E_D_A`, 39 numbers 100 times a second (X&L section 5).
//!
//! One stage a file, each with its `f64` twin in the host's `reference` under the same name. Input is i16 samples,
//! output Q7.8 (LSB 1/256, range \[−128, 128)), saturating.
use crate::{FRAME_SAMPLES, HOP_SAMPLES, N_CEPSTRA, N_OBSERVATION, N_STATIC};

pub mod dct;
pub mod delta;
pub mod energy;
pub mod fft;
pub mod log;
pub mod magnitude;
pub mod mel;
pub mod normalise;
pub mod preemphasis;
pub mod window;

use delta::{Deltas, LOOK_AHEAD};
use energy::Energy;
use fft::{Complex, FFT_HALF};
use normalise::Normaliser;

/// Frames by which an observation comes after its statics.
pub const OBSERVATION_DELAY: usize = 2 * LOOK_AHEAD;

/// What does not change while a stream runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Config {
    /// Mean of the 13 raw statics over the training speech, Q7.8: where the causal mean starts.
    pub start_mean: [i16; N_STATIC],
    /// Whether the causal mean is taken off the statics.
    pub normalise: bool,
}

/// What one hop brings. Q7.8 throughout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hop {
    /// Frame `index`'s c1..c12, E after causal normalisation; none while `finish` drains the look-ahead.
    pub statics: Option<[i16; N_STATIC]>,
    /// Frame (`index` − 4)'s 39 numbers; none for the first four hops.
    pub observation: Option<[i16; N_OBSERVATION]>,
    pub index: u32,
}

/// Where a stream stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Running,
    /// So many frames past the last one have been given.
    Draining(usize),
}

/// Samples in, observations out. The result does not depend on how the samples are cut.
#[derive(Clone, Debug)]
pub struct FrontEnd {
    config: Config,
    phase: Phase,
    /// The window being filled.
    samples: [i16; FRAME_SAMPLES],
    filled: usize,
    /// Frames analysed, modulo 2³².
    index: u32,
    energy: Energy,
    normaliser: Normaliser,
    deltas: Deltas,
    /// Normalised statics that wait for their Δ.
    waiting: [[i16; N_STATIC]; OBSERVATION_DELAY + 1],
    scratch: Scratch,
}

/// Working space of one analysis; holds nothing between frames.
#[derive(Clone, Debug)]
struct Scratch {
    points: [Complex; FFT_HALF],
    magnitudes: [u32; FFT_HALF],
}

impl FrontEnd {
    pub fn new(config: Config) -> Self {
        Self {
            config,
            phase: Phase::Running,
            samples: [0; FRAME_SAMPLES],
            filled: 0,
            index: 0,
            energy: Energy::default(),
            normaliser: Normaliser::new(&config.start_mean),
            deltas: Deltas::default(),
            waiting: [[0; N_STATIC]; OBSERVATION_DELAY + 1],
            scratch: Scratch {
                points: [Complex { re: 0, im: 0 }; FFT_HALF],
                magnitudes: [0; FFT_HALF],
            },
        }
    }

    /// Starts a new stream, with the start mean.
    pub fn reset(&mut self) {
        self.phase = Phase::Running;
        self.filled = 0;
        self.index = 0;
        self.energy = Energy::default();
        self.normaliser = Normaliser::new(&self.config.start_mean);
        self.deltas = Deltas::default();
    }

    /// Takes samples up to the end of the next window; says how many, and what that window brings.
    ///
    /// Call it until everything is consumed. Samples after [`finish`](Self::finish) start a new stream.
    pub fn push(&mut self, samples: &[i16]) -> (usize, Option<Hop>) {
        if self.phase != Phase::Running {
            self.reset();
        }
        let space = &mut self.samples[self.filled..];
        let taken = samples.len().min(space.len());
        space[..taken].copy_from_slice(&samples[..taken]);
        self.filled += taken;
        if self.filled < FRAME_SAMPLES {
            return (taken, None);
        }
        let raw = self.analyse();
        self.samples.copy_within(HOP_SAMPLES.., 0);
        self.filled = FRAME_SAMPLES - HOP_SAMPLES;
        let statics = if self.config.normalise {
            self.normaliser.next(&raw)
        } else {
            raw
        };
        let derived = self.deltas.next(&raw);
        (taken, Some(self.hop(Some(statics), derived)))
    }

    /// The frames that the look-ahead held back, one a call; none when all are out. Samples short of a whole
    /// window are dropped, as HCopy does.
    pub fn finish(&mut self) -> Option<Hop> {
        let past = match self.phase {
            Phase::Running if self.index == 0 => OBSERVATION_DELAY,
            Phase::Running => 0,
            Phase::Draining(past) => past,
        };
        self.phase = Phase::Draining(past);
        if past == OBSERVATION_DELAY {
            return None;
        }
        self.phase = Phase::Draining(past + 1);
        let derived = self.deltas.next_past_end(past + 1);
        Some(self.hop(None, derived))
    }

    /// Raw statics of the window that is full.
    fn analyse(&mut self) -> [i16; N_STATIC] {
        let Scratch { points, magnitudes } = &mut self.scratch;
        let sum = self.energy.next(&self.samples);
        let headroom = energy::headroom(sum);
        window::load(&self.samples, headroom, points);
        fft::transform(points);
        fft::split_magnitudes(points, magnitudes);
        let mut channels = [0; mel::N_MEL];
        mel::filterbank(magnitudes, &mut channels);
        // Q(6 + s) bins, Q16 shares.
        let log_mel = log::log_mel(&channels, 6 + headroom + 16);
        let mut statics = [energy::log_energy(sum); N_STATIC];
        let mut cepstra = [0; N_CEPSTRA];
        dct::cepstra(&log_mel, &mut cepstra);
        statics[..N_CEPSTRA].copy_from_slice(&cepstra);
        statics
    }

    /// Puts a hop together and counts it.
    fn hop(
        &mut self,
        statics: Option<[i16; N_STATIC]>,
        derived: Option<([i16; N_STATIC], [i16; N_STATIC])>,
    ) -> Hop {
        self.waiting.copy_within(1.., 0);
        if let Some(statics) = statics {
            self.waiting[OBSERVATION_DELAY] = statics;
        }
        let observation = derived.map(|(delta, delta_delta)| {
            let mut all = [0; N_OBSERVATION];
            all[..N_STATIC].copy_from_slice(&self.waiting[0]);
            all[N_STATIC..2 * N_STATIC].copy_from_slice(&delta);
            all[2 * N_STATIC..].copy_from_slice(&delta_delta);
            all
        });
        let index = self.index;
        self.index = self.index.wrapping_add(1);
        Hop {
            statics,
            observation,
            index,
        }
    }
}
