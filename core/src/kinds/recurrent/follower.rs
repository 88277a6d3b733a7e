//! Following the sound: the context's numbers and the last mouth in, active joint states out.
//!
//! Log emissions are U z + b of the audio states and F ŷ + f of the visual states; each state that the forward pass reaches
//! ([`crate::hmm::search`]) is evaluated once.
use super::rows::{self, Inputs};
use super::tables::Rows;
use super::{Recurrent, TOKENS};
use crate::hmm::beam::Door;
use crate::hmm::search::Search;
use crate::hmm::tables::HmmTables;
use crate::hmm::token::{Scores, Token};
use crate::hmm::transition::{JointState, MAX_AUDIO_STATES, MAX_PHONES, N_PAIRS, N_VISUAL_STATES};
use crate::logmath::LogProb;

/// The state of one stream. `ROOM` bounds the active joint states.
#[derive(Clone, Debug)]
pub struct Follower<'m, const ROOM: usize> {
    model: &'m Recurrent<'m>,
    /// Phones evaluated in a frame, at most.
    most_phones: usize,
    search: Search,
    /// The active joint states of the newest frame.
    tokens: heapless::Vec<Token, ROOM>,
}

impl<'m, const ROOM: usize> Follower<'m, ROOM> {
    /// `beam` as a width, held to 16384 bits; `most` active joint states, held to `ROOM`, 80 where it is `None`; `phones` evaluated in
    /// a frame at most, 32 where it is `None`.
    #[inline(always)]
    pub fn new(model: &'m Recurrent<'m>, beam: LogProb, most: Option<u16>, phones: Option<u16>) -> Self {
        Self {
            model,
            most_phones: Self::held_phones(phones),
            search: Search::new(model.hmm(), beam, Self::held(most)),
            tokens: heapless::Vec::new(),
        }
    }

    /// Another beam and other bounds; starts a new stream.
    pub fn set(&mut self, beam: LogProb, most: Option<u16>, phones: Option<u16>) {
        self.most_phones = Self::held_phones(phones);
        self.search.set(beam, Self::held(most));
        self.tokens.clear();
    }

    fn held(most: Option<u16>) -> usize {
        most.map_or(TOKENS, usize::from).clamp(1, ROOM)
    }

    fn held_phones(phones: Option<u16>) -> usize {
        phones.map_or(MOST_PHONES, usize::from).max(1)
    }

    /// Forgets the stream.
    pub fn reset(&mut self) {
        self.search.reset();
        self.tokens.clear();
    }

    /// Frames since the beginning in which a bound narrowed the beam.
    pub fn narrowed(&self) -> u32 {
        self.search.narrowed()
    }

    /// Active joint states of the newest frame.
    pub fn active(&self) -> &[Token] {
        &self.tokens
    }

    /// One frame: z and the last mouth, both Q5.10, as many numbers of each as the model reads.
    pub fn follow(&mut self, z: &[i16], mouth: &[i16]) {
        let hmm = self.model.hmm();
        let most_phones = self.most_phones;
        self.search.predict(hmm, &self.tokens, MARGIN, |scores| {
            begin_anywhere(hmm, most_phones, scores);
        });
        let fewer = keep_likeliest(&mut self.search.scores, most_phones);
        let best = emit(self.model, z, mouth, &mut self.search.scores);
        self.search.prune(best, fewer, &mut self.tokens);
    }
}

/// Phones evaluated in one frame, at most: with [`TOKENS`] it bounds the work of the worst frame.
const MOST_PHONES: usize = 32;
/// Joint states that are evaluated whatever their phones: as many as a first frame has of [`MOST_PHONES`].
const FEW_STATES: usize = MOST_PHONES * N_PAIRS;
/// Bits below the beam that an arc may bring before the sound has been heard: the emissions are sharp, so that the best path may
/// begin far behind.
const MARGIN: i32 = 1;
/// Log emissions are held to ±2¹³ bits.
const EMISSION_LIMIT: i32 = 1 << 25;
/// log2 13: an utterance may begin in any pair of a phone.
const PAIRS_LOG: LogProb = LogProb::from_q12(15_157);

/// Adds to `scores` what each joint state begins with: the model was trained on pieces of speech, and begins anywhere inside a
/// phone, of the likeliest `most`.
fn begin_anywhere(hmm: &HmmTables, most: usize, scores: &mut Scores) {
    let initial = || hmm.initial().iter().map(LogProb::from_table);
    let Some(best) = initial().max() else {
        return;
    };
    let mut door = Door::new(best, initial(), most);
    for (phone, initial) in initial().enumerate() {
        let stays = door.lets_in(initial);
        let initial = initial.over(PAIRS_LOG);
        if stays && !initial.is_never() {
            for pair in 0..N_PAIRS {
                scores.add(JointState::new(phone, pair), initial);
            }
        }
    }
}

/// Takes the joint states of all but the likeliest `most` phones out of `scores`; of equally likely ones the first stay.
/// Whether there were more.
fn keep_likeliest(scores: &mut Scores, most: usize) -> bool {
    // Most frames end here.
    if scores.count() <= FEW_STATES {
        return false;
    }
    let mut best = [LogProb::NEVER; MAX_PHONES];
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

/// Adds the log emissions to every score. Gives the best score.
fn emit(model: &Recurrent, z: &[i16], mouth: &[i16], scores: &mut Scores) -> LogProb {
    let (hmm, audio_rows, visual_rows) = (model.hmm(), model.audio(), model.visual());
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
        let visual = state.visual(hmm.viseme(state.phone()));
        let (Some(heard), Some(seen)) = (audio_logs.get_mut(audio), visual_logs.get_mut(visual)) else {
            return;
        };
        let heard = evaluate(heard, audio_rows, audio, &z);
        let seen = evaluate(seen, visual_rows, visual, &mouth);
        *score = score.times(heard).times(seen);
        best = best.max(*score);
    });
    best
}
