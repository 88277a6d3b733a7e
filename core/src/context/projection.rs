//! The projection: a few numbers of the statics around a frame, by a matrix of i16 mantissas with a shift and an offset a row.
//!
//! Four rows share a walk through the statics. Products of halfwords are summed in 32 bits: the mantissas of a row add up to less
//! than 2¹⁶, as the checked tables see to it, so that no statics can overflow a sum.
use super::tables::{ContextTables, MAX_INPUTS, MAX_MEANS, MAX_TAPS, SumRow};
use crate::N_STATIC;
use crate::fixed::{aligned_words, halves, mul_halves, round_shift_i64, saturate_i16, saturate_i32};

/// Largest number of numbers in a context.
pub const MAX_CONTEXT: usize = N_STATIC * (MAX_TAPS + MAX_MEANS);

/// Rows that share a walk.
const ROWS: usize = 4;
/// Words of two halfwords that are unrolled.
const WORDS: usize = 28;

/// The projection of `context` (Q7.8, as long as the tables' context), in the LSB of the kind's maps: Q5.11 of a
/// likelihood-trained model, Q5.10 of a recurrent one. The first [`ContextTables::n_inputs`] numbers are meaningful.
pub fn project(tables: &ContextTables, context: &[i16]) -> [i16; MAX_INPUTS] {
    let mut words = [0u32; MAX_CONTEXT / 2];
    let (pairs, last) = context.as_chunks();
    for (word, [low, high]) in words.iter_mut().zip(pairs) {
        *word = halves(*low, *high);
    }
    let words = words.get(..pairs.len()).unwrap_or(&[]);
    let mut x = [0; MAX_INPUTS];
    let mut rows = tables.projection();
    for to in x.chunks_mut(ROWS) {
        let some: [Option<SumRow>; ROWS] = core::array::from_fn(|_| rows.next());
        // Where rows are missing, the first one stands for them too.
        let [Some(first), ..] = some else {
            break;
        };
        let bytes = some.map(|row| row.unwrap_or(first).weights.bytes());
        for ((to, row), sum) in to.iter_mut().zip(some).zip(dot(bytes, words, last)) {
            if let Some(row) = row {
                let value = round_shift_i64(i64::from(sum), row.shift) - i64::from(row.offset);
                *to = saturate_i16(saturate_i32(value));
            }
        }
    }
    x
}

/// Two products more: mantissas as they lie in the tables with a pair of inputs.
#[inline(always)]
fn two(sum: i32, weights: &[u8; 4], word: u32) -> i32 {
    mul_halves(sum, u32::from_le_bytes(*weights), word)
}

/// Σ weightᵢ·inputᵢ of each row: inputs in pairs, and one more where their number is odd.
fn dot(rows: [&[u8]; ROWS], words: &[u32], last: &[i16]) -> [i32; ROWS] {
    let rows = rows.map(|row| row.as_chunks::<4>());
    let chunks = rows.map(|(pairs, _)| pairs.as_chunks::<WORDS>());
    let (inputs, rest) = words.as_chunks::<WORDS>();
    let mut sums = [0; ROWS];
    let [a, b, c, d] = chunks.map(|(chunks, _)| chunks);
    for ((((a, b), c), d), words) in a.iter().zip(b).zip(c).zip(d).zip(inputs) {
        dot_chunk(&mut sums, [a, b, c, d], words);
    }
    for ((sum, (_, pairs)), (_, single)) in sums.iter_mut().zip(chunks).zip(rows) {
        for (pair, word) in pairs.iter().zip(rest) {
            *sum = two(*sum, pair, *word);
        }
        if let ([low, high], [input]) = (single, last) {
            let product = i32::from(i16::from_le_bytes([*low, *high])) * i32::from(*input);
            *sum = sum.wrapping_add(product);
        }
    }
    sums
}

/// Adds the products of some words. Out of line, so that its registers are its own and all its addresses constant offsets.
#[inline(never)]
fn dot_chunk(sums: &mut [i32; ROWS], rows: [&[[u8; 4]; WORDS]; ROWS], words: &[u32; WORDS]) {
    if !cfg!(smlad) {
        // Other processors have the registers for one row, or do better by themselves.
        for (sum, row) in sums.iter_mut().zip(rows) {
            if cfg!(short_products)
                && let Some(aligned) = aligned_words(row.as_flattened())
            {
                for (weights, word) in aligned.iter().zip(words) {
                    *sum = mul_halves(*sum, *weights, *word);
                }
                continue;
            }
            *sum = dot_bytes(*sum, row, words);
        }
        return;
    }
    let [a, b, c, d] = rows;
    let mut s = *sums;
    // Unrolled by hand: the compiler does not.
    macro_rules! add {
        ($($i:literal)*) => {
            $(s = [
                two(s[0], &a[$i], words[$i]),
                two(s[1], &b[$i], words[$i]),
                two(s[2], &c[$i], words[$i]),
                two(s[3], &d[$i], words[$i]),
            ];)*
        };
    }
    add!(0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27);
    *sums = s;
}

/// Where the mantissas do not lie as words do. Out of line: it is rare.
#[inline(never)]
fn dot_bytes(sum: i32, row: &[[u8; 4]; WORDS], words: &[u32; WORDS]) -> i32 {
    let products = row.iter().zip(words);
    products.fold(sum, |sum, (weights, word)| two(sum, weights, *word))
}

#[cfg(test)]
mod tests {
    use super::*;

    extern crate std;
    use std::vec::Vec;

    fn check(columns: usize, rows: usize, largest: i32) {
        let weight =
            |r: usize, c: usize| ((r * 7919 + c * 104_729) as i32 % (2 * largest + 1) - largest) as i16;
        let inputs: Vec<i16> = (0..columns)
            .map(|c| (c as i32 * 7919 % 65536 - 32768) as i16)
            .collect();
        let bytes: Vec<Vec<u8>> = (0..rows)
            .map(|r| (0..columns).flat_map(|c| weight(r, c).to_le_bytes()).collect())
            .collect();
        let (pairs, last) = inputs.as_chunks();
        let words: Vec<u32> = pairs.iter().map(|[low, high]| halves(*low, *high)).collect();
        let sums = dot(
            core::array::from_fn(|r| &bytes[r.min(rows - 1)][..]),
            &words,
            last,
        );
        for (r, sum) in sums.into_iter().enumerate().take(rows) {
            let want: i32 = (0..columns)
                .map(|c| i32::from(weight(r, c)) * i32::from(inputs[c]))
                .sum();
            assert_eq!(sum, want, "row {r} of {rows}, {columns} columns");
        }
    }

    #[test]
    fn sums_are_exact() {
        for columns in [1, 2, 13, 26, 31, 32, 33, 64, 169, 494] {
            for rows in 1..=ROWS {
                check(columns, rows, 65535 / columns.max(3) as i32);
            }
        }
    }

    #[test]
    fn the_largest_sum_fits() {
        let weights: Vec<u8> = [32767i16, 32767, 1]
            .iter()
            .flat_map(|w| w.to_le_bytes())
            .collect();
        let sums = dot([&weights; ROWS], &[0x8000_8000], &[i16::MIN]);
        assert_eq!(sums, [-(65535 << 15); ROWS]);
    }
}
