//! A session that streams: samples of any cut in, parameter frames out, whichever engine and kind of model runs.
//!
//! ```no_run
//! use lipstream::engine::{Engine, RunSettings};
//!
//! # fn microphone() -> Option<Vec<i16>> { None }
//! # fn move_mouth(_parameters: &[f32]) {}
//! let engine = Engine::shipped();
//! let mut session = engine.session(&RunSettings::default())?;
//! while let Some(samples) = microphone() {
//!     // 16 kHz, cut anywhere.
//!     session.push(&samples, |frame| move_mouth(frame.parameters))?;
//! }
//! session.finish(|frame| move_mouth(frame.parameters))?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
use lipstream_core::{AnyStream, N_OBSERVATION, ParameterFrame};
use ndarray::Array2;

use crate::engine::Converted;
use crate::kinds::likelihood::NotFinite;
use crate::kinds::likelihood::live::Live as LocalLinear;
use crate::kinds::recurrent::live::{Live as Recurrent, Spoken};
use crate::kinds::recurrent::settle::settle_frame;
use crate::phones::VISEMES;
use crate::reference::observer::Observer;

/// One frame of a session, as long as the call that gives it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame<'a> {
    /// Counted from 0; [`crate::time`] says when it is.
    pub index: usize,
    /// `[D]`, in the units of the visual features.
    pub parameters: &'a [f32],
    /// Occupancy of each viseme `[13]`; empty where the model has none.
    pub visemes: &'a [f32],
}

/// One stream of speech through an engine, see [`crate::engine::Engine::session`].
///
/// What comes out does not depend on how the samples are cut. Memory does not grow with the sound, but for systems that hear the whole
/// utterance before they speak (means and Viterbi paths in floats, EM in floats): these keep its observations and give every frame in
/// [`Session::finish`].
pub struct Session<'e> {
    running: Running<'e>,
    /// Frames given out.
    given: usize,
}

/// A conversion of all observations at once.
pub(crate) type Whole<'e> = Box<dyn Fn(&Array2<f32>) -> Result<Converted, NotFinite> + 'e>;

pub(crate) enum Running<'e> {
    /// The device's stream, and what one LSB of each parameter is worth.
    Fixed {
        stream: Box<AnyStream<'e>>,
        scales: Vec<f32>,
    },
    LocalLinear {
        observer: Observer,
        live: Box<LocalLinear<'e>>,
    },
    Recurrent {
        observer: Observer,
        live: Box<Recurrent<'e>>,
        /// Where a mouth that hardly moves is followed slowly: the deviations.
        settle: Option<&'e [f32]>,
        /// The mouth that was given out last.
        before: Vec<f32>,
    },
    Whole {
        observer: Observer,
        heard: Vec<f32>,
        convert: Whole<'e>,
    },
}

impl<'e> Session<'e> {
    pub(crate) fn new(running: Running<'e>) -> Self {
        Self { running, given: 0 }
    }

    /// Takes 16 kHz mono samples, cut anywhere; `each` is called with every frame that they bring out.
    ///
    /// # Errors
    ///
    /// A float engine whose model holds numbers that no sound fits says so; the fixed engine never fails.
    pub fn push(&mut self, samples: &[i16], mut each: impl FnMut(Frame)) -> Result<(), NotFinite> {
        let given = &mut self.given;
        let mut give = |parameters: &[f32], visemes: &[f32]| {
            each(Frame {
                index: *given,
                parameters,
                visemes,
            });
            *given += 1;
        };
        match &mut self.running {
            Running::Fixed { stream, scales } => {
                let mut rest = samples;
                while !rest.is_empty() {
                    let (consumed, frame) = stream.push(rest);
                    rest = &rest[consumed..];
                    if let Some(frame) = frame {
                        give_fixed(&frame, scales, &mut give);
                    }
                }
                Ok(())
            }
            Running::LocalLinear { observer, live } => {
                let mut result = Ok(());
                observer.push(samples, |seen| {
                    if let (Some(observation), Ok(())) = (seen.observation, result) {
                        result = live.push(observation, &mut give);
                    }
                });
                result
            }
            Running::Recurrent {
                observer,
                live,
                settle,
                before,
            } => {
                observer.push(samples, |seen| {
                    if let Some(spoken) = live.push(seen.statics) {
                        give_spoken(spoken, *settle, before, &mut give);
                    }
                });
                Ok(())
            }
            Running::Whole { observer, heard, .. } => {
                observer.push(samples, |seen| {
                    heard.extend(seen.observation.into_iter().flatten())
                });
                Ok(())
            }
        }
    }

    /// The sound has ended: `each` is called with the frames that are still owed.
    ///
    /// # Errors
    ///
    /// As [`Session::push`].
    pub fn finish(mut self, mut each: impl FnMut(Frame)) -> Result<(), NotFinite> {
        let given = &mut self.given;
        let mut give = |parameters: &[f32], visemes: &[f32]| {
            each(Frame {
                index: *given,
                parameters,
                visemes,
            });
            *given += 1;
        };
        match self.running {
            Running::Fixed { mut stream, scales } => {
                while let Some(frame) = stream.finish() {
                    give_fixed(&frame, &scales, &mut give);
                }
                Ok(())
            }
            Running::LocalLinear {
                mut observer,
                mut live,
            } => {
                for observation in observer.finish() {
                    live.push(observation, &mut give)?;
                }
                live.finish(&mut give)
            }
            Running::Recurrent {
                mut live,
                settle,
                mut before,
                ..
            } => {
                while let Some(spoken) = live.finish() {
                    give_spoken(spoken, settle, &mut before, &mut give);
                }
                Ok(())
            }
            Running::Whole {
                mut observer,
                mut heard,
                convert,
            } => {
                heard.extend(observer.finish().into_iter().flatten());
                let frames = heard.len() / N_OBSERVATION;
                let heard =
                    Array2::from_shape_vec((frames, N_OBSERVATION), heard).expect("whole observations");
                let said = convert(&heard)?;
                for (parameters, visemes) in
                    std::iter::zip(said.parameters.outer_iter(), said.visemes.outer_iter())
                {
                    give(&parameters.to_vec(), &visemes.to_vec());
                }
                Ok(())
            }
        }
    }
}

fn give_fixed(frame: &ParameterFrame, scales: &[f32], give: &mut impl FnMut(&[f32], &[f32])) {
    let parameters: Vec<f32> = frame
        .values
        .iter()
        .zip(scales)
        .map(|(v, s)| f32::from(*v) * s)
        .collect();
    let visemes: Vec<f32> = frame
        .viseme_weights
        .iter()
        .map(|w| f32::from(*w) / 255.0)
        .collect();
    give(&parameters, &visemes);
}

fn give_spoken(
    spoken: Spoken,
    settle: Option<&[f32]>,
    before: &mut Vec<f32>,
    give: &mut impl FnMut(&[f32], &[f32]),
) {
    let mut parameters = spoken.parameters;
    if let Some(deviation) = settle {
        if !before.is_empty() {
            settle_frame(before, &mut parameters, deviation);
        }
        before.clone_from(&parameters);
    }
    let states = spoken.visual.len() / VISEMES.len();
    let visemes: Vec<f32> = spoken
        .visual
        .chunks_exact(states.max(1))
        .map(|v| v.iter().sum())
        .collect();
    give(&parameters, &visemes);
}
