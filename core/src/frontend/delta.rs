//! Δ and ΔΔ by regression over ±2 frames, d = (2(c₊₂ − c₋₂) + c₊₁ − c₋₁)/10, edges replicated.
//!
//! ΔΔ is Δ of the rounded Δ, whose edges are replicated in turn, as HTK does. |error| ≤ half an LSB of Q7.8 for Δ
//! of given statics, 0.8 LSB for ΔΔ.
use crate::N_STATIC;
use crate::fixed::{mul_high_rounded, saturate_i16};

/// Frames that Δ looks ahead; ΔΔ looks twice as far.
pub const LOOK_AHEAD: usize = 2;

const SPAN: usize = 2 * LOOK_AHEAD + 1;

/// 1/10 in Q32.
const TENTH: i32 = 429_496_730;

type Statics = [i16; N_STATIC];

/// The last five frames of a sequence; before its start stands the first one.
#[derive(Clone, Debug, Default)]
struct History {
    frames: [Statics; SPAN],
}

impl History {
    /// Appends a frame; the sequence's first one fills the past too.
    fn append(&mut self, frame: &Statics, first: bool) {
        if first {
            self.frames = [*frame; SPAN];
        } else {
            self.frames.copy_within(1.., 0);
            self.frames[SPAN - 1] = *frame;
        }
    }

    /// Δ of the frame in the middle.
    fn delta(&self) -> Statics {
        let [c_2, c_1, _, c1, c2] = &self.frames;
        core::array::from_fn(|i| {
            let far = i32::from(c2[i]) - i32::from(c_2[i]);
            let near = i32::from(c1[i]) - i32::from(c_1[i]);
            saturate_i16(mul_high_rounded(2 * far + near, TENTH))
        })
    }

    fn last(&self) -> Statics {
        self.frames[SPAN - 1]
    }
}

/// Δ and ΔΔ of a stream of statics.
#[derive(Clone, Debug, Default)]
pub struct Deltas {
    statics: History,
    deltas: History,
    /// Frames taken, the replicated ones after the end included.
    taken: usize,
}

impl Deltas {
    /// Takes frame t; gives Δ and ΔΔ of frame t − 4, from t = 4 on.
    pub fn next(&mut self, frame: &Statics) -> Option<(Statics, Statics)> {
        self.statics.append(frame, self.taken == 0);
        let delta = (self.taken >= LOOK_AHEAD).then(|| self.statics.delta());
        self.step(delta)
    }

    /// What [`next`](Self::next) gives after the last frame, `past` = 1..=4 frames past it.
    pub fn next_past_end(&mut self, past: usize) -> Option<(Statics, Statics)> {
        if past <= LOOK_AHEAD {
            let last = self.statics.last();
            return self.next(&last);
        }
        let last = self.deltas.last();
        self.step((self.taken > LOOK_AHEAD).then_some(last))
    }

    fn step(&mut self, delta: Option<Statics>) -> Option<(Statics, Statics)> {
        if let Some(delta) = delta {
            self.deltas.append(&delta, self.taken == LOOK_AHEAD);
        }
        let ready = self.taken >= 2 * LOOK_AHEAD;
        // Only "how many of the first four" matters.
        self.taken = (self.taken + 1).min(2 * LOOK_AHEAD + 1);
        ready.then(|| (self.deltas.frames[LOOK_AHEAD], self.deltas.delta()))
    }
}
