//! Which block of a ring a PDM peripheral with a double-buffered pointer (Nordic's) fills next, and how many it has filled.
//!
//! The peripheral takes the pointer when it begins a block and says so (STARTED); from then on the next block's pointer may be written. It
//! says when a block is full (END) and goes on at once. Whoever is more than a block late finds the same block filled twice.

/// The peripheral's registers that matter while it runs.
pub trait Registers {
    /// Whether STARTED stood; clears it.
    fn take_started(&mut self) -> bool;
    /// Whether END stood; clears it.
    fn take_ended(&mut self) -> bool;
    /// Where the block after the present one goes.
    fn point_at(&mut self, block: usize);
}

/// A ring of so many blocks.
#[derive(Clone, Copy, Debug)]
pub struct Blocks<const N: usize> {
    /// The block that the pointer names.
    next: usize,
    /// Blocks filled since the start, modulo 2³².
    filled: u32,
}

impl<const N: usize> Blocks<N> {
    /// Points at the first block; the peripheral is to be started afterwards.
    pub fn begin(registers: &mut impl Registers) -> Self {
        registers.point_at(0);
        Self { next: 0, filled: 0 }
    }

    /// What the interrupt does. Blocks filled since the start, modulo 2³².
    pub fn serve(&mut self, registers: &mut impl Registers) -> u32 {
        // The end of a block comes before the start of the next, and both may stand by now.
        if registers.take_ended() {
            self.filled = self.filled.wrapping_add(1);
        }
        if registers.take_started() {
            self.next = (self.next + 1) % N;
            registers.point_at(self.next);
        }
        self.filled
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;

    /// The peripheral as its manual describes it, with blocks of one sample each.
    #[derive(Default)]
    struct Peripheral {
        pointer: usize,
        filling: Option<usize>,
        started: bool,
        ended: bool,
        ring: [u32; 8],
        sound: u32,
    }

    impl Peripheral {
        fn begin_block(&mut self) {
            self.filling = Some(self.pointer);
            self.started = true;
        }

        /// A block's time passes.
        fn block(&mut self) {
            let block = self.filling.expect("started");
            self.ring[block] = self.sound;
            self.sound += 1;
            self.ended = true;
            self.begin_block();
        }
    }

    impl Registers for Peripheral {
        fn take_started(&mut self) -> bool {
            std::mem::take(&mut self.started)
        }

        fn take_ended(&mut self) -> bool {
            std::mem::take(&mut self.ended)
        }

        fn point_at(&mut self, block: usize) {
            self.pointer = block;
        }
    }

    #[test]
    fn blocks_follow_each_other_round_the_ring() {
        let mut peripheral = Peripheral::default();
        let mut blocks = Blocks::<8>::begin(&mut peripheral);
        peripheral.begin_block();
        assert_eq!(blocks.serve(&mut peripheral), 0);
        let mut heard = Vec::new();
        for _ in 0..20 {
            peripheral.block();
            let filled = blocks.serve(&mut peripheral);
            heard.push(peripheral.ring[(filled as usize - 1) % 8]);
        }
        assert_eq!(heard, (0..20).collect::<Vec<u32>>());
        // An interrupt for something else changes nothing.
        assert_eq!(blocks.serve(&mut peripheral), 20);
        assert_eq!(peripheral.pointer, 21 % 8);
    }
}
