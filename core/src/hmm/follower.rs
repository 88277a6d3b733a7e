//! The forward pass: observations in, active joint states and their smoothed occupancies out (X&L section 3.4, with a
//! beam and a lag).
//!
//! Per frame: probability moves along the arcs (those that bring less than the beam's width below the best are left
//! out before any density is evaluated), the audio states that are reached are evaluated once each, the beam prunes.
//! Should the beam let no arc through at all, the best token stays where it is.
use super::beam::prune;
use super::density::{Scaled, log_likelihood};
use super::lag::{Frame, MAX_AUDIO_STATES, Window};
use super::token::{PhonesByViseme, Scores, Token, begin, forward};
use crate::N_OBSERVATION;
use crate::logmath::LogProb;
use crate::model::Model;
use crate::model::field::{N_VISUAL_STATES, limit};

/// The state of one stream. `TOKENS` bounds the active joint states, `FRAMES` − 1 the lag.
#[derive(Clone, Debug)]
pub struct Follower<'m, const TOKENS: usize, const FRAMES: usize> {
    model: &'m Model<'m>,
    beam: LogProb,
    acoustic_scale: u32,
    phones: PhonesByViseme,
    scores: Scores,
    window: Window<TOKENS, FRAMES>,
    count: u32,
}

impl<'m, const TOKENS: usize, const FRAMES: usize> Follower<'m, TOKENS, FRAMES> {
    /// `beam` as a width, held to 16384 bits; `acoustic_scale` in Q16.16, held to 4.
    pub fn new(model: &'m Model<'m>, beam: LogProb, acoustic_scale: u32) -> Self {
        Self {
            model,
            beam: held_beam(beam),
            acoustic_scale: acoustic_scale.min(limit::ACOUSTIC_SCALE),
            phones: PhonesByViseme::new(model),
            scores: Scores::new(),
            window: Window::new(),
            count: 0,
        }
    }

    /// Another beam and acoustic scale; starts a new stream.
    pub fn set(&mut self, beam: LogProb, acoustic_scale: u32) {
        self.beam = held_beam(beam);
        self.acoustic_scale = acoustic_scale.min(limit::ACOUSTIC_SCALE);
        self.reset();
    }

    /// Forgets the stream.
    pub fn reset(&mut self) {
        self.scores.clear();
        self.window.reset();
        self.count = 0;
    }

    /// Observations followed so far, modulo 2³².
    pub fn count(&self) -> u32 {
        self.count
    }

    /// Active joint states of the newest frame.
    pub fn active(&self) -> &[Token] {
        self.window.newest()
    }

    /// Occupancies of the visual states (Q0.16) `age` frames before the newest; `age` is held to the window.
    pub fn occupancies(&mut self, age: usize) -> [u32; N_VISUAL_STATES] {
        self.window
            .occupancies(self.model, &self.phones, self.beam, age, &mut self.scores)
    }

    /// One observation of the front end, Q7.8.
    pub fn follow(&mut self, observation: &[i16; N_OBSERVATION]) {
        let model = self.model;
        let scaled = Scaled::new(model, observation);
        let tokens = self.window.newest();
        if tokens.is_empty() {
            begin(model, &mut self.scores);
        } else {
            let floor = LogProb::from_q12(-self.beam.q12());
            forward(model, &self.phones, tokens, floor, &mut self.scores);
        }
        if self.scores.states().next().is_none() {
            // The beam let no arc through: the best token stays where it is.
            if let Some(best) = tokens.iter().max_by_key(|t| t.score) {
                self.scores.put(best.state, LogProb::ONE);
            }
        }
        let Some(frame) = self.window.advance() else {
            return;
        };
        emit(model, self.acoustic_scale, &scaled, &mut self.scores, frame);
        prune(&self.scores, self.beam, &mut frame.tokens);
        self.scores.clear();
        self.count = self.count.wrapping_add(1);
    }
}

fn held_beam(beam: LogProb) -> LogProb {
    LogProb::from_q12(beam.q12().clamp(1, limit::BEAM))
}

/// Adds the log likelihood of `scaled` to every score, and leaves in `frame` those of the audio states that were asked
/// for, relative to the largest.
fn emit<const TOKENS: usize>(
    model: &Model,
    acoustic_scale: u32,
    scaled: &Scaled,
    scores: &mut Scores,
    frame: &mut Frame<TOKENS>,
) {
    // `NEVER`: not asked for yet.
    let mut logs = [LogProb::NEVER; MAX_AUDIO_STATES];
    let mut best = LogProb::NEVER;
    scores.for_each(|state, score| {
        let audio = state.audio();
        let Some(log) = logs.get_mut(audio) else {
            return;
        };
        if log.is_never() {
            *log = log_likelihood(model, audio, scaled, acoustic_scale);
            best = best.max(*log);
        }
        *score = score.times(*log);
    });
    for (to, log) in frame.emission.iter_mut().zip(&logs) {
        *to = log.over(best).to_score();
    }
}
