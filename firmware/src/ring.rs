//! Reading a ring of sound that hardware writes on and on, without ever stopping it.
//!
//! The writer counts words modulo 2³² and never waits; the reader follows at its own pace. Where it falls behind by more than the ring
//! holds, the oldest words are gone: it says how many and goes on with what is still there.

/// The reader's place in a ring of `N` words; N is a power of two.
#[derive(Clone, Copy, Debug, Default)]
pub struct RingReader<const N: usize> {
    /// Words taken or lost since the start, modulo 2³².
    place: u32,
}

/// What can be read at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Piece {
    /// Index of the first word in the ring.
    pub start: usize,
    /// Words from there on, none of them past the ring's end.
    pub count: usize,
    /// Words that were overwritten before they could be read.
    pub lost: u32,
}

impl<const N: usize> RingReader<N> {
    const MASK: u32 = {
        assert!(N.is_power_of_two());
        N as u32 - 1
    };

    /// At the ring's start.
    pub const fn new() -> Self {
        Self { place: 0 }
    }

    /// The next words, `most` at most, of a ring to which `written` words were written since the start. Words within `N / 8` of the writer's
    /// reach count as lost: it may overwrite them while they are read. A count behind the reader's is no news.
    pub fn next(&mut self, written: u32, most: usize) -> Piece {
        let waiting = written.wrapping_sub(self.place);
        let behind = waiting > u32::MAX / 2;
        let room = (N - N / 8) as u32;
        let lost = if behind { 0 } else { waiting.saturating_sub(room) };
        self.place = self.place.wrapping_add(lost);
        let start = (self.place & Self::MASK) as usize;
        let waiting = if behind { 0 } else { (waiting - lost) as usize };
        let count = waiting.min(N - start).min(most);
        self.place = self.place.wrapping_add(count as u32);
        Piece { start, count, lost }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A reader that keeps up gets every word once, in order, whatever the cut.
    #[test]
    fn nothing_is_lost_by_a_reader_that_keeps_up() {
        let mut reader = RingReader::<64>::new();
        let (mut written, mut expected) = (0_u32, 0_u32);
        for step in [1, 7, 40, 0, 56, 13, 30, 55, 2].into_iter().cycle().take(500) {
            written += step;
            loop {
                let piece = reader.next(written, 160);
                assert_eq!(piece.lost, 0);
                if piece.count == 0 {
                    break;
                }
                assert!(piece.start + piece.count <= 64);
                assert_eq!(piece.start, expected as usize % 64);
                expected += piece.count as u32;
            }
            assert_eq!(expected, written);
        }
    }

    #[test]
    fn what_was_overwritten_is_counted_and_skipped() {
        let mut reader = RingReader::<64>::new();
        let piece = reader.next(200, 160);
        // 56 of 64 can be read safely: from word 144 on, to the ring's end.
        let expected = Piece {
            start: 144 % 64,
            count: 48,
            lost: 144,
        };
        assert_eq!(piece, expected);
        let rest = reader.next(200, 160);
        assert_eq!((rest.start, rest.count, rest.lost), (0, 8, 0));
    }

    #[test]
    fn the_count_may_turn_over_and_lag_behind() {
        let mut reader = RingReader::<64>::new();
        reader.place = u32::MAX - 3;
        assert_eq!(reader.next(4, 160).count, 4);
        assert_eq!(reader.next(4, 160).count, 4);
        // An old count: neither news nor a loss of four thousand million words.
        let piece = reader.next(2, 160);
        assert_eq!((piece.count, piece.lost), (0, 0));
        assert_eq!(reader.next(5, 160).count, 1);
    }
}
