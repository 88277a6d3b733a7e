//! The beam: which joint states stay active.
//!
//! A joint state stays if its score is within the beam of the frame's best. If more than the buffer holds would
//! stay, the best of them do: scores are counted in bins of 1/8 bit, whole bins are kept from the best down, and in
//! the last bin the lower joint states win. The best token always stays, so the beam never empties.
use super::token::{Scores, Token};
use super::transition::JointState;
use crate::logmath::{FRACTION_BITS, LogProb};

/// Bins of the count: 32 bits below the best, the last one takes everything below.
const N_BINS: usize = 256;
/// A bin is 2⁹ LSBs of a [`LogProb`], 1/8 bit.
const BIN_BITS: u32 = FRACTION_BITS - 3;

#[inline]
fn bin(best: LogProb, score: LogProb) -> usize {
    ((best.q12().saturating_sub(score.q12()) >> BIN_BITS) as usize).min(N_BINS - 1)
}

/// The joint states of `scores` within `width` of the `best` of them, at most `most` (and `N`) of them, as tokens relative to the
/// best. Whether there were more.
pub fn prune<const N: usize>(
    scores: &Scores,
    best: LogProb,
    width: LogProb,
    most: usize,
    tokens: &mut heapless::Vec<Token, N>,
) -> bool {
    let most = most.clamp(1, N);
    tokens.clear();
    if best.is_never() {
        return false;
    }
    let floor = LogProb::from_q12(best.q12().saturating_sub(width.q12())).max(LogProb::FLOOR);
    let mut bins = Bins::new(best);
    let mut within = 0;
    scores.visit(|state, score| {
        if score >= floor {
            within += 1;
            bins.add(score);
            // What does not fit shows in the count.
            let _ = tokens.push(relative(state, best, score));
        }
    });
    if within <= most {
        return false;
    }
    tokens.clear();
    let mut door = bins.door(most);
    scores.visit(|state, score| {
        if score >= floor && door.lets_in(score) {
            // There is room: at most `most` are let in.
            let _ = tokens.push(relative(state, best, score));
        }
    });
    true
}

/// How many scores lie how far below the best.
struct Bins {
    best: LogProb,
    counts: [u16; N_BINS],
}

impl Bins {
    fn new(best: LogProb) -> Self {
        Self {
            best,
            counts: [0; N_BINS],
        }
    }

    #[inline]
    fn add(&mut self, score: LogProb) {
        if let Some(count) = self.counts.get_mut(bin(self.best, score)) {
            *count += 1;
        }
    }

    /// The door for at most `most` of these scores.
    fn door(&self, most: usize) -> Door {
        let best = self.best;
        let mut room = most;
        for (last_bin, count) in self.counts.iter().enumerate() {
            let count = usize::from(*count);
            if count > room {
                return Door { best, last_bin, room };
            }
            room -= count;
        }
        // Everything fits.
        Door {
            best,
            last_bin: N_BINS,
            room: 0,
        }
    }
}

/// Lets the best of a number of scores in, whole bins from the best down, of the last bin those that come first.
pub(crate) struct Door {
    best: LogProb,
    last_bin: usize,
    /// Scores of the last bin that still fit.
    room: usize,
}

impl Door {
    /// At most `most` of `scores`, of which `best` is the best.
    pub(crate) fn new(best: LogProb, scores: impl Iterator<Item = LogProb>, most: usize) -> Self {
        let mut bins = Bins::new(best);
        scores.for_each(|score| bins.add(score));
        bins.door(most)
    }

    pub(crate) fn lets_in(&mut self, score: LogProb) -> bool {
        let bin = bin(self.best, score);
        if bin == self.last_bin && self.room > 0 {
            self.room -= 1;
            return true;
        }
        bin < self.last_bin
    }
}

#[inline]
fn relative(state: JointState, best: LogProb, score: LogProb) -> Token {
    Token {
        state,
        score: LogProb::from_q12(score.q12().saturating_sub(best.q12())).to_score(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Prunes by the best of `scores`.
    fn prune<const N: usize>(
        scores: &Scores,
        width: LogProb,
        most: usize,
        tokens: &mut heapless::Vec<Token, N>,
    ) -> bool {
        let best = scores
            .states()
            .map(|s| scores.get(s))
            .max()
            .unwrap_or(LogProb::NEVER);
        super::prune(scores, best, width, most, tokens)
    }

    fn scores(values: impl IntoIterator<Item = (usize, i32)>) -> Scores {
        let mut scores = Scores::new();
        for (state, value) in values {
            scores.put(JointState(state as u16), LogProb::from_q12(value));
        }
        scores
    }

    #[test]
    fn keeps_what_is_within_the_beam() {
        let scores = scores([(3, -5 << 12), (700, -1 << 12), (701, -9 << 12), (1871, -2 << 12)]);
        let mut tokens = heapless::Vec::<Token, 8>::new();
        prune(&scores, LogProb::from_q12(4 << 12), 8, &mut tokens);
        let kept: heapless::Vec<_, 8> = tokens.iter().map(|t| (t.state.0, t.score)).collect();
        assert_eq!(kept[..], [(3, -4 * 256), (700, 0), (1871, -256)]);
    }

    #[test]
    fn keeps_the_best_when_there_is_no_room() {
        // Scores 0, −1, … −99 sixteenths of a bit in a scrambled order of states.
        let scores = scores((0..100).map(|i| (17 * i % 1009, -(i as i32) << 8)));
        let mut tokens = heapless::Vec::<Token, 32>::new();
        prune(&scores, LogProb::from_q12(1 << 26), 20, &mut tokens);
        assert_eq!(tokens.len(), 20);
        assert!(tokens.iter().all(|t| t.score > -20 * 16), "{tokens:?}");
        assert!(tokens.windows(2).all(|w| w[0].state < w[1].state));
    }

    #[test]
    fn equal_scores_fill_the_room_exactly() {
        let scores = scores((0..50).map(|i| (i, -7)));
        let mut tokens = heapless::Vec::<Token, 20>::new();
        prune(&scores, LogProb::from_q12(4096), 20, &mut tokens);
        assert_eq!(tokens.len(), 20);
    }

    #[test]
    fn the_best_always_stays() {
        let scores = scores([(5, -(1 << 25)), (6, -(1 << 26))]);
        let mut tokens = heapless::Vec::<Token, 4>::new();
        prune(&scores, LogProb::from_q12(1), 4, &mut tokens);
        assert_eq!(tokens.len(), 1);
        assert_eq!(tokens[0].score, 0);
    }
}
