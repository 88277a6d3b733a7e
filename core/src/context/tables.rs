//! The sections of a context: its taps and the projection.
use crate::N_STATIC;
use crate::model::container::{Section, Sections, check};
use crate::model::{I16s, ModelError, i32s, put_i16s, put_i32s};

/// i8 `[T]`: hops relative to the frame, increasing, −40..=16.
pub const TAPS: Section = Section::new(0x200, "Taps");
/// i16 `[X][13(T + M)]`: mantissas of the projection, M exponential means of the kind that has them; the sizes of a row's add up
/// to less than 2¹⁶.
pub const PROJECTION: Section = Section::new(0x201, "Projection");
/// u8 `[X]`: the sum of a row is shifted down by this.
pub const PROJECTION_SHIFT: Section = Section::new(0x202, "ProjectionShift");
/// i32 `[X]`: then taken off, in the LSB of what the kind's maps read.
pub const PROJECTION_OFFSET: Section = Section::new(0x203, "ProjectionOffset");

/// Most taps of a context.
pub const MAX_TAPS: usize = 32;
/// Most exponential means of a context.
pub const MAX_MEANS: usize = 6;
/// Most numbers that a context is projected to.
pub const MAX_INPUTS: usize = 96;
/// Earliest context tap, hops.
pub const FIRST_TAP: i8 = -40;
/// Latest context tap, hops.
pub const LAST_TAP: i8 = 16;
/// Largest right shift of a sum.
pub const MAX_SHIFT: u8 = 40;
/// Largest |bias| or |offset| of a sum.
pub const MAX_OFFSET: i32 = 1 << 30;

/// Where a context is taken, and what it is projected to.
#[derive(Clone, Copy, Debug)]
pub struct ContextTables<'a> {
    taps: &'a [u8],
    projection: SumRows<'a>,
}

impl<'a> ContextTables<'a> {
    /// Takes the sections of a context with `means` exponential means besides the taps.
    pub(crate) fn read(sections: &mut Sections<'a>, means: usize) -> Result<Self, ModelError> {
        let (taps, n_taps) = sections.take_items(TAPS, 1, MAX_TAPS)?;
        let mut last = i16::from(FIRST_TAP) - 1;
        check(
            TAPS,
            taps.iter().map(|b| {
                let tap = *b as i8;
                let good = i16::from(tap) > last && tap <= LAST_TAP;
                last = i16::from(tap);
                good
            }),
        )?;
        let width = N_STATIC * (n_taps + means);
        let names = [PROJECTION, PROJECTION_SHIFT, PROJECTION_OFFSET];
        let projection = SumRows::read(sections, names, None, width)?;
        // Sums in 32 bits: 2¹⁵ times less than 2¹⁶.
        check(
            PROJECTION,
            projection.iter().map(|row| {
                let sizes = row.weights.iter().map(|w| u32::from(w.unsigned_abs()));
                sizes.sum::<u32>() < 1 << 16
            }),
        )?;
        Ok(Self { taps, projection })
    }

    /// Context taps in hops relative to the frame, increasing, −40..=16.
    #[inline]
    pub fn taps(&self) -> impl DoubleEndedIterator<Item = i8> + ExactSizeIterator + use<'a> {
        self.taps.iter().map(|b| *b as i8)
    }

    /// The latest tap, hops after the frame; 0 if all lie before it.
    pub fn look_ahead(&self) -> usize {
        self.taps()
            .next_back()
            .map_or(0, |t| usize::from(t.max(0).unsigned_abs()))
    }

    /// X, numbers that a context is projected to.
    #[inline]
    pub fn n_inputs(&self) -> usize {
        self.projection.shift.len()
    }

    /// Numbers in a context: 13(T + M).
    #[inline]
    pub fn size(&self) -> usize {
        self.projection.width
    }

    /// Rows of the projection: mantissas `[13(T + M)]`, shift, offset.
    #[inline]
    pub fn projection(&self) -> impl Iterator<Item = SumRow<'a>> + use<'a> {
        self.projection.iter()
    }
}

/// Writes [`TAPS`].
pub fn put_taps(to: &mut impl Extend<u8>, taps: impl IntoIterator<Item = i8>) {
    to.extend(taps.into_iter().map(|tap| tap as u8));
}

/// Rows of a matrix with i16 mantissas, a shift and an offset a row.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SumRows<'a> {
    weights: &'a [u8],
    shift: &'a [u8],
    offset: &'a [u8],
    width: usize,
}

/// One row of a matrix with i16 mantissas: (Σ weight·input >> shift) ± offset.
#[derive(Clone, Copy, Debug)]
pub struct SumRow<'a> {
    /// Mantissas, as many as the matrix has columns.
    pub weights: I16s<'a>,
    /// At most 40.
    pub shift: u32,
    /// Within ±2³⁰.
    pub offset: i32,
}

impl<'a> SumRows<'a> {
    /// Takes the three sections of `rows` rows of `width` mantissas; of 1 to [`MAX_INPUTS`] rows where their number is not known.
    pub(crate) fn read(
        sections: &mut Sections<'a>,
        [weights, shift, offset]: [Section; 3],
        rows: Option<usize>,
        width: usize,
    ) -> Result<Self, ModelError> {
        let (shifts, rows) = match rows {
            Some(rows) => (sections.take_sized(shift, rows)?, rows),
            None => sections.take_items(shift, 1, MAX_INPUTS)?,
        };
        let out = Self {
            weights: sections.take_sized(weights, 2 * rows * width)?,
            shift: shifts,
            offset: sections.take_sized(offset, 4 * rows)?,
            width,
        };
        check(shift, out.shift.iter().map(|s| *s <= MAX_SHIFT))?;
        check(
            offset,
            i32s(out.offset).map(|v| (-MAX_OFFSET..=MAX_OFFSET).contains(&v)),
        )?;
        Ok(out)
    }

    #[inline]
    pub(crate) fn iter(&self) -> impl Iterator<Item = SumRow<'a>> + use<'a> {
        self.weights
            .chunks_exact(2 * self.width)
            .zip(self.shift)
            .zip(self.offset.as_chunks().0)
            .map(|((weights, shift), offset)| SumRow {
                weights: I16s(weights),
                shift: u32::from(*shift),
                offset: i32::from_le_bytes(*offset),
            })
    }
}

/// Writes one row of a matrix with i16 mantissas into its three sections: weights, shifts, offsets.
pub fn put_sum_row<E: Extend<u8>>(
    [weights, shifts, offsets]: [&mut E; 3],
    row: impl IntoIterator<Item = i16>,
    shift: u8,
    offset: i32,
) {
    put_i16s(weights, row);
    shifts.extend([shift]);
    put_i32s(offsets, [offset]);
}
