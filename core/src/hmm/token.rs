//! Tokens on joint states, and the two sums over [`transition`](super::transition)'s arcs: forward (what
//! probability arrives in each joint state) and backward (what each joint state's future is worth).
//!
//! Tokens stand in increasing order of their joint state, so those of one phone are side by side; what leaves a
//! phone is added up first and spread over the bigram once.
use super::tables::HmmTables;
use super::transition::{
    AUDIO, BOTH, JointState, MAX_JOINT_STATES, MAX_PHONES, MOUTH_LEADS, MOUTH_SLOT, N_CHOICES, N_EMITTING,
    N_PAIRS, PHONE_STATES, SOUND_LEADS, SOUND_SLOT, STAY, VISUAL, pair,
};
use crate::frame::N_VISEMES;
use crate::logmath::LogProb;

/// One active joint state and its forward score relative to the frame's best: log2, Q7.8.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Token {
    /// The joint state.
    pub state: JointState,
    /// Its score.
    pub score: i16,
}

/// A log probability per joint state, and which of them are set.
#[derive(Clone, Debug)]
pub struct Scores {
    /// [`LogProb::NEVER`] where nothing has arrived.
    value: [LogProb; MAX_JOINT_STATES],
    /// One bit per joint state that has been added to since the last [`Scores::clear`].
    set: [u32; MAX_JOINT_STATES.div_ceil(32)],
}

impl Scores {
    /// Nothing has arrived anywhere.
    #[inline(always)]
    pub const fn new() -> Self {
        Self {
            value: [LogProb::NEVER; MAX_JOINT_STATES],
            set: [0; MAX_JOINT_STATES.div_ceil(32)],
        }
    }

    /// The value of a joint state; [`LogProb::NEVER`] where nothing has arrived.
    #[inline]
    pub fn get(&self, state: JointState) -> LogProb {
        self.value.get(state.index()).copied().unwrap_or(LogProb::NEVER)
    }

    /// Overwrites one value.
    #[inline]
    pub fn put(&mut self, state: JointState, value: LogProb) {
        let index = state.index();
        if let (Some(to), Some(word)) = (self.value.get_mut(index), self.set.get_mut(index / 32)) {
            *to = value;
            *word |= 1 << (index % 32);
        }
    }

    /// Adds to one value, in probability.
    #[inline]
    pub fn add(&mut self, state: JointState, value: LogProb) {
        let index = state.index();
        let Some(to) = self.value.get_mut(index) else {
            return;
        };
        if to.is_never() {
            *to = value;
            if let Some(word) = self.set.get_mut(index / 32) {
                *word |= 1 << (index % 32);
            }
        } else {
            *to = to.plus(value);
        }
    }

    /// Number of joint states that are set.
    #[inline]
    pub fn count(&self) -> usize {
        self.set.iter().map(|word| word.count_ones() as usize).sum()
    }

    /// Joint states that are set, in increasing order.
    #[inline]
    pub fn states(&self) -> impl Iterator<Item = JointState> + '_ {
        self.set.iter().enumerate().flat_map(|(i, &word)| {
            let mut left = word;
            core::iter::from_fn(move || {
                if left == 0 {
                    return None;
                }
                let bit = left.trailing_zeros();
                left &= left - 1;
                Some(JointState((32 * i) as u16 + bit as u16))
            })
        })
    }

    /// Calls `f` with every joint state that is set, in increasing order, and its value.
    #[inline]
    pub fn visit(&self, mut f: impl FnMut(JointState, LogProb)) {
        for (i, &word) in self.set.iter().enumerate() {
            let mut left = word;
            while left != 0 {
                let index = 32 * i + left.trailing_zeros() as usize;
                left &= left - 1;
                if let Some(value) = self.value.get(index) {
                    f(JointState(index as u16), *value);
                }
            }
        }
    }

    /// Calls `f` with every joint state that is set, in increasing order, and its value to change.
    #[inline]
    pub fn for_each(&mut self, mut f: impl FnMut(JointState, &mut LogProb)) {
        for (i, &word) in self.set.iter().enumerate() {
            let mut left = word;
            while left != 0 {
                let index = 32 * i + left.trailing_zeros() as usize;
                left &= left - 1;
                if let Some(value) = self.value.get_mut(index) {
                    f(JointState(index as u16), value);
                }
            }
        }
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        for (i, word) in self.set.iter_mut().enumerate() {
            while *word != 0 {
                let bit = word.trailing_zeros() as usize;
                *word &= *word - 1;
                if let Some(value) = self.value.get_mut(32 * i + bit) {
                    *value = LogProb::NEVER;
                }
            }
        }
    }
}

impl Default for Scores {
    fn default() -> Self {
        Self::new()
    }
}

/// The phones of each viseme.
#[derive(Clone, Debug)]
pub struct PhonesByViseme {
    phones: [u8; MAX_PHONES],
    /// `phones[first[m]..first[m + 1]]` look like viseme m.
    first: [u8; N_VISEMES + 1],
}

impl PhonesByViseme {
    /// Of the model's phones.
    pub fn new(hmm: &HmmTables) -> Self {
        let mut out = Self {
            phones: [0; MAX_PHONES],
            first: [0; N_VISEMES + 1],
        };
        let mut n = 0;
        for viseme in 0..N_VISEMES {
            for phone in (0..hmm.n_phones()).filter(|p| hmm.viseme(*p) == viseme) {
                if let Some(to) = out.phones.get_mut(n) {
                    *to = phone as u8;
                    n += 1;
                }
            }
            out.first[viseme + 1] = n as u8;
        }
        out
    }

    #[inline]
    fn of(&self, viseme: usize) -> &[u8] {
        let from = self.first.get(viseme).map_or(0, |n| usize::from(*n));
        let to = self.first.get(viseme + 1).map_or(0, |n| usize::from(*n));
        self.phones.get(from..to).unwrap_or(&[])
    }
}

/// Where a choice leads from a pair inside a phone: a pair of the same phone, or one of these.
const NOWHERE: u8 = 255;
/// (p', 1) × (m, 5) by the bigram.
const TO_SOUND_LEADS: u8 = 254;
/// (p, 5) × (m', 1) by the viseme sum.
const TO_MOUTH_LEADS: u8 = 253;
/// (p', 1) × (vis(p'), 1) by the bigram.
const TO_NEXT: u8 = 252;

/// By pair and choice.
static INSIDE: [[u8; N_CHOICES]; N_PAIRS] = inside();

const fn inside() -> [[u8; N_CHOICES]; N_PAIRS] {
    let mut table = [[NOWHERE; N_CHOICES]; N_PAIRS];
    let mut audio = 0;
    while audio < N_EMITTING {
        let mut visual = audio.saturating_sub(1);
        while visual <= audio + 1 && visual < N_EMITTING {
            let from = pair(audio, visual);
            let mut choice = 0;
            while choice < N_CHOICES {
                let a = audio + (choice == AUDIO || choice == BOTH) as usize;
                let v = visual + (choice == VISUAL || choice == BOTH) as usize;
                table[from][choice] = if a.abs_diff(v) > 1 {
                    NOWHERE
                } else if a == N_EMITTING && v == N_EMITTING {
                    TO_NEXT
                } else if a == N_EMITTING {
                    TO_SOUND_LEADS
                } else if v == N_EMITTING {
                    TO_MOUTH_LEADS
                } else {
                    pair(a, v) as u8
                };
                choice += 1;
            }
            visual += 1;
        }
        audio += 1;
    }
    table
}

/// Adds to `scores` what each joint state begins with.
pub fn begin(hmm: &HmmTables, scores: &mut Scores) {
    for (phone, initial) in hmm.initial().iter().enumerate() {
        let initial = LogProb::from_table(initial);
        if !initial.is_never() {
            scores.add(JointState::new(phone, 0), initial);
        }
    }
}

/// Adds to `scores` what arrives in each joint state from `tokens`. An arc that brings less than `floor` is left out.
pub fn forward(
    hmm: &HmmTables,
    phones: &PhonesByViseme,
    tokens: &[Token],
    floor: LogProb,
    scores: &mut Scores,
) {
    let mut rest = tokens;
    while let Some(first) = rest.first() {
        let phone = first.state.phone();
        let base = phone * PHONE_STATES;
        // What leaves the phone with the audio chain, the visual chain, both.
        let mut sound = LogProb::NEVER;
        let mut mouth = LogProb::NEVER;
        let mut both = LogProb::NEVER;
        while let Some((token, after)) = rest.split_first() {
            let slot = token.state.index().wrapping_sub(base);
            if slot >= PHONE_STATES {
                break;
            }
            rest = after;
            let score = LogProb::from_score(token.score);
            if let Some(destinations) = INSIDE.get(slot) {
                for (choice, &to) in hmm.choices(phone, slot).iter().zip(destinations) {
                    let arrives = score.times(*choice);
                    if arrives < floor {
                        continue;
                    }
                    match to {
                        NOWHERE => {}
                        TO_SOUND_LEADS => sound = sound.plus(arrives),
                        TO_MOUTH_LEADS => mouth = mouth.plus(arrives),
                        TO_NEXT => both = both.plus(arrives),
                        pair => scores.add(JointState::new(phone, usize::from(pair)), arrives),
                    }
                }
            } else if slot < SOUND_SLOT {
                let choices = hmm.choices(phone, MOUTH_LEADS);
                add_above(scores, token.state, score.times(choices[STAY]), floor);
                let viseme = slot - MOUTH_SLOT;
                let score = score.over(LogProb::from_table(hmm.viseme_bigram(phone).get(viseme)));
                let (audio, both) = (score.times(choices[AUDIO]), score.times(choices[BOTH]));
                for &next in phones.of(viseme) {
                    let next = usize::from(next);
                    let bigram = LogProb::from_table(hmm.bigram(phone).get(next));
                    add_above(
                        scores,
                        JointState::new(next, pair(0, 0)),
                        audio.times(bigram),
                        floor,
                    );
                    add_above(
                        scores,
                        JointState::new(next, pair(0, 1)),
                        both.times(bigram),
                        floor,
                    );
                }
            } else {
                let choices = hmm.choices(phone, SOUND_LEADS);
                add_above(scores, token.state, score.times(choices[STAY]), floor);
                let visual = JointState::new(phone, pair(0, 0));
                add_above(scores, visual, score.times(choices[VISUAL]), floor);
                let both = JointState::new(phone, pair(1, 0));
                add_above(scores, both, score.times(choices[BOTH]), floor);
            }
        }
        if sound >= floor || both >= floor {
            let slot = SOUND_SLOT + hmm.viseme(phone);
            for (next, bigram) in hmm.bigram(phone).iter().enumerate() {
                let bigram = LogProb::from_table(bigram);
                add_above(scores, JointState::new(next, slot), sound.times(bigram), floor);
                add_above(
                    scores,
                    JointState::new(next, pair(0, 0)),
                    both.times(bigram),
                    floor,
                );
            }
        }
        if mouth >= floor {
            for (viseme, sum) in hmm.viseme_bigram(phone).iter().enumerate() {
                let arrives = mouth.times(LogProb::from_table(sum));
                add_above(
                    scores,
                    JointState::new(phone, MOUTH_SLOT + viseme),
                    arrives,
                    floor,
                );
            }
        }
    }
}

#[inline]
fn add_above(scores: &mut Scores, state: JointState, value: LogProb, floor: LogProb) {
    if value >= floor {
        scores.add(state, value);
    }
}

/// The backward sum: `worth(i, β)` for every token, where β = Σ over its arcs of P(arc)·`future`(target), and
/// `future` holds emission times β of the next frame's joint states.
pub fn backward(
    hmm: &HmmTables,
    phones: &PhonesByViseme,
    tokens: &[Token],
    future: &Scores,
    mut worth: impl FnMut(usize, LogProb),
) {
    let mut border = Border {
        phone: usize::MAX,
        sound: None,
        mouth: None,
        both: None,
    };
    for (i, token) in tokens.iter().enumerate() {
        let (phone, slot) = (token.state.phone(), token.state.slot());
        if phone != border.phone {
            border = Border {
                phone,
                sound: None,
                mouth: None,
                both: None,
            };
        }
        let mut sum = LogProb::NEVER;
        let mut arc = |choice: LogProb, value: LogProb| {
            // An arc to where no token stands is worth nothing.
            if !value.is_never() {
                sum = sum.plus(choice.times(value));
            }
        };
        if let Some(destinations) = INSIDE.get(slot) {
            for (choice, &to) in hmm.choices(phone, slot).iter().zip(destinations) {
                let value = match to {
                    NOWHERE => continue,
                    TO_SOUND_LEADS => border.sound(hmm, future),
                    TO_MOUTH_LEADS => border.mouth(hmm, future),
                    TO_NEXT => border.both(hmm, future),
                    pair => future.get(JointState::new(phone, usize::from(pair))),
                };
                arc(*choice, value);
            }
        } else if slot < SOUND_SLOT {
            let choices = hmm.choices(phone, MOUTH_LEADS);
            arc(choices[STAY], future.get(token.state));
            let viseme = slot - MOUTH_SLOT;
            let total = LogProb::from_table(hmm.viseme_bigram(phone).get(viseme));
            for &next in phones.of(viseme) {
                let next = usize::from(next);
                let bigram = LogProb::from_table(hmm.bigram(phone).get(next)).over(total);
                arc(
                    choices[AUDIO].times(bigram),
                    future.get(JointState::new(next, pair(0, 0))),
                );
                arc(
                    choices[BOTH].times(bigram),
                    future.get(JointState::new(next, pair(0, 1))),
                );
            }
        } else {
            let choices = hmm.choices(phone, SOUND_LEADS);
            arc(choices[STAY], future.get(token.state));
            arc(choices[VISUAL], future.get(JointState::new(phone, pair(0, 0))));
            arc(choices[BOTH], future.get(JointState::new(phone, pair(1, 0))));
        }
        worth(i, sum);
    }
}

/// What it is worth to leave a phone, computed when first asked for.
struct Border {
    phone: usize,
    sound: Option<LogProb>,
    mouth: Option<LogProb>,
    both: Option<LogProb>,
}

impl Border {
    fn sound(&mut self, hmm: &HmmTables, future: &Scores) -> LogProb {
        let phone = self.phone;
        *self.sound.get_or_insert_with(|| {
            let slot = SOUND_SLOT + hmm.viseme(phone);
            spread(hmm, phone, future, slot)
        })
    }

    fn both(&mut self, hmm: &HmmTables, future: &Scores) -> LogProb {
        let phone = self.phone;
        *self
            .both
            .get_or_insert_with(|| spread(hmm, phone, future, pair(0, 0)))
    }

    fn mouth(&mut self, hmm: &HmmTables, future: &Scores) -> LogProb {
        let phone = self.phone;
        *self.mouth.get_or_insert_with(|| {
            let mut sum = LogProb::NEVER;
            for (viseme, total) in hmm.viseme_bigram(phone).iter().enumerate() {
                let value = future.get(JointState::new(phone, MOUTH_SLOT + viseme));
                if !value.is_never() {
                    sum = sum.plus(LogProb::from_table(total).times(value));
                }
            }
            sum
        })
    }
}

/// Σ B(p'|phone) · future of (p', slot).
fn spread(hmm: &HmmTables, phone: usize, future: &Scores, slot: usize) -> LogProb {
    let mut sum = LogProb::NEVER;
    for (next, bigram) in hmm.bigram(phone).iter().enumerate() {
        let value = future.get(JointState::new(next, slot));
        if !value.is_never() {
            sum = sum.plus(LogProb::from_table(bigram).times(value));
        }
    }
    sum
}
