//! Tables that are tampered with, and what a stream makes of them.
use lipstream_core::model::Model;
use lipstream_core::model::field::{CRC_SIZE, Section, checksum, entry, header};
use lipstream_core::stream::{Settings, Stream};

/// Puts the checksum right.
pub(crate) fn seal(bytes: &mut [u8]) {
    let end = bytes.len() - CRC_SIZE;
    let crc = checksum(&bytes[..end]);
    bytes[end..].copy_from_slice(&crc.to_le_bytes());
}

/// Where a section stands.
pub(crate) fn section(bytes: &[u8], section: Section) -> std::ops::Range<usize> {
    let base = header::SIZE + section as usize * entry::SIZE;
    let word = |at: usize| u32::from_le_bytes(bytes[base + at..base + at + 4].try_into().unwrap()) as usize;
    word(entry::OFFSET)..word(entry::OFFSET) + word(entry::LENGTH)
}

/// A stream over all of `samples`, to its end; if the tables have visual densities, with feedback too.
pub(crate) fn hear_out(model: &Model, samples: &[i16]) {
    let ways = match model.has_visual_densities() {
        true => &[None, Some(0), Some(1 << 16)][..],
        false => &[None],
    };
    for &feedback in ways {
        let settings = Settings {
            feedback,
            ..Settings::default()
        };
        let mut stream = Stream::new(model, settings);
        let mut rest = samples;
        while !rest.is_empty() {
            rest = &rest[stream.push(rest).0..];
        }
        while stream.finish().is_some() {}
    }
}
