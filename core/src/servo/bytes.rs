//! Bytes of a calibration's table, from the front and to the end.
use super::calibration::LONGEST_CALIBRATION;

/// Bytes from the front.
pub(super) struct Bytes<'a>(pub(super) &'a [u8]);

impl Bytes<'_> {
    /// None where they end.
    pub(super) fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (first, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*first)
    }

    pub(super) fn u16(&mut self) -> Option<u16> {
        self.take().map(u16::from_le_bytes)
    }
}

/// A table that is being written.
#[derive(Default)]
pub(super) struct Table(pub(super) heapless::Vec<u8, LONGEST_CALIBRATION>);

impl Table {
    /// Whatever a checked calibration has fits.
    pub(super) fn put(&mut self, piece: &[u8]) {
        let fits = self.0.extend_from_slice(piece);
        debug_assert!(fits.is_ok(), "LONGEST_CALIBRATION holds everything");
    }
}
