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

/// The last five frames of a sequence in a ring; before its start stands the first one.
#[derive(Clone, Debug, Default)]
struct History {
    frames: [Statics; SPAN],
    newest: usize,
}

impl History {
    /// Makes room for a frame, which the caller writes.
    fn advance(&mut self) -> &mut Statics {
        self.newest = if self.newest + 1 < SPAN {
            self.newest + 1
        } else {
            0
        };
        &mut self.frames[self.newest]
    }

    /// Puts the first frame of the sequence in the place of all before it.
    fn fill_with_newest(&mut self) {
        self.frames = [self.frames[self.newest]; SPAN];
    }

    /// The frame `back` = 0..=4 before the newest.
    fn back(&self, back: usize) -> &Statics {
        let at = if self.newest >= back {
            self.newest - back
        } else {
            self.newest + SPAN - back
        };
        &self.frames[at]
    }

    /// Δ of the frame in the middle.
    fn delta(&self, out: &mut Statics) {
        let after = self.back(0).iter().zip(self.back(1));
        let before = self.back(4).iter().zip(self.back(3));
        for ((d, (&c2, &c1)), (&c_2, &c_1)) in out.iter_mut().zip(after).zip(before) {
            let far = i32::from(c2) - i32::from(c_2);
            let near = i32::from(c1) - i32::from(c_1);
            *d = saturate_i16(mul_high_rounded(2 * far + near, TENTH));
        }
    }
}

/// Δ and ΔΔ of a stream of statics.
#[derive(Clone, Debug, Default)]
pub struct Deltas {
    statics: History,
    deltas: History,
    /// Frames taken, up to five, the replicated ones after the end included.
    taken: usize,
}

impl Deltas {
    /// Takes frame t; from t = 4 on it writes Δ and ΔΔ of frame t − 4 and says so.
    pub fn next(&mut self, frame: &Statics, delta: &mut Statics, delta_delta: &mut Statics) -> bool {
        *self.statics.advance() = *frame;
        if self.taken == 0 {
            self.statics.fill_with_newest();
        }
        if self.taken >= LOOK_AHEAD {
            self.statics.delta(self.deltas.advance());
            if self.taken == LOOK_AHEAD {
                self.deltas.fill_with_newest();
            }
        }
        self.step(delta, delta_delta)
    }

    /// What [`next`](Self::next) does after the last frame, `past` = 1..=4 frames past it.
    pub fn next_past_end(&mut self, past: usize, delta: &mut Statics, delta_delta: &mut Statics) -> bool {
        if past <= LOOK_AHEAD {
            let last = *self.statics.back(0);
            return self.next(&last, delta, delta_delta);
        }
        let last = *self.deltas.back(0);
        *self.deltas.advance() = last;
        self.step(delta, delta_delta)
    }

    fn step(&mut self, delta: &mut Statics, delta_delta: &mut Statics) -> bool {
        let ready = self.taken >= 2 * LOOK_AHEAD;
        self.taken = (self.taken + 1).min(2 * LOOK_AHEAD + 1);
        if ready {
            *delta = *self.deltas.back(LOOK_AHEAD);
            self.deltas.delta(delta_delta);
        }
        ready
    }
}
