//! The forward pass over joint states under a beam: what all kinds that follow a coupled HMM share (X&L = Xie & Liu 2007, *A
//! coupled HMM approach to video-realistic speech animation*, section 3.4, live).
//!
//! Per frame probability moves along the arcs ([`Search::predict`]; arcs that bring less than the beam's width below the best are
//! left out before anything is evaluated), the kind adds what its emissions say of the states that are reached, and the beam
//! prunes ([`Search::prune`]). Should the beam let no arc through at all, the best token stays where it is.
use super::beam::prune;
use super::tables::HmmTables;
use super::token::{PhonesByViseme, Scores, Token, forward};
use crate::logmath::{FRACTION_BITS, LogProb};

/// Widest beam, LSBs of 2⁻¹²: 16384 bits, no beam at all.
pub const MAX_BEAM: i32 = 1 << 26;

/// The part of a stream's state that moves probability from one frame's tokens to the next frame's.
#[derive(Clone, Debug)]
pub struct Search {
    beam: LogProb,
    /// Active joint states, at most.
    most: usize,
    /// Frames in which a bound held something back.
    narrowed: u32,
    /// Frames followed.
    count: u32,
    pub(crate) phones: PhonesByViseme,
    pub(crate) scores: Scores,
}

impl Search {
    /// `beam` as a width, held to 16384 bits; `most` active joint states.
    #[inline(always)]
    pub fn new(hmm: &HmmTables, beam: LogProb, most: usize) -> Self {
        Self {
            beam: held(beam),
            most: most.max(1),
            narrowed: 0,
            count: 0,
            phones: PhonesByViseme::new(hmm),
            scores: Scores::new(),
        }
    }

    /// Another beam and bound; starts a new stream.
    pub fn set(&mut self, beam: LogProb, most: usize) {
        self.beam = held(beam);
        self.most = most.max(1);
        self.reset();
    }

    /// Forgets the stream.
    pub fn reset(&mut self) {
        self.scores.clear();
        self.narrowed = 0;
        self.count = 0;
    }

    /// Width of the beam in force.
    #[inline]
    pub fn beam(&self) -> LogProb {
        self.beam
    }

    /// Frames since the beginning in which a bound narrowed the beam.
    pub fn narrowed(&self) -> u32 {
        self.narrowed
    }

    /// Frames followed so far, modulo 2³².
    pub fn count(&self) -> u32 {
        self.count
    }

    /// Moves probability from `tokens` along the arcs into the scores, which must be clear. Arcs that bring less than the beam's
    /// width and `margin` (bits) below the best are left out. Without tokens the stream begins as `begin` says.
    #[inline]
    pub fn predict(
        &mut self,
        hmm: &HmmTables,
        tokens: &[Token],
        margin: i32,
        begin: impl FnOnce(&mut Scores),
    ) {
        if tokens.is_empty() {
            begin(&mut self.scores);
        } else {
            let floor = LogProb::from_q12(-self.beam.q12() - (margin << FRACTION_BITS));
            forward(hmm, &self.phones, tokens, floor, &mut self.scores);
        }
        if self.scores.states().next().is_none() {
            // The beam let no arc through: the best token stays where it is.
            if let Some(best) = tokens.iter().max_by_key(|t| t.score) {
                self.scores.put(best.state, LogProb::ONE);
            }
        }
    }

    /// Leaves in `tokens` the joint states of the scores that the beam keeps, `best` being the best score, and clears the scores.
    /// `held_back`: whether a bound of the kind's own has held something back in this frame.
    pub fn prune<const N: usize>(
        &mut self,
        best: LogProb,
        held_back: bool,
        tokens: &mut heapless::Vec<Token, N>,
    ) {
        let cut = prune(&self.scores, best, self.beam, self.most, tokens);
        self.narrowed = self.narrowed.saturating_add(u32::from(held_back || cut));
        self.scores.clear();
        self.count = self.count.wrapping_add(1);
    }
}

fn held(beam: LogProb) -> LogProb {
    LogProb::from_q12(beam.q12().clamp(1, MAX_BEAM))
}
