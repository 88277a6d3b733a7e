//! The last statics of a stream.
use crate::N_STATIC;

/// Statics that are kept: more than 40 before a frame and 16 after it.
const RING: usize = 64;

/// The last statics, Q7.8.
#[derive(Clone, Debug)]
pub struct History {
    ring: [[i16; N_STATIC]; RING],
    /// Frames pushed so far.
    count: u32,
}

impl History {
    /// Nothing heard yet.
    #[inline(always)]
    pub const fn new() -> Self {
        Self {
            ring: [[0; N_STATIC]; RING],
            count: 0,
        }
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        self.count = 0;
    }

    /// Frames pushed so far, modulo 2³².
    pub fn count(&self) -> u32 {
        self.count
    }

    /// The next frame's statics, Q7.8.
    pub fn push(&mut self, statics: &[i16; N_STATIC]) {
        self.ring[self.count as usize % RING] = *statics;
        self.count = self.count.wrapping_add(1);
    }

    /// The statics of a frame; beyond either end of what has been pushed those of the first or the last frame.
    #[inline]
    pub fn at(&self, frame: i64) -> [i16; N_STATIC] {
        let last = i64::from(self.count) - 1;
        self.ring[frame.min(last).max(0) as usize % RING]
    }
}

impl Default for History {
    fn default() -> Self {
        Self::new()
    }
}
