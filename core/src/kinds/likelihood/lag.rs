//! Fixed-lag smoothing: the last frames' tokens, and the occupancies of a frame given what came up to L frames later.
//!
//! γ_t(s) ∝ α_t(s)·β_t(s), with β_n = 1 at the newest frame n and β_t(s) = Σ P(s→s')·b_{t+1}(s')·β_{t+1}(s')
//! below it: the exact backward pass over the window (Xie & Liu 2007 (X&L), section 3.4, has it over the utterance). A token whose γ falls
//! out of the beam on the way is dropped for good, so that the window thins out with age.
use super::Likelihood;
use super::feedback::Seen;
use crate::hmm::gates::share;
use crate::hmm::token::{PhonesByViseme, Scores, Token, backward, begin, forward};
use crate::hmm::transition::{JointState, MAX_AUDIO_STATES, N_VISUAL_STATES};
use crate::logmath::{LogProb, NEVER_I16};

/// What the window keeps of one frame.
#[derive(Clone, Debug)]
pub struct Frame<const TOKENS: usize> {
    /// Its active joint states.
    pub tokens: heapless::Vec<Token, TOKENS>,
    /// Log likelihood of the sound in each audio state, as the forward pass has used it: log2 relative to the likeliest state, Q7.8;
    /// [`NEVER_I16`] for states that were not asked for. The backward pass needs it again.
    pub emission: [i16; MAX_AUDIO_STATES],
    /// The mouth of this frame as re-estimation has left it; unused where the maps speak.
    pub seen: Seen,
}

impl<const TOKENS: usize> Frame<TOKENS> {
    const EMPTY: Self = Self {
        tokens: heapless::Vec::new(),
        emission: [NEVER_I16; MAX_AUDIO_STATES],
        seen: Seen::NONE,
    };

    /// What the sound says of a joint state.
    #[inline]
    fn heard(&self, _: &Likelihood, state: JointState) -> LogProb {
        LogProb::from_score(self.emission.get(state.audio()).copied().unwrap_or(NEVER_I16))
    }

    /// What sound and mouth say of it.
    #[inline]
    fn heard_and_seen(&self, model: &Likelihood, state: JointState) -> LogProb {
        let visual = state.visual(model.hmm().viseme(state.phone()));
        self.heard(model, state).times(self.seen.emission(visual))
    }
}

/// What a frame says of a joint state.
type Emission<const TOKENS: usize> = fn(&Frame<TOKENS>, &Likelihood, JointState) -> LogProb;

/// The last frames, `FRAMES` at most: a lag of `FRAMES` − 1 at most.
#[derive(Clone, Debug)]
pub struct Window<const TOKENS: usize, const FRAMES: usize> {
    frames: [Frame<TOKENS>; FRAMES],
    newest: usize,
    length: usize,
    /// β of the tokens of the frame that the backward pass has come to.
    worth: [LogProb; TOKENS],
}

impl<const TOKENS: usize, const FRAMES: usize> Window<TOKENS, FRAMES> {
    /// Without frames.
    #[inline(always)]
    pub const fn new() -> Self {
        Self {
            frames: [const { Frame::EMPTY }; FRAMES],
            newest: 0,
            length: 0,
            worth: [LogProb::NEVER; TOKENS],
        }
    }

    /// Forgets all frames.
    pub fn reset(&mut self) {
        self.length = 0;
        self.newest = 0;
    }

    /// Frames that are held.
    pub fn len(&self) -> usize {
        self.length
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.length == 0
    }

    /// Tokens of the newest frame; none before the first.
    pub fn newest(&self) -> &[Token] {
        match self.frames.get(self.newest) {
            Some(frame) if self.length > 0 => &frame.tokens,
            _ => &[],
        }
    }

    /// The place for the next frame, which takes that of the oldest when the window is full.
    pub fn advance(&mut self) -> Option<&mut Frame<TOKENS>> {
        if self.length > 0 {
            self.newest = if self.newest + 1 == FRAMES {
                0
            } else {
                self.newest + 1
            };
        }
        self.length = (self.length + 1).min(FRAMES);
        self.frames.get_mut(self.newest)
    }

    /// Occupancies of the visual states 5·viseme + j, `age` frames before the newest, Q0.16; their sum is 1 within
    /// 65 LSB. `scores` must be clear and is clear again afterwards.
    pub fn occupancies(
        &mut self,
        model: &Likelihood,
        phones: &PhonesByViseme,
        beam: LogProb,
        age: usize,
        scores: &mut Scores,
    ) -> [u32; N_VISUAL_STATES] {
        let mut occupancy = [0; N_VISUAL_STATES];
        let age = age.min(self.length.saturating_sub(1));
        if self.length == 0 {
            return occupancy;
        }
        self.worth.fill(LogProb::ONE);
        for age in 1..=age {
            self.back(model, phones, beam, age, Frame::heard, scores);
        }
        if let Some(frame) = self.frames.get(self.place(age)) {
            add_up(model, frame, &self.worth, &mut occupancy);
        }
        occupancy
    }

    /// Where the frame `age` before the newest is.
    #[inline]
    fn place(&self, age: usize) -> usize {
        (self.newest + FRAMES - age.min(FRAMES)) % FRAMES
    }

    /// β of the tokens `age` frames before the newest, from that of the frame after them.
    #[inline(always)]
    fn back(
        &mut self,
        model: &Likelihood,
        phones: &PhonesByViseme,
        beam: LogProb,
        age: usize,
        emission: Emission<TOKENS>,
        scores: &mut Scores,
    ) {
        let (later, earlier) = (self.place(age - 1), self.place(age));
        let (Some(after), worth) = (self.frames.get(later), &mut self.worth) else {
            return;
        };
        for (token, worth) in after.tokens.iter().zip(worth.iter()) {
            scores.put(token.state, worth.times(emission(after, model, token.state)));
        }
        if let Some(frame) = self.frames.get_mut(earlier) {
            let mut best = LogProb::NEVER;
            backward(model.hmm(), phones, &frame.tokens, scores, |i, beta| {
                if let (Some(to), Some(token)) = (worth.get_mut(i), frame.tokens.get(i)) {
                    *to = beta;
                    best = best.max(beta.times(LogProb::from_score(token.score)));
                }
            });
            thin(frame, worth, best, beam);
        }
        scores.clear();
    }

    /// One sweep of re-estimation (see [`super::feedback`]) over the newest frame and the `lag` before it, the visual
    /// likelihood to the power of `exponent` (Q16.16). `scores` must be clear and is clear again afterwards.
    pub fn sweep(
        &mut self,
        model: &Likelihood,
        phones: &PhonesByViseme,
        beam: LogProb,
        lag: usize,
        exponent: u32,
        scores: &mut Scores,
    ) {
        let Some(last) = self.length.checked_sub(1) else {
            return;
        };
        let oldest = lag.min(last);
        self.worth.fill(LogProb::ONE);
        let mut occupancy = [0; N_VISUAL_STATES];
        if let Some(frame) = self.frames.get_mut(self.newest) {
            add_up(model, frame, &self.worth, &mut occupancy);
            frame.seen.begin(model, &occupancy);
        }
        let floor = LogProb::from_q12(-beam.q12());
        for age in (0..=oldest).rev() {
            match self.frames.get(self.place(age + 1)) {
                Some(before) if age < last => forward(model.hmm(), phones, &before.tokens, floor, scores),
                _ => begin(model.hmm(), scores),
            }
            let place = self.place(age);
            if let Some(frame) = self.frames.get_mut(place) {
                frame.seen.see(model, exponent, &frame.tokens);
                weigh(model, frame, &mut self.worth, scores, beam);
            }
            scores.clear();
        }
        self.worth.fill(LogProb::ONE);
        for age in 0..=oldest {
            if age > 0 {
                self.back(model, phones, beam, age, Frame::heard_and_seen, scores);
            }
            let place = self.place(age);
            if let Some(frame) = self.frames.get_mut(place) {
                occupancy.fill(0);
                add_up(model, frame, &self.worth, &mut occupancy);
                frame.seen.maximise(model, &occupancy);
            }
        }
    }

    /// What the last sweep has found `age` frames before the newest; `age` is held to the window.
    pub fn seen(&self, age: usize) -> Option<&Seen> {
        self.frames
            .get(self.place(age.min(self.length.saturating_sub(1))))
            .map(|frame| &frame.seen)
    }
}

/// α of the frame's tokens anew: what arrives in them (`scores`) times what sound and mouth say. Those that fall out of the beam
/// are dropped; if nothing arrives at all, the frame stays as it was.
fn weigh<const TOKENS: usize>(
    model: &Likelihood,
    frame: &mut Frame<TOKENS>,
    room: &mut [LogProb; TOKENS],
    scores: &Scores,
    beam: LogProb,
) {
    let mut best = LogProb::NEVER;
    for (to, token) in room.iter_mut().zip(&frame.tokens) {
        *to = match scores.get(token.state) {
            never if never.is_never() => never,
            arrives => arrives.times(frame.heard_and_seen(model, token.state)),
        };
        best = best.max(*to);
    }
    if best.is_never() {
        return;
    }
    let mut values = room.iter();
    frame.tokens.retain_mut(|token| {
        let value = values.next().map_or(LogProb::NEVER, |v| v.over(best));
        token.score = value.to_score();
        !value.is_never() && value.q12() >= -beam.q12()
    });
}

impl<const TOKENS: usize, const FRAMES: usize> Default for Window<TOKENS, FRAMES> {
    fn default() -> Self {
        Self::new()
    }
}

/// Makes `best` the zero of β and drops the tokens that fall out of the beam. If the tokens lead nowhere at all (a
/// beam that emptied), all of them stay, as if nothing were known of the future.
fn thin<const TOKENS: usize>(
    frame: &mut Frame<TOKENS>,
    worth: &mut [LogProb; TOKENS],
    best: LogProb,
    beam: LogProb,
) {
    if best.is_never() {
        worth.fill(LogProb::ONE);
        return;
    }
    let mut kept = 0;
    for i in 0..frame.tokens.len() {
        let (Some(&token), Some(&beta)) = (frame.tokens.get(i), worth.get(i)) else {
            break;
        };
        let beta = LogProb::from_q12(beta.q12().saturating_sub(best.q12()));
        let gamma = beta.times(LogProb::from_score(token.score));
        if gamma.is_never() || gamma.q12() < -beam.q12() {
            continue;
        }
        if let (Some(to), Some(value)) = (frame.tokens.get_mut(kept), worth.get_mut(kept)) {
            *to = token;
            *value = beta;
            kept += 1;
        }
    }
    frame.tokens.truncate(kept);
}

/// Σ αβ by visual state, divided by the whole.
fn add_up<const TOKENS: usize>(
    model: &Likelihood,
    frame: &Frame<TOKENS>,
    worth: &[LogProb; TOKENS],
    occupancy: &mut [u32; N_VISUAL_STATES],
) {
    // β is relative to the best αβ: no term exceeds 1 by more than the rounding of a sum.
    let mut total: u32 = 0;
    for (token, beta) in frame.tokens.iter().zip(worth) {
        let weight = LogProb::from_score(token.score).times(*beta).exp2();
        let visual = token.state.visual(model.hmm().viseme(token.state.phone()));
        // At most 1872 terms of 2¹⁶: below 2²⁷.
        total += weight;
        if let Some(sum) = occupancy.get_mut(visual) {
            *sum += weight;
        }
    }
    share(occupancy, total);
}
