//! The converter: statics of the front end in, parameters of one frame at a time out, the look-ahead late.
//!
//! It hears statics only (its context knows how they change), and nothing waits but the context.
use super::context::{Means, project};
use super::follower::Follower;
use super::gated::GatedMemory;
use super::memory::Memory;
use super::occupancy::Occupancy;
use super::settle::settle;
use super::{Recurrent, Sealed};
use crate::context::History;
use crate::frame::{MAX_PARAMETERS, ParameterFrame};
use crate::hmm::gates::{Gates, viseme_weights};
use crate::kinds::Convert;
use crate::logmath::LogProb;
use crate::model::Model;
use crate::settings::StreamSettings;
use crate::{N_OBSERVATION, N_STATIC};

/// [`StreamSettings`] with the model's own in place of what they leave open.
#[derive(Clone, Copy, Debug)]
struct Run {
    /// Hops of future that are waited for.
    ahead: usize,
    beam: LogProb,
    settle: bool,
}

impl Run {
    fn of(model: &Recurrent, settings: &StreamSettings) -> Self {
        let own = model.context().look_ahead();
        Self {
            ahead: settings.look_ahead.map_or(own, |hops| usize::from(hops).min(own)),
            beam: settings.beam.unwrap_or(model.settings().beam),
            settle: settings.settle.unwrap_or(true),
        }
    }
}

/// The state of one stream. `ROOM` bounds the active joint states.
#[derive(Clone, Debug)]
pub struct Converter<'m, const ROOM: usize> {
    model: &'m Recurrent<'m>,
    run: Run,
    follower: Follower<'m, ROOM>,
    history: History,
    means: Means,
    memory: Memory,
    gated: GatedMemory,
    /// Whether the memory has been put where a stream begins.
    begun: bool,
    /// Frames given out, modulo 2³².
    given: u32,
    /// Values of frame `given` − 1 as they were given out, where the mouth settles.
    shown: heapless::Vec<i16, MAX_PARAMETERS>,
    ended: bool,
}

impl<const ROOM: usize> Sealed for Converter<'_, ROOM> {}

impl<'m, const ROOM: usize> Convert<'m, Recurrent<'m>> for Converter<'m, ROOM> {
    const HELD_BACK: usize = 1;

    #[inline(always)]
    fn new(model: &'m Model<'m, Recurrent<'m>>, settings: StreamSettings) -> Self {
        let model = model.own();
        let run = Run::of(model, &settings);
        Self {
            model,
            run,
            follower: Follower::new(model, run.beam, settings.most, settings.phones),
            history: History::new(),
            means: Means::new(),
            memory: Memory::new(),
            gated: GatedMemory::new(),
            begun: false,
            given: 0,
            shown: heapless::Vec::new(),
            ended: false,
        }
    }

    fn set(&mut self, settings: StreamSettings) {
        self.run = Run::of(self.model, &settings);
        self.follower.set(self.run.beam, settings.most, settings.phones);
        self.reset();
    }

    fn reset(&mut self) {
        self.follower.reset();
        self.history.reset();
        self.means.reset();
        self.begun = false;
        self.given = 0;
        self.shown.clear();
        self.ended = false;
    }

    fn push(
        &mut self,
        statics: Option<&[i16; N_STATIC]>,
        _: Option<&[i16; N_OBSERVATION]>,
    ) -> Option<ParameterFrame> {
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
            self.gated.reset(model.gated());
            self.begun = true;
        }
        let z = project(model, &self.history, &self.means, self.given);
        let z = z.get(..model.context().n_inputs()).unwrap_or(&[]);
        let fed_back = self.memory.mouth().get(..model.n_fed_back()).unwrap_or(&[]);
        self.follower.follow(z, fed_back);
        let occupancy = Occupancy::of(model.hmm(), self.follower.active());
        let audio = Gates::choose(&occupancy.audio);
        let visual = Gates::choose(&occupancy.visual);
        let mut values = self.memory.step(model, z, &audio, &visual);
        if let Some(gated) = model.gated() {
            self.gated.step(gated, self.given, z, &mut values);
        }
        if self.run.settle {
            settle(&self.shown, &mut values);
            self.shown.clone_from(&values);
        }
        let frame = self.given;
        self.given = frame.wrapping_add(1);
        Some(ParameterFrame::numbered(
            frame,
            values,
            viseme_weights(&occupancy.visual),
        ))
    }

    fn has_ended(&self) -> bool {
        self.ended
    }

    fn is_done(&self) -> bool {
        self.ended && self.given == self.history.count()
    }

    fn delay_hops(&self) -> usize {
        self.run.ahead
    }

    fn active(&self) -> usize {
        self.follower.active().len()
    }

    fn narrowed(&self) -> u32 {
        self.follower.narrowed()
    }
}
