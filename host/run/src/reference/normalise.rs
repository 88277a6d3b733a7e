//! Causal normalisation: a recursive mean of the 13 statics over speech, taken off frame by frame.
//!
//! A frame counts as speech when its energy lies in the upper half of the range that the energy covered
//! lately, that range is wide, and the energy is stirring:
//!
//! ```text
//! e = max(E, 10)                                  nothing quieter than about 7 LSB rms is heard
//! top    = e if e > top,       else top    + (e − top)/128
//! bottom = e if e < bottom,    else bottom + (e − bottom)/64
//! stir   = stir + (min(|e − e of the frame before|, 1) − stir)/16
//! speech = top − bottom ≥ 2  and  2e > top + bottom  and  stir ≥ 1/8
//! mean   = mean + (s − mean)/256                  if speech
//! output = s − mean
//! ```
//!
//! The gate is relative to what was heard in the last second or two, so it works at any level and opens again
//! after a jump of the level in either direction. Silence, hum and steady noise do not stir, and within a second
//! `bottom` has risen to them: the mean stands still. 256 frames of speech are four to seven seconds of talk. All
//! constants are powers of two (or 10), so that the integer path computes the same rule.
use lipstream_core::N_STATIC;
use ndarray::{Array2, ArrayView2, Axis};

/// Energies below this count as this.
pub const QUIET: f64 = 10.0;
/// Least range of energy, in nats, in which there can be speech (8.7 dB).
pub const LEAST_RANGE: f64 = 2.0;
/// Frames in which `top` falls to e, to 1/e.
pub const TOP_FRAMES: f64 = 128.0;
/// Frames in which `bottom` rises to e, to 1/e.
pub const BOTTOM_FRAMES: f64 = 64.0;
/// Frames over which the energy's changes are averaged.
pub const STIR_FRAMES: f64 = 16.0;
/// Largest change that counts in full, in nats: an onset alone does not open the gate.
pub const MOST_STIR: f64 = 1.0;
/// Least average change in speech, in nats a frame.
pub const LEAST_STIR: f64 = 0.125;
/// Frames of speech over which the mean is taken.
pub const MEAN_FRAMES: f64 = 256.0;

/// What is done to the 13 statics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Normalisation {
    /// Nothing: HTK's numbers.
    None,
    /// The causal mean is taken off, starting from this one (the training mean of raw statics over speech).
    Causal {
        /// Statics that the mean begins with.
        start_mean: [f32; N_STATIC],
    },
}

/// Decides frame by frame which frames are speech.
#[derive(Clone, Debug, Default)]
pub struct SpeechGate {
    /// None before the first frame.
    levels: Option<Levels>,
}

#[derive(Clone, Copy, Debug)]
struct Levels {
    top: f64,
    bottom: f64,
    before: f64,
    stir: f64,
}

impl SpeechGate {
    /// Takes the next frame's E; true when the frame is speech.
    pub fn next(&mut self, energy: f64) -> bool {
        let e = energy.max(QUIET);
        let last = self.levels.unwrap_or(Levels {
            top: e,
            bottom: e,
            before: e,
            stir: 0.0,
        });
        let top = e.max(last.top + (e - last.top) / TOP_FRAMES);
        let bottom = e.min(last.bottom + (e - last.bottom) / BOTTOM_FRAMES);
        let change = (e - last.before).abs().min(MOST_STIR);
        let stir = last.stir + (change - last.stir) / STIR_FRAMES;
        self.levels = Some(Levels {
            top,
            bottom,
            before: e,
            stir,
        });
        top - bottom >= LEAST_RANGE && 2.0 * e > top + bottom && stir >= LEAST_STIR
    }
}

/// The causal mean of one stream, frame by frame.
#[derive(Clone, Debug)]
pub struct Causal {
    gate: SpeechGate,
    mean: [f64; N_STATIC],
}

impl Causal {
    /// Starts from this mean.
    pub fn new(start_mean: &[f32; N_STATIC]) -> Self {
        Self {
            gate: SpeechGate::default(),
            mean: start_mean.map(f64::from),
        }
    }

    /// The next frame's raw statics less the mean in force, which knows this frame and those before it only.
    pub fn next(&mut self, raw: &[f64; N_STATIC]) -> [f64; N_STATIC] {
        if self.gate.next(raw[N_STATIC - 1]) {
            for (m, s) in self.mean.iter_mut().zip(raw) {
                *m += (s - *m) / MEAN_FRAMES;
            }
        }
        std::array::from_fn(|i| raw[i] - self.mean[i])
    }
}

/// Raw statics less the mean in force at each frame, `[frames, 13]`. Frame t's mean knows frames ≤ t only.
pub fn causal(raw: ArrayView2<f64>, start_mean: &[f32; N_STATIC]) -> Array2<f64> {
    let mut causal = Causal::new(start_mean);
    let mut out = raw.to_owned();
    for mut row in out.axis_iter_mut(Axis(0)) {
        let frame = std::array::from_fn(|i| row[i]);
        row.assign(&ndarray::aview1(&causal.next(&frame)));
    }
    out
}

/// Mean of raw statics over the frames that the gate lets through, gathered clip by clip.
#[derive(Clone, Debug, Default)]
pub struct SpeechMean {
    sums: [f64; N_STATIC],
    frames: usize,
}

impl SpeechMean {
    /// Adds a clip's raw statics, `[frames, 13]`; the gate starts anew with every clip.
    pub fn add(&mut self, raw: ArrayView2<f64>) {
        let mut gate = SpeechGate::default();
        for row in raw.axis_iter(Axis(0)) {
            if gate.next(row[N_STATIC - 1]) {
                self.frames += 1;
                for (sum, s) in self.sums.iter_mut().zip(&row) {
                    *sum += s;
                }
            }
        }
    }

    /// Frames of speech so far.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// The mean; none before any speech was heard.
    pub fn mean(&self) -> Option<[f32; N_STATIC]> {
        (self.frames > 0).then(|| self.sums.map(|sum| (sum / self.frames as f64) as f32))
    }
}

/// Mean of raw statics over the speech in `clips`, offsets taken off: what `prepare` writes as the start mean. None without speech.
pub fn speech_mean<C: AsRef<[i16]>>(clips: impl IntoIterator<Item = C>) -> Option<[f32; N_STATIC]> {
    let mut mean = SpeechMean::default();
    for clip in clips {
        mean.add(super::live_statics(clip.as_ref()).view());
    }
    mean.mean()
}
