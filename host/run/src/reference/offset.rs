//! The zero of the sound, taken off a whole sound: `lipstream_core::frontend::offset` itself, since that is exact to a rounding.
use lipstream_core::frontend::offset::Offset;

/// Samples less their zero, as a stream hears them from its first sample on.
pub fn without_offset(samples: &[i16]) -> Vec<i16> {
    let mut out = vec![0; samples.len()];
    Offset::default().take_off(samples, &mut out);
    out
}
