//! Following the sound: observations in, active joint states and their smoothed occupancies out (Xie & Liu 2007 (X&L), section 3.4,
//! with a beam and a lag).
//!
//! The audio states that the forward pass reaches ([`crate::hmm::search`]) are evaluated once each.
use super::Likelihood;
use super::density::{Scaled, log_likelihood};
use super::feedback::Seen;
use super::lag::{Frame, Window};
use super::tables::{MAX_ACOUSTIC_SCALE, MixtureTables};
use crate::N_OBSERVATION;
use crate::hmm::search::Search;
use crate::hmm::token::{Scores, Token, begin};
use crate::hmm::transition::{MAX_AUDIO_STATES, N_VISUAL_STATES};
use crate::logmath::LogProb;

/// The state of one stream. `TOKENS` bounds the active joint states, `FRAMES` − 1 the lag.
#[derive(Clone, Debug)]
pub struct Follower<'m, const TOKENS: usize, const FRAMES: usize> {
    model: &'m Likelihood<'m>,
    acoustic_scale: u32,
    search: Search,
    window: Window<TOKENS, FRAMES>,
}

impl<'m, const TOKENS: usize, const FRAMES: usize> Follower<'m, TOKENS, FRAMES> {
    /// `beam` as a width, held to 16384 bits; `acoustic_scale` in Q16.16, held to 4; `most` active joint states, held to `TOKENS`,
    /// which is what `None` stands for.
    #[inline(always)]
    pub fn new(model: &'m Likelihood<'m>, beam: LogProb, acoustic_scale: u32, most: Option<u16>) -> Self {
        Self {
            model,
            acoustic_scale: acoustic_scale.min(MAX_ACOUSTIC_SCALE),
            search: Search::new(model.hmm(), beam, Self::held(most)),
            window: Window::new(),
        }
    }

    /// Another beam, acoustic scale and bound; starts a new stream.
    pub fn set(&mut self, beam: LogProb, acoustic_scale: u32, most: Option<u16>) {
        self.acoustic_scale = acoustic_scale.min(MAX_ACOUSTIC_SCALE);
        self.search.set(beam, Self::held(most));
        self.window.reset();
    }

    fn held(most: Option<u16>) -> usize {
        most.map_or(TOKENS, usize::from).clamp(1, TOKENS)
    }

    /// Forgets the stream.
    pub fn reset(&mut self) {
        self.search.reset();
        self.window.reset();
    }

    /// Frames since the beginning in which the bound narrowed the beam.
    pub fn narrowed(&self) -> u32 {
        self.search.narrowed()
    }

    /// Observations followed so far, modulo 2³².
    pub fn count(&self) -> u32 {
        self.search.count()
    }

    /// Active joint states of the newest frame.
    pub fn active(&self) -> &[Token] {
        self.window.newest()
    }

    /// Occupancies of the visual states (Q0.16) `age` frames before the newest; `age` is held to the window.
    pub fn occupancies(&mut self, age: usize) -> [u32; N_VISUAL_STATES] {
        let beam = self.search.beam();
        let Search { phones, scores, .. } = &mut self.search;
        self.window.occupancies(self.model, phones, beam, age, scores)
    }

    /// One sweep of re-estimation of the mouth over the newest frame and the `lag` before it, see [`super::feedback`].
    pub fn sweep(&mut self, lag: usize, exponent: u32) {
        let beam = self.search.beam();
        let Search { phones, scores, .. } = &mut self.search;
        self.window.sweep(self.model, phones, beam, lag, exponent, scores);
    }

    /// What the last sweep has found `age` frames before the newest; `age` is held to the window.
    pub fn seen(&self, age: usize) -> Option<&Seen> {
        self.window.seen(age)
    }

    /// One observation of the front end, Q7.8.
    pub fn follow(&mut self, observation: &[i16; N_OBSERVATION]) {
        let (hmm, audio) = (self.model.hmm(), self.model.audio());
        let scaled = Scaled::new(audio, observation);
        self.search
            .predict(hmm, self.window.newest(), 0, |scores| begin(hmm, scores));
        let Some(frame) = self.window.advance() else {
            return;
        };
        let best = emit(
            audio,
            self.acoustic_scale,
            &scaled,
            &mut self.search.scores,
            frame,
        );
        self.search.prune(best, false, &mut frame.tokens);
    }
}

/// Adds the log likelihood of `scaled` to every score, and leaves in `frame` those of the audio states that were asked
/// for, relative to the largest. Gives the best score.
fn emit<const TOKENS: usize>(
    audio: &MixtureTables,
    acoustic_scale: u32,
    scaled: &Scaled,
    scores: &mut Scores,
    frame: &mut Frame<TOKENS>,
) -> LogProb {
    // `NEVER`: not asked for yet.
    let mut logs = [LogProb::NEVER; MAX_AUDIO_STATES];
    let (mut best, mut best_log) = (LogProb::NEVER, LogProb::NEVER);
    scores.for_each(|state, score| {
        let state = state.audio();
        let Some(log) = logs.get_mut(state) else {
            return;
        };
        if log.is_never() {
            *log = log_likelihood(audio, state, scaled, acoustic_scale);
            best_log = best_log.max(*log);
        }
        *score = score.times(*log);
        best = best.max(*score);
    });
    for (to, log) in frame.emission.iter_mut().zip(&logs) {
        *to = log.over(best_log).to_score();
    }
    best
}
