//! The converter: statics and observations of the front end in, mouth parameters of one frame at a time out.
//!
//! Frame t's occupancies wait for observation t + lag, its context for the statics of t + look-ahead; observations
//! come [`DELTA_HOPS`] hops after their statics. The moving average over frames t − 1, t, t + 1 (X&L section 6; at the
//! ends of an utterance over those that exist) costs one hop more. See [`Converter::delay_hops`].
use super::follower::Follower;
use super::gates::{Gates, viseme_weights};
use super::local_linear::{History, apply};
use crate::fixed::saturate_i16;
use crate::logmath::LogProb;
use crate::mge::context::{Means, project};
use crate::mge::memory::Memory;
use crate::mge::occupancy::Occupancy;
use crate::mge::settle::settle;
use crate::model::Model;
use crate::model::field::limit;
use crate::parameters::{MAX_PARAMETERS, N_VISEMES, ParameterFrame};
use crate::wire::Profile;
use crate::{FRAME_SAMPLES, HOP_SAMPLES, N_OBSERVATION, N_STATIC};

/// Hops that an observation comes after its statics.
pub const DELTA_HOPS: usize = crate::frontend::OBSERVATION_DELAY;

/// Run-time settings; None is the model's own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Settings {
    /// Hops that an occupancy waits for, beyond the look-ahead of ΔΔ; held to what the window has room for.
    pub lag: Option<u16>,
    /// Width of the beam; held to 16384 bits, which is no beam at all.
    pub beam: Option<LogProb>,
    /// Exponent on the audio likelihood, Q16.16; held to 4.
    pub acoustic_scale: Option<u32>,
    /// Whether three frames are averaged.
    pub average: Option<bool>,
    /// Hops of future that a model with a memory waits for; held to its latest tap. Where that reaches further, the newest
    /// frame stands for those that are not known yet. Other models have one look-ahead.
    pub look_ahead: Option<u16>,
    /// Active joint states, at most; held to the stream's room. With [`Settings::phones`] it bounds the work of the worst
    /// frame.
    pub most: Option<u16>,
    /// Phones whose states a model with a memory evaluates in one frame, at most and at least one. It bites only in frames that
    /// reach more than 416 joint states, as many as a first frame of 32 phones has.
    pub phones: Option<u16>,
    /// The mouth by the paper's EM in place of the maps (see [`crate::hmm::feedback`]): exponent of the visual likelihood, Q16.16,
    /// held to 4; 0 is EM without feedback. Models without visual densities keep their way. The lag is held to the
    /// window's room less one frame.
    pub feedback: Option<u32>,
    /// Whether a mouth that hardly moves is followed slowly (see [`crate::mge::settle`]); of a model with a memory only, and the
    /// default there.
    pub settle: Option<bool>,
}

impl Settings {
    /// What a profile means (DESIGN section 5). Its delay is [`Converter::delay_hops`].
    pub const fn of(profile: Profile) -> Self {
        let own = Self {
            lag: None,
            beam: None,
            acoustic_scale: None,
            average: None,
            look_ahead: None,
            most: None,
            phones: None,
            feedback: None,
            settle: None,
        };
        match profile {
            // 30 ms and half a window; without a memory the least delay that observations with ΔΔ and the maps allow.
            Profile::Live => Self {
                lag: Some(0),
                average: Some(false),
                look_ahead: Some(3),
                ..own
            },
            // 60 ms and half a window; without a memory as the model was made.
            Profile::Standard => Self {
                look_ahead: Some(6),
                ..own
            },
            // All that the model can use.
            Profile::Studio => Self {
                lag: Some(u16::MAX),
                ..own
            },
        }
    }
}

/// What the gates of a frame were, while its context is still to come.
#[derive(Clone, Debug)]
struct Gated {
    gates: Gates,
    viseme_weights: [u8; N_VISEMES],
}

/// Frames that can wait for their context: the latest tap, with room to spare.
const MAX_WAITING: usize = 18;

/// A frame before the moving average.
type Raw = (heapless::Vec<i16, MAX_PARAMETERS>, [u8; N_VISEMES]);

/// [`Settings`] with the model's own in place of what they leave open.
#[derive(Clone, Copy, Debug)]
struct Run {
    lag: usize,
    /// Hops of future that are waited for.
    ahead: usize,
    average: bool,
    beam: LogProb,
    acoustic_scale: u32,
    /// Exponent of the mouth's likelihood where it feeds back.
    feedback: Option<u32>,
    settle: bool,
}

impl Run {
    fn of<const FRAMES: usize>(model: &Model, settings: &Settings) -> Self {
        let lag = settings.lag.map_or(model.lag(), usize::from);
        let own = model.look_ahead();
        let feedback = settings.feedback.filter(|_| model.has_visual_densities());
        // α of the frame before the window is kept for the sweep.
        let room = FRAMES.saturating_sub(1 + usize::from(feedback.is_some()));
        Self {
            lag: lag.min(room),
            feedback: feedback.map(|exponent| exponent.min(limit::ACOUSTIC_SCALE)),
            settle: settings.settle.unwrap_or(true),
            ahead: match settings.look_ahead {
                _ if feedback.is_some() => 0,
                Some(hops) if model.is_recurrent() => usize::from(hops).min(own),
                _ => own,
            },
            average: settings.average.unwrap_or(model.average()),
            beam: settings.beam.unwrap_or(model.beam()),
            acoustic_scale: settings.acoustic_scale.unwrap_or(model.acoustic_scale()),
        }
    }
}

/// The state of one stream. `TOKENS` bounds the active joint states, `FRAMES` − 1 the lag.
#[derive(Clone, Debug)]
pub struct Converter<'m, const TOKENS: usize, const FRAMES: usize> {
    model: &'m Model<'m>,
    run: Run,
    follower: Follower<'m, TOKENS, FRAMES>,
    history: History,
    /// Of a model with a memory.
    means: Means,
    memory: Memory,
    waiting: heapless::Deque<Gated, MAX_WAITING>,
    /// Whether the memory holds what stands before the first frame, or more.
    begun: bool,
    /// Frames gated, frames mapped, frames given out.
    gated: u32,
    mapped: u32,
    given: u32,
    /// Mapped frames that are still to be given out: frame `given` and its successor.
    mapped_frames: heapless::Deque<Raw, 2>,
    /// Values of frame `given` − 1: before averaging, or as they were given out where the mouth settles.
    before: heapless::Vec<i16, MAX_PARAMETERS>,
    ended: bool,
}

impl<'m, const TOKENS: usize, const FRAMES: usize> Converter<'m, TOKENS, FRAMES> {
    /// One literal, inlined into the place that it is made for: the state is large, and copies of it cost a device its stack.
    #[inline(always)]
    pub fn new(model: &'m Model<'m>, settings: Settings) -> Self {
        let run = Run::of::<FRAMES>(model, &settings);
        Self {
            model,
            run,
            follower: Follower::new(
                model,
                run.beam,
                run.acoustic_scale,
                settings.most,
                settings.phones,
            ),
            history: History::new(),
            means: Means::new(),
            memory: Memory::new(),
            waiting: heapless::Deque::new(),
            begun: false,
            gated: 0,
            mapped: 0,
            given: 0,
            mapped_frames: heapless::Deque::new(),
            before: heapless::Vec::new(),
            ended: false,
        }
    }

    /// Other settings; starts a new stream.
    pub fn set(&mut self, settings: Settings) {
        self.run = Run::of::<FRAMES>(self.model, &settings);
        self.follower.set(self.run.beam, self.run.acoustic_scale);
        self.follower.set_bounds(settings.most, settings.phones);
        self.reset();
    }

    /// Forgets the stream; the next frame is frame 0.
    pub fn reset(&mut self) {
        self.follower.reset();
        self.history.reset();
        self.means.reset();
        self.begun = false;
        self.waiting.clear();
        self.mapped_frames.clear();
        self.before.clear();
        self.gated = 0;
        self.mapped = 0;
        self.given = 0;
        self.ended = false;
    }

    /// Lag in force, hops.
    pub fn lag(&self) -> usize {
        self.run.lag
    }

    /// Hops between a frame and the hop that brings its parameters out.
    pub fn delay_hops(&self) -> usize {
        if self.model.is_recurrent() {
            return self.run.ahead;
        }
        (self.run.lag + DELTA_HOPS).max(self.run.ahead) + usize::from(self.run.average)
    }

    /// Active joint states of the newest frame.
    pub fn active(&self) -> usize {
        self.follower.active().len()
    }

    /// Frames since the beginning in which the beam was narrowed, as more than the bounds of [`Settings`] would have stayed.
    pub fn narrowed(&self) -> u32 {
        self.follower.narrowed()
    }

    /// One hop: the next frame's statics (None once the sound has ended), the next observation if there is one yet,
    /// both Q7.8. Gives at most one frame, [`Converter::delay_hops`] late.
    pub fn push(
        &mut self,
        statics: Option<&[i16; N_STATIC]>,
        observation: Option<&[i16; N_OBSERVATION]>,
    ) -> Option<ParameterFrame> {
        if self.model.is_recurrent() {
            return self.speak(statics);
        }
        match statics {
            Some(statics) => self.history.push(statics),
            None => self.ended = true,
        }
        if let Some(observation) = observation {
            self.follower.follow(observation);
            if let Some(exponent) = self.run.feedback {
                self.follower.sweep(self.run.lag, exponent);
            }
        }
        if self.run.feedback.is_some() {
            self.leave_window();
        } else {
            self.gate();
            self.map();
        }
        self.give()
    }

    /// One hop of a model with a memory: it hears statics only, and nothing waits but the context.
    fn speak(&mut self, statics: Option<&[i16; N_STATIC]>) -> Option<ParameterFrame> {
        let model = self.model;
        match statics {
            Some(statics) => {
                self.history.push(statics);
                self.means.push(model, statics);
            }
            None => self.ended = true,
        }
        let ahead = self.history.count().wrapping_sub(self.given) as usize;
        if ahead == 0 || (ahead <= self.run.ahead && !self.ended) {
            return None;
        }
        if self.ended {
            // The look-ahead of this frame reaches behind the end.
            for _ in ahead..=self.run.ahead {
                if self.means.heard().wrapping_sub(self.given) as usize <= self.run.ahead {
                    self.means.push_last(model);
                }
            }
        }
        if !self.begun {
            self.memory.reset(model);
            self.begun = true;
        }
        let z = project(model, &self.history, &self.means, self.given);
        let z = z.get(..model.shape().inputs).unwrap_or(&[]);
        let fed_back = self.memory.mouth().get(..model.shape().fed_back()).unwrap_or(&[]);
        self.follower.follow_inputs(z, fed_back);
        let occupancy = Occupancy::of(model, self.follower.active());
        let audio = Gates::choose(&occupancy.audio);
        let visual = Gates::choose(&occupancy.visual);
        let mut values = self.memory.step(model, z, &audio, &visual);
        if self.run.settle {
            settle(&self.before, &mut values);
            self.before.clone_from(&values);
        }
        self.numbered(values, viseme_weights(&occupancy.visual))
    }

    /// The next frame to be given out.
    fn numbered(
        &mut self,
        values: heapless::Vec<i16, MAX_PARAMETERS>,
        viseme_weights: [u8; N_VISEMES],
    ) -> Option<ParameterFrame> {
        let frame = self.given;
        self.given = frame.wrapping_add(1);
        Some(ParameterFrame {
            frame,
            sample: frame
                .wrapping_mul(HOP_SAMPLES as u32)
                .wrapping_add(FRAME_SAMPLES as u32 / 2),
            values,
            viseme_weights,
        })
    }

    /// Whether the sound has ended.
    pub fn has_ended(&self) -> bool {
        self.ended
    }

    /// Whether the sound has ended and every frame has been given out.
    pub fn is_done(&self) -> bool {
        self.ended && self.given == self.history.count()
    }

    /// How many frames before the newest the next one is whose states are to be settled, once its lag has come or the sound
    /// has ended.
    fn settled(&self) -> Option<usize> {
        let known = self.follower.count().wrapping_sub(self.gated) as usize;
        let all = self.ended && self.follower.count() == self.history.count();
        known.checked_sub(1).filter(|age| all || *age >= self.run.lag)
    }

    /// The next frame's mouth as the last sweep has left it.
    fn leave_window(&mut self) {
        let Some(age) = self.settled().filter(|_| !self.mapped_frames.is_full()) else {
            return;
        };
        if let Some(seen) = self.follower.seen(age) {
            let values = seen.mouth.iter().take(self.model.n_parameters());
            let frame = (values.copied().collect(), seen.viseme_weights);
            // There is room, as has been checked.
            let _ = self.mapped_frames.push_back(frame);
        }
        self.gated = self.gated.wrapping_add(1);
        self.mapped = self.mapped.wrapping_add(1);
    }

    /// Occupancies of the next frame.
    fn gate(&mut self) {
        let Some(age) = self.settled().filter(|_| !self.waiting.is_full()) else {
            return;
        };
        let occupancy = self.follower.occupancies(age);
        // There is room, as has been checked.
        let _ = self.waiting.push_back(Gated {
            gates: Gates::choose(&occupancy),
            viseme_weights: viseme_weights(&occupancy),
        });
        self.gated = self.gated.wrapping_add(1);
    }

    /// Maps the next frame, once its gates and its context are there.
    fn map(&mut self) {
        let ahead = self.history.count().wrapping_sub(self.mapped) as usize;
        if self.mapped_frames.is_full() || (ahead <= self.run.ahead && !self.ended) {
            return;
        }
        let Some(gated) = self.waiting.pop_front() else {
            return;
        };
        let x = self.history.project(self.model, self.mapped);
        let values = apply(self.model, &x, &gated.gates);
        // There is room, as has been checked.
        let _ = self.mapped_frames.push_back((values, gated.viseme_weights));
        self.mapped = self.mapped.wrapping_add(1);
    }

    /// The next frame, averaged with its neighbours.
    fn give(&mut self) -> Option<ParameterFrame> {
        let last = self.ended && self.given.wrapping_add(1) == self.history.count();
        let (values, viseme_weights) = if self.run.average {
            self.average(last)?
        } else {
            self.mapped_frames.pop_front()?
        };
        self.numbered(values, viseme_weights)
    }

    /// Frame `given`, averaged: `mapped_frames` holds it and its successor, `before` its predecessor.
    fn average(&mut self, last: bool) -> Option<Raw> {
        if self.mapped_frames.len() < 2 && !last {
            return None;
        }
        let (values, weights) = self.mapped_frames.pop_front()?;
        let before = (self.given > 0).then_some(&self.before);
        let after = self.mapped_frames.front().map(|f| &f.0);
        let smooth = values
            .iter()
            .enumerate()
            .map(|(d, &value)| {
                let at = |frame: Option<&heapless::Vec<i16, MAX_PARAMETERS>>| {
                    frame.and_then(|f| f.get(d)).map(|v| i32::from(*v))
                };
                mean(i32::from(value), at(before), at(after))
            })
            .collect();
        self.before = values;
        Some((smooth, weights))
    }
}

/// Mean of a value and the neighbours that exist, rounded to nearest (halves up).
fn mean(value: i32, before: Option<i32>, after: Option<i32>) -> i16 {
    let sum = value + before.unwrap_or(0) + after.unwrap_or(0);
    let mean = match (before, after) {
        (None, None) => sum,
        (Some(_), Some(_)) => (2 * sum + 3).div_euclid(6),
        _ => (sum + 1) >> 1,
    };
    saturate_i16(mean)
}
