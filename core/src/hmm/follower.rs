//! The forward pass: observations in, active joint states and their smoothed occupancies out (X&L section 3.4, with a
//! beam and a lag).
//!
//! Per frame: probability moves along the arcs (those that bring less than the beam's width below the best are left
//! out before any density is evaluated), the audio states that are reached are evaluated once each, the beam prunes.
//! Should the beam let no arc through at all, the best token stays where it is.
use super::beam::{Door, prune};
use super::density::{Scaled, log_likelihood};
use super::feedback::Seen;
use super::lag::{Frame, MAX_AUDIO_STATES, Window};
use super::token::{PhonesByViseme, Scores, Token, begin, begin_anywhere, forward};
use super::transition::N_PAIRS;
use crate::N_OBSERVATION;
use crate::logmath::{FRACTION_BITS, LogProb};
use crate::mge::rows::{self, Inputs};
use crate::model::field::{Matrix, N_VISUAL_STATES, limit};
use crate::model::{Model, Rows};

/// The state of one stream. `TOKENS` bounds the active joint states, `FRAMES` − 1 the lag.
#[derive(Clone, Debug)]
pub struct Follower<'m, const TOKENS: usize, const FRAMES: usize> {
    model: &'m Model<'m>,
    beam: LogProb,
    acoustic_scale: u32,
    /// Active joint states, and phones evaluated in a frame of a model with a memory, at most.
    most: usize,
    most_phones: usize,
    /// Frames in which a bound held something back.
    narrowed: u32,
    phones: PhonesByViseme,
    scores: Scores,
    window: Window<TOKENS, FRAMES>,
    count: u32,
}

impl<'m, const TOKENS: usize, const FRAMES: usize> Follower<'m, TOKENS, FRAMES> {
    /// `beam` as a width, held to 16384 bits; `acoustic_scale` in Q16.16, held to 4; bounds as in
    /// [`Follower::set_bounds`].
    #[inline(always)]
    pub fn new(
        model: &'m Model<'m>,
        beam: LogProb,
        acoustic_scale: u32,
        most: Option<u16>,
        phones: Option<u16>,
    ) -> Self {
        let (most, most_phones) = Self::bounds(model, most, phones);
        Self {
            model,
            beam: held_beam(beam),
            acoustic_scale: acoustic_scale.min(limit::ACOUSTIC_SCALE),
            most,
            most_phones,
            narrowed: 0,
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

    /// Other bounds on the active joint states, held to `TOKENS`, and on the phones evaluated in a frame; `None`: the kind
    /// of model's own.
    pub fn set_bounds(&mut self, most: Option<u16>, phones: Option<u16>) {
        (self.most, self.most_phones) = Self::bounds(self.model, most, phones);
    }

    fn bounds(model: &Model, most: Option<u16>, phones: Option<u16>) -> (usize, usize) {
        let most = most.map_or(Self::own_most(model), usize::from);
        (
            most.clamp(1, TOKENS),
            phones.map_or(MOST_PHONES, usize::from).max(1),
        )
    }

    fn own_most(model: &Model) -> usize {
        if model.is_recurrent() {
            MOST_SHARP.min(TOKENS)
        } else {
            TOKENS
        }
    }

    /// Forgets the stream.
    pub fn reset(&mut self) {
        self.scores.clear();
        self.window.reset();
        self.count = 0;
        self.narrowed = 0;
    }

    /// Frames since the beginning in which a bound narrowed the beam.
    pub fn narrowed(&self) -> u32 {
        self.narrowed
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

    /// One sweep of re-estimation of the mouth over the newest frame and the `lag` before it, see [`super::feedback`].
    pub fn sweep(&mut self, lag: usize, exponent: u32) {
        let (model, scores) = (self.model, &mut self.scores);
        self.window
            .sweep(model, &self.phones, self.beam, lag, exponent, scores);
    }

    /// What the last sweep has found `age` frames before the newest; `age` is held to the window.
    pub fn seen(&self, age: usize) -> Option<&Seen> {
        self.window.seen(age)
    }

    /// One observation of the front end, Q7.8.
    pub fn follow(&mut self, observation: &[i16; N_OBSERVATION]) {
        let scaled = Scaled::new(self.model, observation);
        self.predict(0);
        let Some(frame) = self.window.advance() else {
            return;
        };
        let best = emit(self.model, self.acoustic_scale, &scaled, &mut self.scores, frame);
        let cut = prune(&self.scores, best, self.beam, self.most, &mut frame.tokens);
        self.narrowed = self.narrowed.saturating_add(u32::from(cut));
        self.scores.clear();
        self.count = self.count.wrapping_add(1);
    }

    /// One frame of a model with a memory: log emissions U z + b of the audio states and F ŷ + f of the visual states,
    /// z and the last mouth in Q5.10.
    pub fn follow_inputs(&mut self, z: &[i16], mouth: &[i16]) {
        self.predict(MARGIN);
        let Some(frame) = self.window.advance() else {
            return;
        };
        let fewer = keep_likeliest(&mut self.scores, self.most_phones);
        let best = emit_inputs(self.model, z, mouth, &mut self.scores);
        let cut = prune(&self.scores, best, self.beam, self.most, &mut frame.tokens);
        self.narrowed = self.narrowed.saturating_add(u32::from(fewer || cut));
        self.scores.clear();
        self.count = self.count.wrapping_add(1);
    }

    /// Moves probability along the arcs: those that bring less than the beam's width and `margin` (bits) below the best
    /// are left out.
    fn predict(&mut self, margin: i32) {
        let model = self.model;
        let tokens = self.window.newest();
        if tokens.is_empty() && model.is_recurrent() {
            begin_anywhere(model, self.most_phones, &mut self.scores);
        } else if tokens.is_empty() {
            begin(model, &mut self.scores);
        } else {
            let floor = LogProb::from_q12(-self.beam.q12() - (margin << FRACTION_BITS));
            forward(model, &self.phones, tokens, floor, &mut self.scores);
        }
        if self.scores.states().next().is_none() {
            // The beam let no arc through: the best token stays where it is.
            if let Some(best) = tokens.iter().max_by_key(|t| t.score) {
                self.scores.put(best.state, LogProb::ONE);
            }
        }
    }
}

/// Active joint states of a model with a memory, and phones evaluated in one of its frames, at most: they bound the work of
/// the worst frame.
pub const MOST_SHARP: usize = 80;
const MOST_PHONES: usize = 32;
/// Joint states that are evaluated whatever their phones: as many as a first frame has of [`MOST_PHONES`].
const FEW_STATES: usize = MOST_PHONES * N_PAIRS;

/// Takes the joint states of all but the likeliest `most` phones out of `scores`; of equally likely ones the first stay.
/// Whether there were more.
fn keep_likeliest(scores: &mut Scores, most: usize) -> bool {
    // Most frames end here.
    if scores.count() <= FEW_STATES {
        return false;
    }
    let mut best = [LogProb::NEVER; limit::PHONES];
    scores.for_each(|state, score| {
        if let Some(best) = best.get_mut(state.phone()) {
            *best = (*best).max(*score);
        }
    });
    let reached = || best.iter().copied().filter(|b| !b.is_never());
    let Some(first) = reached().max().filter(|_| reached().count() > most) else {
        return false;
    };
    let mut door = Door::new(first, reached(), most);
    let keep = best.map(|best| !best.is_never() && door.lets_in(best));
    scores.for_each(|state, score| {
        if !keep.get(state.phone()).is_some_and(|keep| *keep) {
            *score = LogProb::NEVER;
        }
    });
    true
}

/// Bits below the beam that an arc may bring before the sound of a model with a memory has been heard: its emissions
/// are sharp, so that the best path may begin far behind.
const MARGIN: i32 = 1;

fn held_beam(beam: LogProb) -> LogProb {
    LogProb::from_q12(beam.q12().clamp(1, limit::BEAM))
}

/// Adds the log likelihood of `scaled` to every score, and leaves in `frame` those of the audio states that were asked
/// for, relative to the largest. Gives the best score.
fn emit<const TOKENS: usize>(
    model: &Model,
    acoustic_scale: u32,
    scaled: &Scaled,
    scores: &mut Scores,
    frame: &mut Frame<TOKENS>,
) -> LogProb {
    // `NEVER`: not asked for yet.
    let mut logs = [LogProb::NEVER; MAX_AUDIO_STATES];
    let (mut best, mut best_log) = (LogProb::NEVER, LogProb::NEVER);
    scores.for_each(|state, score| {
        let audio = state.audio();
        let Some(log) = logs.get_mut(audio) else {
            return;
        };
        if log.is_never() {
            *log = log_likelihood(model, audio, scaled, acoustic_scale);
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

/// Adds the log emissions of a model with a memory to every score. Gives the best score.
fn emit_inputs(model: &Model, z: &[i16], mouth: &[i16], scores: &mut Scores) -> LogProb {
    let audio_rows = model.rows(Matrix::AUDIO, z.len());
    let visual_rows = model.rows(Matrix::VISUAL, mouth.len());
    let (z, mouth) = (Inputs::new(z), Inputs::new(mouth));
    // `NEVER`: not asked for yet.
    let mut audio_logs = [LogProb::NEVER; MAX_AUDIO_STATES];
    let mut visual_logs = [LogProb::NEVER; N_VISUAL_STATES];
    let mut best = LogProb::NEVER;
    let evaluate = |log: &mut LogProb, rows: &Rows, state: usize, inputs: &Inputs| {
        if log.is_never() {
            let value = rows::row(rows, state, inputs);
            *log = LogProb::from_q12(value.clamp(-EMISSION_LIMIT, EMISSION_LIMIT));
        }
        *log
    };
    scores.for_each(|state, score| {
        if score.is_never() {
            return;
        }
        let audio = state.audio();
        let visual = state.visual(model.viseme(state.phone()));
        let (Some(heard), Some(seen)) = (audio_logs.get_mut(audio), visual_logs.get_mut(visual)) else {
            return;
        };
        let heard = evaluate(heard, &audio_rows, audio, &z);
        let seen = evaluate(seen, &visual_rows, visual, &mouth);
        *score = score.times(heard).times(seen);
        best = best.max(*score);
    });
    best
}

/// Log emissions are held to ±2¹³ bits.
const EMISSION_LIMIT: i32 = 1 << 25;
