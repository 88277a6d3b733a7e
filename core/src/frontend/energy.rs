//! Energy of the raw window: E = ln max(Σ x², 1), and the headroom that it leaves the transform.
//!
//! A window is five blocks of 80 samples and a hop is two, so each hop squares only the two new blocks.
//! The sum is exact. |error of E| ≤ 0.0021 (half an LSB of Q7.8 and the logarithm's error).
use crate::fixed::round_shift_i64;
use crate::frontend::log::log2_q16;
use crate::{FRAME_SAMPLES, HOP_SAMPLES};

const BLOCK: usize = 80;
const BLOCKS: usize = FRAME_SAMPLES / BLOCK;
const NEW_BLOCKS: usize = HOP_SAMPLES / BLOCK;

/// ln 2 in Q32.
const LN_2: i64 = 2_977_044_472;

/// Σ x² of the blocks of the present window.
#[derive(Clone, Debug, Default)]
pub struct Energy {
    /// Each ≤ 80·2³⁰.
    blocks: [u64; BLOCKS],
    /// Whether a window went before, so that the first blocks are known.
    rolling: bool,
}

impl Energy {
    /// Σ x² of the window, ≤ 400·2³⁰ < 2³⁹. Windows must follow each other at one hop.
    pub fn next(&mut self, window: &[i16; FRAME_SAMPLES]) -> u64 {
        let known = if self.rolling { BLOCKS - NEW_BLOCKS } else { 0 };
        self.blocks.copy_within(BLOCKS - known.., 0);
        self.rolling = true;
        for (sum, block) in self.blocks[known..]
            .iter_mut()
            .zip(window[known * BLOCK..].as_chunks::<BLOCK>().0)
        {
            *sum = energy(block);
        }
        self.blocks.iter().sum()
    }
}

/// Σ x², ≤ 80·2³⁰.
fn energy(block: &[i16; BLOCK]) -> u64 {
    // Squares are at most 2³⁰, so that two fit into 32 bits.
    let pairs = block.as_chunks().0.iter().map(|&[a, b]| square(a) + square(b));
    pairs.map(u64::from).sum()
}

#[inline(always)]
fn square(x: i16) -> u32 {
    (i32::from(x) * i32::from(x)) as u32
}

/// E in Q7.8 of Σ x²; in [0, 26.8].
pub fn log_energy(sum: u64) -> i16 {
    // log₂ < 39 in Q16, times ln 2 in Q32: < 2⁵⁴.
    round_shift_i64(i64::from(log2_q16(sum)) * LN_2, 40) as i16
}

/// Bits by which the window may be shifted up: the largest s ≤ 5 with Σ x²·4^s < 2³⁹.
pub fn headroom(sum: u64) -> u32 {
    ((sum.leading_zeros() - 25) / 2).min(5)
}
