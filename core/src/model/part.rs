//! What [`Model`](super::Model)'s accessors give: pieces of the tables, borrowed as they lie there.
use super::field::BLOCK;
use crate::logmath::LogProb;

/// Little-endian i16 in a byte slice.
#[derive(Clone, Copy, Debug)]
pub struct I16s<'a>(pub(super) &'a [u8]);

impl<'a> I16s<'a> {
    /// Number `index`, 0 beyond the end.
    #[inline]
    pub fn get(self, index: usize) -> i16 {
        match self.0.get(2 * index..2 * index + 2) {
            Some(&[a, b]) => i16::from_le_bytes([a, b]),
            _ => 0,
        }
    }

    /// The numbers as they lie there.
    #[inline]
    pub fn bytes(self) -> &'a [u8] {
        self.0
    }

    #[inline]
    pub fn iter(self) -> impl ExactSizeIterator<Item = i16> + 'a {
        self.0.as_chunks().0.iter().map(|b| i16::from_le_bytes(*b))
    }

    /// Numbers `row·width .. (row + 1)·width`, empty beyond the end.
    #[inline]
    pub fn row(self, row: usize, width: usize) -> Self {
        let start = 2 * row * width;
        Self(self.0.get(start..start + 2 * width).unwrap_or(&[]))
    }
}

/// Little-endian u16 in a byte slice.
#[derive(Clone, Copy, Debug)]
pub struct U16s<'a>(pub(super) &'a [u8]);

impl<'a> U16s<'a> {
    #[inline]
    pub fn iter(self) -> impl ExactSizeIterator<Item = u16> + 'a {
        self.0.as_chunks().0.iter().map(|b| u16::from_le_bytes(*b))
    }

    /// Numbers `row·width .. (row + 1)·width`, empty beyond the end.
    #[inline]
    pub fn row(self, row: usize, width: usize) -> Self {
        let start = 2 * row * width;
        Self(self.0.get(start..start + 2 * width).unwrap_or(&[]))
    }
}

/// One density of a mixture, as it lies in the tables.
#[derive(Clone, Copy, Debug)]
pub struct Density<'a> {
    /// log2 of weight and normaliser; None for one that is not used.
    pub constant: Option<LogProb>,
    /// Means, i8 two's complement, as many as the mixture's numbers.
    pub mean: &'a [u8],
    /// Inverse deviations, as many.
    pub inverse_deviation: &'a [u8],
}

/// What becomes of the sums of a matrix's rows.
#[derive(Clone, Copy, Debug)]
pub struct Scaling<'a> {
    pub(super) scale: &'a [[u8; 4]],
    /// Empty where there is none.
    pub(super) bias: &'a [[u8; 4]],
}

impl Scaling<'_> {
    /// Scale of a row, LSB 2⁻²⁴.
    #[inline]
    pub fn scale(&self, row: usize) -> i32 {
        self.scale.get(row).map_or(0, |b| i32::from_le_bytes(*b))
    }

    /// Bias of a row, within ±2³⁰.
    #[inline]
    pub fn bias(&self, row: usize) -> i32 {
        self.bias.get(row).map_or(0, |b| i32::from_le_bytes(*b))
    }
}

/// A matrix of i8 weights row by row, see [`Matrix`](super::field::Matrix).
#[derive(Clone, Copy, Debug)]
pub struct Rows<'a> {
    pub(super) weights: &'a [[u8; BLOCK]],
    /// Columns, in fours.
    pub(super) fours: usize,
    pub scaling: Scaling<'a>,
}

impl<'a> Rows<'a> {
    /// Weights of a row + 128, in fours; empty beyond the end.
    #[inline]
    pub fn weights(&self, row: usize) -> &'a [[u8; BLOCK]] {
        self.weights
            .get(row * self.fours..(row + 1) * self.fours)
            .unwrap_or(&[])
    }
}

/// A matrix of i8 weights in blocks, see [`BLOCK`].
#[derive(Clone, Copy, Debug)]
pub struct Blocks<'a> {
    pub(super) weights: &'a [[u8; BLOCK * BLOCK]],
    /// Columns, in fours.
    pub(super) fours: usize,
    pub scaling: Scaling<'a>,
}

impl<'a> Blocks<'a> {
    /// Number of rows, without those that fill up the last block.
    #[inline]
    pub fn len(&self) -> usize {
        self.scaling.scale.len()
    }

    #[inline]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The blocks, four rows each: four columns of them at a time.
    #[inline]
    pub fn blocks(&self) -> impl Iterator<Item = &'a [[u8; BLOCK * BLOCK]]> {
        self.weights.chunks_exact(self.fours.max(1))
    }
}

/// What one state brings to the memory and to the mouth. Slices are empty where the chain does not own them.
#[derive(Clone, Copy, Debug)]
pub struct Gate<'a> {
    /// i8 two's complement `[H]`.
    pub gain: &'a [u8],
    /// i8 two's complement `[H]`.
    pub drive: &'a [u8],
    /// i8 two's complement `[D]`.
    pub offset: &'a [u8],
    /// Codes of [`crate::mge::rate`] `[H]`.
    pub rate: &'a [u8],
    /// Of gain, drive and offset, LSB 2⁻²⁴.
    pub scale: [i32; 3],
}

/// One row of a matrix with i16 mantissas: (Σ weight·input >> shift) ± offset.
#[derive(Clone, Copy, Debug)]
pub struct SumRow<'a> {
    pub weights: I16s<'a>,
    /// At most 40.
    pub shift: u32,
    /// Within ±2³⁰.
    pub offset: i32,
}

/// One row of a residual map.
#[derive(Clone, Copy, Debug)]
pub struct StateRow<'a> {
    /// i8 two's complement, `[X]`
    pub weights: &'a [u8],
    /// Q8.8: parameter LSBs per unit of x and LSB of the weights.
    pub scale: u16,
    /// Parameter LSBs.
    pub bias: i16,
}
