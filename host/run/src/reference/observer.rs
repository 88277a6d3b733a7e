//! The `f64` front end of a stream: samples of any cut in, the observations of one frame after the other out.
//!
//! What it gives equals [`super::observations`] of the whole sound; it remembers a few windows only.
use std::collections::VecDeque;

use lipstream_core::frontend::OBSERVATION_DELAY;
use lipstream_core::frontend::offset::Offset;
use lipstream_core::{FRAME_SAMPLES, HOP_SAMPLES, N_OBSERVATION, N_STATIC};

use super::delta::WIDTH;
use super::normalise::Causal;
use super::{Analyser, Normalisation};

/// What one window brings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observed {
    /// c1..c12, E of the newest window, normalised.
    pub statics: [f32; N_STATIC],
    /// All 39 numbers of the window four before it, see [`OBSERVATION_DELAY`]; none in the first four.
    pub observation: Option<[f32; N_OBSERVATION]>,
}

/// A stream's front end.
pub struct Observer {
    analyser: Analyser,
    /// What is taken off samples and statics; none for HTK's own.
    normaliser: Option<(Offset, Causal)>,
    /// Samples that the next window begins with.
    samples: Vec<i16>,
    /// Raw and normalised statics of the last frames, the newest at the end.
    frames: VecDeque<([f64; N_STATIC], [f64; N_STATIC])>,
    /// Frame that `frames` begins with.
    first: usize,
    /// The next observation's frame.
    next: usize,
}

impl Observer {
    /// A stream from its first sample on.
    pub fn new(normalisation: Normalisation) -> Self {
        Self {
            analyser: match normalisation {
                Normalisation::None => Analyser::default(),
                Normalisation::Causal { .. } => Analyser::of_voice(1.0),
            },
            normaliser: match normalisation {
                Normalisation::None => None,
                Normalisation::Causal { start_mean } => Some((Offset::default(), Causal::new(&start_mean))),
            },
            samples: Vec::with_capacity(FRAME_SAMPLES),
            frames: VecDeque::new(),
            first: 0,
            next: 0,
        }
    }

    /// Takes samples, cut anywhere; `each` is called with what every window that they complete brings.
    pub fn push(&mut self, mut samples: &[i16], mut each: impl FnMut(Observed)) {
        while !samples.is_empty() {
            let (now, rest) = samples.split_at(samples.len().min(FRAME_SAMPLES - self.samples.len()));
            let from = self.samples.len();
            self.samples.extend(now);
            if let Some((offset, _)) = &mut self.normaliser {
                offset.take_off(now, &mut self.samples[from..]);
            }
            samples = rest;
            if self.samples.len() == FRAME_SAMPLES {
                each(self.window());
                self.samples.drain(..HOP_SAMPLES);
            }
        }
    }

    /// The observations that are still owed when the sound has ended, in order.
    pub fn finish(&mut self) -> Vec<[f32; N_OBSERVATION]> {
        let count = self.count();
        (self.next..count).map(|t| self.observation(t)).collect()
    }

    /// Frames analysed so far.
    fn count(&self) -> usize {
        self.first + self.frames.len()
    }

    fn window(&mut self) -> Observed {
        let raw = self.analyser.frame(&self.samples);
        let statics = match &mut self.normaliser {
            Some((_, causal)) => causal.next(&raw),
            None => raw,
        };
        self.frames.push_back((raw, statics));
        let observation = (self.count() - self.next > OBSERVATION_DELAY).then(|| {
            let observation = self.observation(self.next);
            self.next += 1;
            // The next one looks back as far as this one has.
            if self.next > self.first + OBSERVATION_DELAY {
                self.frames.pop_front();
                self.first += 1;
            }
            observation
        });
        Observed {
            statics: statics.map(|v| v as f32),
            observation,
        }
    }

    /// All 39 numbers of frame `t`; beyond either end of what is known stands the first or the last frame, for Δ and then for ΔΔ,
    /// as HTK does.
    fn observation(&self, t: usize) -> [f32; N_OBSERVATION] {
        let last = self.count() - 1;
        let raw = |t: usize| &self.frames[t.min(last) - self.first].0;
        let norm: usize = 2 * (1..=WIDTH).map(|k| k * k).sum::<usize>();
        let delta = |t: usize, i: usize| {
            let t = t.min(last);
            let sum: f64 = (1..=WIDTH)
                .map(|k| k as f64 * (raw(t + k)[i] - raw(t.saturating_sub(k))[i]))
                .sum();
            sum / norm as f64
        };
        let second = |i: usize| {
            let sum: f64 = (1..=WIDTH)
                .map(|k| k as f64 * (delta(t + k, i) - delta(t.saturating_sub(k), i)))
                .sum();
            sum / norm as f64
        };
        let statics = &self.frames[t - self.first].1;
        std::array::from_fn(|n| match n / N_STATIC {
            0 => statics[n] as f32,
            1 => delta(t, n % N_STATIC) as f32,
            _ => second(n % N_STATIC) as f32,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::observations;

    fn sound(length: usize) -> Vec<i16> {
        let wave = |n: usize| (n as f64 * 0.11).sin() * 4000.0 * (n as f64 * 0.0013).sin();
        (0..length)
            .map(|n| wave(n) as i16 + (n * 7919 % 61) as i16)
            .collect()
    }

    #[test]
    fn a_stream_gives_what_the_whole_sound_gives() {
        let normalisation = Normalisation::Causal {
            start_mean: [1.5; N_STATIC],
        };
        for length in [0, 399, 400, 560, 1200, 3000, 20_000] {
            let sound = sound(length);
            let whole = observations(&sound, normalisation);
            for piece in [1, 160, 777, length.max(1)] {
                let mut observer = Observer::new(normalisation);
                let (mut statics, mut all) = (Vec::new(), Vec::new());
                for samples in sound.chunks(piece) {
                    observer.push(samples, |seen| {
                        statics.push(seen.statics);
                        all.extend(seen.observation);
                    });
                }
                all.extend(observer.finish());
                assert_eq!(all.len(), whole.nrows(), "{length} in pieces of {piece}");
                for ((want, got), statics) in whole.outer_iter().zip(&all).zip(&statics) {
                    assert_eq!(want.to_vec(), got);
                    assert_eq!(statics[..], got[..N_STATIC]);
                }
            }
        }
    }
}
