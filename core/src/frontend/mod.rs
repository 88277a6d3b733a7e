//! The audio front end: 16 kHz samples to HTK's `MFCC_E_D_A`, 39 numbers 100 times a second (X&L section 5).
//!
//! One stage a file, each with its `f64` twin in the host's `reference` under the same name. Input is i16 samples,
//! output Q7.8 (LSB 1/256, range \[−128, 128)), saturating.
use crate::{FRAME_SAMPLES, HOP_SAMPLES, N_CEPSTRA, N_OBSERVATION, N_STATIC};

pub mod dct;
pub mod delta;
pub mod energy;
pub mod fft;
pub mod floor;
pub mod log;
pub mod magnitude;
pub mod mel;
pub mod normalise;
pub mod offset;
pub mod preemphasis;
pub mod window;

use delta::{Deltas, LOOK_AHEAD};
use energy::Energy;
use fft::{Complex, FFT_HALF};
use normalise::Normaliser;
use offset::Offset;

/// Frames by which an observation comes after its statics.
pub const OBSERVATION_DELAY: usize = 2 * LOOK_AHEAD;

/// What does not change while a stream runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Config {
    /// Mean of the 13 raw statics over the training speech, Q7.8: where the causal mean starts.
    pub start_mean: [i16; N_STATIC],
    /// Whether the sound is heard as a room's: its offset is taken off, a floor lies under it ([`offset`], [`floor`]) and the causal mean is taken off
    /// the statics. Otherwise the numbers are HTK's.
    pub normalise: bool,
}

/// What one hop brings. Q7.8 throughout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hop {
    /// Frame `index`'s c1..c12, E after causal normalisation; none while `finish` drains the look-ahead.
    pub statics: Option<[i16; N_STATIC]>,
    /// Frame (`index` − 4)'s 39 numbers; none for the first four hops.
    pub observation: Option<[i16; N_OBSERVATION]>,
    /// Hops since the beginning, modulo 2³².
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
    offset: Offset,
    /// The window being filled.
    samples: Window,
    filled: usize,
    /// Frames analysed, modulo 2³².
    index: u32,
    energy: Energy,
    normaliser: Normaliser,
    deltas: Deltas,
    /// Normalised statics that wait for their Δ, a ring; `oldest` is written next.
    waiting: [[i16; N_STATIC]; OBSERVATION_DELAY],
    oldest: usize,
    scratch: Scratch,
}

/// Samples of a window, aligned so that they are moved by words.
#[derive(Clone, Debug)]
#[repr(align(4))]
struct Window([i16; FRAME_SAMPLES]);

/// Working space of one analysis; holds nothing between frames.
#[derive(Clone, Debug)]
struct Scratch {
    points: [Complex; FFT_HALF],
    magnitudes: [u32; FFT_HALF],
}

impl FrontEnd {
    /// At the beginning of a stream. Inlined into the place that it is made for: copies of the state cost a device its stack.
    #[inline(always)]
    pub fn new(config: Config) -> Self {
        Self {
            config,
            phase: Phase::Running,
            offset: Offset::default(),
            samples: Window([0; FRAME_SAMPLES]),
            filled: 0,
            index: 0,
            energy: Energy::default(),
            normaliser: Normaliser::new(&config.start_mean),
            deltas: Deltas::default(),
            waiting: [[0; N_STATIC]; OBSERVATION_DELAY],
            oldest: 0,
            scratch: Scratch {
                points: [Complex { re: 0, im: 0 }; FFT_HALF],
                magnitudes: [0; FFT_HALF],
            },
        }
    }

    /// Starts a new stream, with the start mean.
    pub fn reset(&mut self) {
        self.phase = Phase::Running;
        self.offset = Offset::default();
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
        let space = &mut self.samples.0[self.filled..];
        let taken = samples.len().min(space.len());
        if self.config.normalise {
            self.offset.take_off(&samples[..taken], &mut space[..taken]);
        } else {
            space[..taken].copy_from_slice(&samples[..taken]);
        }
        self.filled += taken;
        if self.filled < FRAME_SAMPLES {
            return (taken, None);
        }
        let raw = self.analyse();
        self.samples.0.copy_within(HOP_SAMPLES.., 0);
        self.filled = FRAME_SAMPLES - HOP_SAMPLES;
        let statics = if self.config.normalise {
            self.normaliser.next(&raw)
        } else {
            raw
        };
        (taken, Some(self.hop(&raw, Some(statics), 0)))
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
        Some(self.hop(&[0; N_STATIC], None, past + 1))
    }

    /// Raw statics of the window that is full.
    fn analyse(&mut self) -> [i16; N_STATIC] {
        let Scratch { points, magnitudes } = &mut self.scratch;
        let sum = self.energy.next(&self.samples.0);
        let headroom = energy::headroom(sum);
        window::load(&self.samples.0, headroom, points);
        fft::transform(points);
        fft::split_magnitudes(points, magnitudes);
        let mut channels = [0; mel::N_MEL];
        mel::filterbank(magnitudes, &mut channels);
        // Q(4 + s) magnitudes, Q16 shares.
        let mut heard = sum;
        if self.config.normalise {
            heard += floor::ENERGY;
            floor::add(&mut channels, 4 + headroom);
        }
        let log_mel = log::log_mel(&channels, 4 + headroom + 16);
        let mut statics = [energy::log_energy(heard); N_STATIC];
        let mut cepstra = [0; N_CEPSTRA];
        dct::cepstra(&log_mel, &mut cepstra);
        statics[..N_CEPSTRA].copy_from_slice(&cepstra);
        statics
    }

    /// Puts a hop together and counts it; `past` is how many frames it lies past the last one.
    fn hop(&mut self, raw: &[i16; N_STATIC], statics: Option<[i16; N_STATIC]>, past: usize) -> Hop {
        let mut all = [0; N_OBSERVATION];
        let (own, derived) = all.split_at_mut(N_STATIC);
        let (delta, delta_delta) = derived.split_at_mut(N_STATIC);
        let mut ready = false;
        if let (Ok(delta), Ok(delta_delta)) = (delta.try_into(), delta_delta.try_into()) {
            ready = match past {
                0 => self.deltas.next(raw, delta, delta_delta),
                _ => self.deltas.next_past_end(past, delta, delta_delta),
            };
        }
        let waiting = &mut self.waiting[self.oldest % OBSERVATION_DELAY];
        own.copy_from_slice(waiting);
        if let Some(statics) = &statics {
            *waiting = *statics;
        }
        self.oldest = (self.oldest + 1) % OBSERVATION_DELAY;
        let index = self.index;
        self.index = self.index.wrapping_add(1);
        Hop {
            statics,
            observation: ready.then_some(all),
            index,
        }
    }
}
