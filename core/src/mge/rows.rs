//! Products of i8 matrices with 16-bit vectors.
use crate::fixed::{round_shift_i64, saturate_i32};
use crate::model::Rows;
use crate::model::field::SCALE_FRACTION_BITS;

/// bias + scale·sum / 2²⁴, rounded; held to 32 bits.
#[inline]
fn scaled(sum: i32, scale: i32, bias: i32) -> i32 {
    // Below 2³¹ · 2³¹; the bias is below 2³¹.
    let product = i64::from(sum) * i64::from(scale);
    saturate_i32(round_shift_i64(product, SCALE_FRACTION_BITS) + i64::from(bias))
}

/// Products that a loop makes at a time, so that loads have constant offsets.
const STEP: usize = 8;

/// Σ weight·input. At most 494 products (32 taps and 6 means of 13) of 2⁷ · 2¹⁵: below 2³¹.
#[inline]
fn dot(weights: &[u8], inputs: &[i16]) -> i32 {
    let (chunks, rest) = weights.as_chunks::<STEP>();
    let (inputs, left) = inputs.as_chunks::<STEP>();
    let mut sum = 0;
    for (w, u) in chunks.iter().zip(inputs) {
        for i in 0..STEP {
            sum += i32::from(w[i] as i8) * i32::from(u[i]);
        }
    }
    for (w, u) in rest.iter().zip(left) {
        sum += i32::from(*w as i8) * i32::from(*u);
    }
    sum
}

/// One row of the product.
#[inline]
pub fn row(rows: &Rows, row: usize, inputs: &[i16]) -> i32 {
    let sum = dot(rows.weights(row, 1), inputs);
    scaled(sum, rows.scale(row), rows.bias(row))
}

/// All rows of the product, one call of `out(row, value)` each. `inputs` has as many numbers as the matrix has columns.
///
/// Four rows share a walk through the inputs, so that an input is loaded once for four products.
#[inline]
pub fn product(rows: &Rows, inputs: &[i16], mut out: impl FnMut(usize, i32)) {
    let blocks = rows.len() / 4;
    for block in 0..blocks {
        let first = 4 * block;
        let sums = dot_four(rows.weights(first, 4), rows.columns, inputs);
        for (i, sum) in sums.into_iter().enumerate() {
            out(
                first + i,
                scaled(sum, rows.scale(first + i), rows.bias(first + i)),
            );
        }
    }
    for r in 4 * blocks..rows.len() {
        out(r, row(rows, r, inputs));
    }
}

#[inline]
fn dot_four(weights: &[u8], columns: usize, inputs: &[i16]) -> [i32; 4] {
    let mut sums = [0i32; 4];
    let row = |n: usize| {
        let bytes = weights.get(n * columns..(n + 1) * columns);
        bytes.unwrap_or(&[]).as_chunks::<STEP>()
    };
    let ((a, a_rest), (b, b_rest), (c, c_rest), (d, d_rest)) = (row(0), row(1), row(2), row(3));
    let (chunks, left) = inputs.as_chunks::<STEP>();
    for ((((a, b), c), d), u) in a.iter().zip(b).zip(c).zip(d).zip(chunks) {
        for i in 0..STEP {
            let u = i32::from(u[i]);
            sums[0] += i32::from(a[i] as i8) * u;
            sums[1] += i32::from(b[i] as i8) * u;
            sums[2] += i32::from(c[i] as i8) * u;
            sums[3] += i32::from(d[i] as i8) * u;
        }
    }
    for ((((a, b), c), d), u) in a_rest.iter().zip(b_rest).zip(c_rest).zip(d_rest).zip(left) {
        let u = i32::from(*u);
        sums[0] += i32::from(*a as i8) * u;
        sums[1] += i32::from(*b as i8) * u;
        sums[2] += i32::from(*c as i8) * u;
        sums[3] += i32::from(*d as i8) * u;
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_rows_at_once_are_four_rows() {
        let weights: [u8; 4 * 21] = core::array::from_fn(|i| (i * 37 + 11) as u8);
        let inputs: [i16; 21] = core::array::from_fn(|i| (i as i32 * 7919 - 32768) as i16);
        for columns in [3, 7, 8, 16, 21] {
            let (weights, inputs) = (&weights[..4 * columns], &inputs[..columns]);
            let sums = dot_four(weights, columns, inputs);
            for (row, sum) in weights.chunks_exact(columns).zip(sums) {
                let products = row.iter().zip(inputs);
                let want: i32 = products.map(|(w, u)| i32::from(*w as i8) * i32::from(*u)).sum();
                assert_eq!((sum, dot(row, inputs)), (want, want));
            }
        }
    }

    #[test]
    fn the_largest_sum_fits() {
        let sum = dot(&[0x80; 494], &[i16::MIN; 494]);
        assert_eq!(sum, 494 << 22);
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
