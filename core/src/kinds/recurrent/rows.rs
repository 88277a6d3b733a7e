//! Products of i8 matrices with 16-bit vectors.
//!
//! A weight w is stored as w + 128, so that two of a word's four weights become two halfwords by one AND; two products of
//! halfwords and their addition are one instruction on Cortex-M4 ([`mul_halves`]); 128·Σinput is taken off at the start. Two
//! layouts: row by row (U, F), of which a frame asks for some rows only, [`row`]; and in blocks of [`BLOCK`] rows (V_d, W₀, O), of
//! which all are wanted and share a walk through the inputs, [`product`].
use super::tables::{BLOCK, Blocks, MAX_MEMORY, Rows, SCALE_FRACTION_BITS};
use crate::context::tables::MAX_INPUTS;
use crate::fixed::{halves, mul_halves, mul_high_rounded, mul_long, round_shift_i64, saturate_i32};

/// bias + scale·sum / 2²⁴, rounded; held to 32 bits.
#[inline]
fn scaled(sum: i32, scale: i32, bias: i32) -> i32 {
    // Below 2³¹ · 2³¹; the bias is below 2³¹.
    let product = mul_long(sum, scale);
    saturate_i32(round_shift_i64(product, SCALE_FRACTION_BITS) + i64::from(bias))
}

/// The mask that leaves every other byte of a word.
///
/// It is hidden from the compiler on purpose. If the compiler knew its value, it would see that the AND picks out single bytes, and
/// would load each byte by itself: more instructions than the AND of the whole word that the kernels want.
#[inline(always)]
fn mask() -> u32 {
    core::hint::black_box(0x00ff_00ff)
}

/// Four products more, modulo 2³².
#[inline(always)]
fn four(sum: i32, weights: &[u8; BLOCK], [even, odd]: &[u32; 2], mask: u32) -> i32 {
    if cfg!(short_products) {
        // The processor would have to take the halfwords apart again.
        let inputs = [
            *even as i16,
            *odd as i16,
            (*even >> 16) as i16,
            (*odd >> 16) as i16,
        ];
        let products = weights.iter().zip(inputs);
        return products.fold(sum, |sum, (w, u)| sum.wrapping_add(i32::from(*w) * i32::from(u)));
    }
    let word = u32::from_le_bytes(*weights);
    let sum = mul_halves(sum, word & mask, *even);
    mul_halves(sum, word.rotate_right(8) & mask, *odd)
}

/// One row of the product.
#[inline]
pub fn row(rows: &Rows, row: usize, inputs: &Inputs) -> i32 {
    let sum = dot_row(rows.weights(row), inputs.words(), inputs.start);
    scaled(sum, rows.scaling.scale(row), rows.scaling.bias(row))
}

/// Fours of products that are unrolled.
const STEP: usize = 4;

/// Σ weight·input of a row, below 2³¹ as in [`dot_block`].
#[inline]
fn dot_row(weights: &[[u8; BLOCK]], inputs: &[[u32; 2]], start: i32) -> i32 {
    let mask = mask();
    let (steps, rest) = weights.as_chunks::<STEP>();
    let (inputs, left) = inputs.as_chunks::<STEP>();
    let mut sum = start;
    for (weights, inputs) in steps.iter().zip(inputs) {
        sum = dot_step(sum, weights, inputs, mask);
    }
    for (weights, inputs) in rest.iter().zip(left) {
        sum = four(sum, weights, inputs, mask);
    }
    sum
}

/// Out of line, so that its registers are its own and all its addresses constant offsets.
#[inline(never)]
fn dot_step(sum: i32, weights: &[[u8; BLOCK]; STEP], inputs: &[[u32; 2]; STEP], mask: u32) -> i32 {
    let [a, b, c, d] = weights;
    let sum = four(sum, a, &inputs[0], mask);
    let sum = four(sum, b, &inputs[1], mask);
    let sum = four(sum, c, &inputs[2], mask);
    four(sum, d, &inputs[3], mask)
}

/// The largest number of columns of a matrix in blocks.
const MAX_COLUMNS: usize = if MAX_MEMORY > MAX_INPUTS {
    MAX_MEMORY
} else {
    MAX_INPUTS
};

/// A vector as [`product`] takes it.
pub struct Inputs {
    /// u₀ and u₂, then u₁ and u₃ of every four inputs as halfwords of a word; zeros behind the last.
    words: [[u32; 2]; MAX_COLUMNS.div_ceil(BLOCK)],
    fours: usize,
    /// −128·Σu, modulo 2³².
    start: i32,
}

impl Inputs {
    /// Inputs beyond the device's largest vector are left out.
    pub fn new(inputs: &[i16]) -> Self {
        let mut new = Self {
            words: [[0; 2]; MAX_COLUMNS.div_ceil(BLOCK)],
            fours: inputs.len().div_ceil(BLOCK),
            start: 0,
        };
        // 256 numbers of 15 bits and 7 bits more: below 2³¹.
        let mut sum = 0i32;
        let (fours, rest) = inputs.as_chunks::<BLOCK>();
        let mut last = [0; BLOCK];
        for (to, from) in last.iter_mut().zip(rest) {
            *to = *from;
        }
        for (to, [a, b, c, d]) in new.words.iter_mut().zip(fours.iter().chain([&last])) {
            *to = [halves(*a, *c), halves(*b, *d)];
            sum += i32::from(*a) + i32::from(*b) + i32::from(*c) + i32::from(*d);
        }
        new.start = sum.wrapping_mul(-128);
        new
    }

    #[inline]
    fn words(&self) -> &[[u32; 2]] {
        self.words.get(..self.fours).unwrap_or(&[])
    }
}

/// All rows of the product, one call of `out(row, value)` each, without the bias that some matrices have. `inputs` has as many
/// numbers as the matrix has columns.
#[inline]
pub fn product(rows: &Blocks, inputs: &Inputs, mut out: impl FnMut(usize, i32)) {
    for (block, first) in rows.blocks().zip((0..).step_by(BLOCK)) {
        let sums = dot_block(block, inputs.words(), inputs.start);
        for (row, sum) in (first..rows.len()).zip(sums) {
            // Below 2³⁰ · 2³¹ / 2³² in size.
            let value = mul_high_rounded(sum, rows.scaling.scale(row) << (32 - SCALE_FRACTION_BITS));
            out(row, value);
        }
    }
}

/// Σ weight·input of a block's four rows. The sums are below 2³¹ (256 products of 2⁷ · 2¹⁵), what they pass through on the
/// way need not be: it is computed modulo 2³².
#[inline(never)]
fn dot_block(block: &[[u8; BLOCK * BLOCK]], inputs: &[[u32; 2]], start: i32) -> [i32; BLOCK] {
    let mask = mask();
    let mut sums = [start; BLOCK];
    for (weights, inputs) in block.iter().zip(inputs) {
        for (sum, of_row) in sums.iter_mut().zip(weights.as_chunks::<BLOCK>().0) {
            *sum = four(*sum, of_row, inputs, mask);
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four rows as a block's bytes.
    fn block<const C: usize>(rows: &[[i8; C]; BLOCK]) -> heapless::Vec<[u8; BLOCK * BLOCK], 64> {
        (0..C.div_ceil(BLOCK))
            .map(|q| {
                core::array::from_fn(|i| {
                    let (row, column) = (i / BLOCK, BLOCK * q + i % BLOCK);
                    let weight = if column < C { rows[row][column] } else { 0 };
                    (weight as u8) ^ 0x80
                })
            })
            .collect()
    }

    fn agree<const C: usize>(rows: [[i8; C]; BLOCK], inputs: [i16; C]) {
        let packed = Inputs::new(&inputs);
        let sums = dot_block(&block(&rows), packed.words(), packed.start);
        for (row, sum) in rows.iter().zip(sums) {
            let products = row.iter().zip(inputs);
            let want: i32 = products.map(|(w, u)| i32::from(*w) * i32::from(u)).sum();
            let fours: heapless::Vec<[u8; BLOCK], 64> = row
                .chunks(BLOCK)
                .map(|four| core::array::from_fn(|c| (four.get(c).map_or(0, |w| *w) as u8) ^ 0x80))
                .collect();
            let of_row = dot_row(&fours, packed.words(), packed.start);
            assert_eq!((sum, of_row), (want, want));
        }
    }

    #[test]
    fn a_block_is_four_rows() {
        fn of<const C: usize>() {
            let weight = |r: usize, c: usize| ((r * 91 + c * 37 + 11) % 256) as u8 as i8;
            let input = |c: usize| (c as i32 * 7919 % 65536 - 32768) as i16;
            agree::<C>(
                core::array::from_fn(|r| core::array::from_fn(|c| weight(r, c))),
                core::array::from_fn(input),
            );
        }
        of::<3>();
        of::<4>();
        of::<8>();
        of::<30>();
        of::<160>();
    }

    #[test]
    fn the_largest_sums_fit() {
        agree([[-128; MAX_COLUMNS]; BLOCK], [i16::MIN; MAX_COLUMNS]);
        agree([[127; MAX_COLUMNS]; BLOCK], [i16::MIN; MAX_COLUMNS]);
        let sum = (MAX_COLUMNS as i32) << 22;
        assert_eq!(scaled(sum, i32::MAX, 1 << 30), i32::MAX);
        assert_eq!(scaled(-sum, i32::MAX, 1 << 30), i32::MIN);
    }

    #[test]
    fn scales_round_to_the_nearest() {
        assert_eq!(scaled(3, 1 << 23, 0), 2);
        assert_eq!(scaled(-3, 1 << 23, 0), -1);
        assert_eq!(scaled(1000, 1 << 24, -7), 993);
    }
}
