//! How far the lips are apart and how wide the mouth is, out of a frame's parameters: two straight lines, measured from a model's mouth on a host
//! (`lipstream::opening`) and carried by the calibration, since the model's tables know nothing of pictures.
//!
//! ```text
//! gap = offset + Σ slope_d · value_d / 2^shift        Q15, cut to 0 … 32767
//! ```
//!
//! In a calibration's table: model u32; then gap and width, each offset i32, shift u8, three bytes 0, slopes i16 `[D]`.
use super::bytes::{Bytes, Table};
use super::calibration::CalibrationError;
use crate::fixed::saturate_i16;
use crate::frame::MAX_PARAMETERS;

/// Most bits that slopes are shifted by.
const MOST_SHIFT: u8 = 30;
/// Farthest offset: eight times as wide open as ever.
const MOST_OFFSET: i32 = 1 << 18;
/// Bytes of a read-out for so many parameters.
pub(super) const fn size(parameters: usize) -> usize {
    4 + 2 * (8 + 2 * parameters)
}

/// A number that is linear in a frame's parameters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    offset: i32,
    shift: u8,
    slopes: heapless::Vec<i16, MAX_PARAMETERS>,
}

impl Line {
    /// `offset` in Q15 and a slope for each parameter in Q15 a parameter's LSB, divided by 2^`shift`; None where a number is out of range.
    pub fn of(offset: i32, shift: u8, slopes: &[i16]) -> Option<Self> {
        let slopes = heapless::Vec::from_slice(slopes).ok()?;
        let fits = shift <= MOST_SHIFT && offset.unsigned_abs() <= MOST_OFFSET.unsigned_abs();
        (fits && !slopes.is_empty()).then_some(Self {
            offset,
            shift,
            slopes,
        })
    }

    /// Q15, saturated. A missing parameter counts as 0.
    fn at(&self, values: &[i16]) -> i16 {
        // Products below 2³⁰, and at most 96 of them.
        let products = values.iter().zip(&self.slopes);
        let sum: i64 = products
            .map(|(v, s)| i64::from(i32::from(*v) * i32::from(*s)))
            .sum();
        let rounded = (sum + ((1 << self.shift) >> 1)) >> self.shift;
        // Below 2³⁸ with an offset of 19 bits.
        let whole = rounded + i64::from(self.offset);
        saturate_i16(whole.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32)
    }

    fn put(&self, to: &mut Table) {
        to.put(&self.offset.to_le_bytes());
        to.put(&[self.shift, 0, 0, 0]);
        for slope in &self.slopes {
            to.put(&slope.to_le_bytes());
        }
    }

    /// None where the bytes end.
    fn read(from: &mut Bytes, parameters: usize) -> Option<Result<Self, CalibrationError>> {
        let offset = i32::from_le_bytes(from.take()?);
        let [shift, a, b, c] = from.take()?;
        let mut slopes = heapless::Vec::<i16, MAX_PARAMETERS>::new();
        for _ in 0..parameters {
            slopes.push(i16::from_le_bytes(from.take()?)).ok()?;
        }
        let line = Self::of(offset, shift, &slopes).filter(|_| [a, b, c] == [0; 3]);
        Some(line.ok_or(CalibrationError::ReadOut))
    }
}

/// Reads gap and width out of the parameters of one model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReadOut {
    model: u32,
    gap: Line,
    width: Line,
}

impl ReadOut {
    /// For the model of this number; None where the lines are of different numbers of parameters.
    pub fn of(model: u32, gap: Line, width: Line) -> Option<Self> {
        (gap.slopes.len() == width.slopes.len()).then_some(Self { model, gap, width })
    }

    /// Number of the model whose parameters it reads.
    pub fn model(&self) -> u32 {
        self.model
    }

    /// D, parameters of a frame.
    pub fn n_parameters(&self) -> usize {
        self.gap.slopes.len()
    }

    /// Gap and width of a frame's parameters `[D]`, Q15 as [`Mouth`](super::Mouth) wants them.
    pub fn read(&self, values: &[i16]) -> (i16, i16) {
        let width = self.width.at(values).max(-i16::MAX);
        (self.gap.at(values).max(0), width)
    }

    pub(super) fn put(&self, to: &mut Table) {
        to.put(&self.model.to_le_bytes());
        self.gap.put(to);
        self.width.put(to);
    }

    /// None where the bytes end.
    pub(super) fn parse(from: &mut Bytes, parameters: usize) -> Option<Result<Self, CalibrationError>> {
        let model = u32::from_le_bytes(from.take()?);
        let gap = Line::read(from, parameters)?;
        let width = Line::read(from, parameters)?;
        let both = gap.and_then(|gap| Ok((gap, width?)));
        Some(both.and_then(|(gap, width)| Self::of(model, gap, width).ok_or(CalibrationError::ReadOut)))
    }
}
