//! The converter: statics and observations of the front end in, parameters of one frame at a time out.
//!
//! Frame t's occupancies wait for observation t + lag, its context for the statics of t + look-ahead; observations come
//! [`OBSERVATION_DELAY`] hops after their statics. The moving average over frames t − 1, t, t + 1 (Xie & Liu 2007 (X&L), section 6;
//! at the ends of an utterance over those that exist) costs one hop more.
use super::follower::Follower;
use super::local_linear::{apply, project};
use super::tables::MAX_ACOUSTIC_SCALE;
use super::{Likelihood, Sealed};
use crate::context::History;
use crate::fixed::saturate_i16;
use crate::frame::{MAX_PARAMETERS, ParameterFrame, VisemeWeights};
use crate::frontend::OBSERVATION_DELAY;
use crate::hmm::gates::{Gates, viseme_weights};
use crate::kinds::Convert;
use crate::logmath::LogProb;
use crate::model::Model;
use crate::settings::StreamSettings;
use crate::{N_OBSERVATION, N_STATIC};

/// The states that take part in a frame, while its context is still to come.
#[derive(Clone, Debug)]
struct Gated {
    gates: Gates,
    viseme_weights: VisemeWeights,
}

/// Frames that can wait for their context: the latest tap, with room to spare.
const MAX_WAITING: usize = 18;

/// A frame before the moving average.
type Raw = (heapless::Vec<i16, MAX_PARAMETERS>, VisemeWeights);

/// [`StreamSettings`] with the model's own in place of what they leave open.
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
}

impl Run {
    fn of<const FRAMES: usize>(model: &Likelihood, settings: &StreamSettings) -> Self {
        let own = model.settings();
        let lag = settings.lag.unwrap_or(own.lag);
        let feedback = settings.feedback.filter(|_| model.has_visual_densities());
        // Re-estimation begins its sweep at the frame before the window, whose place the lag may not take.
        let room = FRAMES.saturating_sub(1 + usize::from(feedback.is_some()));
        Self {
            lag: usize::from(lag).min(room),
            feedback: feedback.map(|exponent| exponent.min(MAX_ACOUSTIC_SCALE)),
            ahead: match feedback {
                // The re-estimated mouth reads no context.
                Some(_) => 0,
                None => model.context().look_ahead(),
            },
            average: settings.average.unwrap_or(own.average),
            beam: settings.beam.unwrap_or(own.beam),
            acoustic_scale: settings.acoustic_scale.unwrap_or(own.acoustic_scale),
        }
    }
}

/// The state of one stream. `TOKENS` bounds the active joint states, `FRAMES` − 1 the lag.
#[derive(Clone, Debug)]
pub struct Converter<'m, const TOKENS: usize, const FRAMES: usize> {
    model: &'m Likelihood<'m>,
    run: Run,
    follower: Follower<'m, TOKENS, FRAMES>,
    history: History,
    waiting: heapless::Deque<Gated, MAX_WAITING>,
    /// Frames whose occupancies are final, modulo 2³².
    gated: u32,
    /// Frames whose parameters have been computed.
    mapped: u32,
    /// Frames given out.
    given: u32,
    /// Mapped frames that are still to be given out: frame `given` and its successor.
    mapped_frames: heapless::Deque<Raw, 2>,
    /// Values of frame `given` − 1 before they were averaged: the next average needs them.
    before: heapless::Vec<i16, MAX_PARAMETERS>,
    ended: bool,
}

impl<const TOKENS: usize, const FRAMES: usize> Sealed for Converter<'_, TOKENS, FRAMES> {}

impl<'m, const TOKENS: usize, const FRAMES: usize> Convert<'m, Likelihood<'m>>
    for Converter<'m, TOKENS, FRAMES>
{
    const HELD_BACK: usize = FRAMES;

    #[inline(always)]
    fn new(model: &'m Model<'m, Likelihood<'m>>, settings: StreamSettings) -> Self {
        let model = model.own();
        let run = Run::of::<FRAMES>(model, &settings);
        Self {
            model,
            run,
            follower: Follower::new(model, run.beam, run.acoustic_scale, settings.most),
            history: History::new(),
            waiting: heapless::Deque::new(),
            gated: 0,
            mapped: 0,
            given: 0,
            mapped_frames: heapless::Deque::new(),
            before: heapless::Vec::new(),
            ended: false,
        }
    }

    fn set(&mut self, settings: StreamSettings) {
        self.run = Run::of::<FRAMES>(self.model, &settings);
        self.follower
            .set(self.run.beam, self.run.acoustic_scale, settings.most);
        self.reset();
    }

    fn reset(&mut self) {
        self.follower.reset();
        self.history.reset();
        self.waiting.clear();
        self.mapped_frames.clear();
        self.before.clear();
        self.gated = 0;
        self.mapped = 0;
        self.given = 0;
        self.ended = false;
    }

    fn push(
        &mut self,
        statics: Option<&[i16; N_STATIC]>,
        observation: Option<&[i16; N_OBSERVATION]>,
    ) -> Option<ParameterFrame> {
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

    fn has_ended(&self) -> bool {
        self.ended
    }

    fn is_done(&self) -> bool {
        self.ended && self.given == self.history.count()
    }

    fn delay_hops(&self) -> usize {
        (self.run.lag + OBSERVATION_DELAY).max(self.run.ahead) + usize::from(self.run.average)
    }

    fn active(&self) -> usize {
        self.follower.active().len()
    }

    fn narrowed(&self) -> u32 {
        self.follower.narrowed()
    }
}

impl<const TOKENS: usize, const FRAMES: usize> Converter<'_, TOKENS, FRAMES> {
    /// How many frames before the newest observation the next frame to be gated stands, once nothing that is still to come may change
    /// its occupancies: the lag has passed, or the sound has ended and its last observation has come. None until then.
    fn settled(&self) -> Option<usize> {
        let known = self.follower.count().wrapping_sub(self.gated) as usize;
        let heard_out = self.ended && self.follower.count() == self.history.count();
        known
            .checked_sub(1)
            .filter(|age| heard_out || *age >= self.run.lag)
    }

    /// The next frame's mouth as the last sweep has left it.
    fn leave_window(&mut self) {
        let Some(age) = self.settled().filter(|_| !self.mapped_frames.is_full()) else {
            return;
        };
        if let Some(seen) = self.follower.seen(age) {
            let values = seen.mouth.iter().take(self.model.n_parameters);
            let frame = (values.copied().collect(), seen.viseme_weights.clone());
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
        let x = project(self.model.context(), &self.history, self.mapped);
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
        let frame = self.given;
        self.given = frame.wrapping_add(1);
        Some(ParameterFrame::numbered(frame, values, viseme_weights))
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
