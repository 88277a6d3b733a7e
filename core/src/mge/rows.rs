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

/// Σ weight·input. At most 494 products (32 taps and 6 means of 13) of 2⁷ · 2¹⁵: below 2³¹.
#[inline]
fn dot(weights: &[u8], inputs: &[i16]) -> i32 {
    weights
        .iter()
        .zip(inputs)
        .map(|(w, u)| i32::from(*w as i8) * i32::from(*u))
        .sum()
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
    let (Some((a, rest)), true) = (weights.split_at_checked(columns), columns > 0) else {
        return sums;
    };
    let Some((b, rest)) = rest.split_at_checked(columns) else {
        return sums;
    };
    let Some((c, d)) = rest.split_at_checked(columns) else {
        return sums;
    };
    for ((((a, b), c), d), u) in a.iter().zip(b).zip(c).zip(d).zip(inputs) {
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
        let weights: [u8; 28] = core::array::from_fn(|i| (i * 37 + 11) as u8);
        let inputs: [i16; 7] = [-32768, 32767, 5, -1, 300, -7000, 12];
        let sums = dot_four(&weights, 7, &inputs);
        for (row, sum) in weights.chunks_exact(7).zip(sums) {
            assert_eq!(sum, dot(row, &inputs));
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
