//! Tables that are tampered with, and what a stream makes of them.
use lipstream_core::model::Section;
use lipstream_core::model::container::{self, CRC_SIZE, checksum, entry, header};
use lipstream_core::settings::Setting;
use lipstream_core::{AnyModel, AnyStream, StreamSettings};

/// Puts the checksum right.
pub(crate) fn seal(bytes: &mut [u8]) {
    let end = bytes.len() - CRC_SIZE;
    let crc = checksum(&bytes[..end]);
    bytes[end..].copy_from_slice(&crc.to_le_bytes());
}

/// Sections of a block.
pub(crate) fn n_sections(bytes: &[u8]) -> usize {
    usize::from(word16(bytes, header::N_SECTIONS))
}

/// Tag and place of a section by its place in the table.
pub(crate) fn nth(bytes: &[u8], n: usize) -> (u16, std::ops::Range<usize>) {
    let base = header::SIZE + n * entry::SIZE;
    let offset = word32(bytes, base + entry::OFFSET) as usize;
    let length = word32(bytes, base + entry::LENGTH) as usize;
    (word16(bytes, base + entry::TAG), offset..offset + length)
}

/// Where a section stands.
pub(crate) fn section(bytes: &[u8], section: Section) -> std::ops::Range<usize> {
    (0..n_sections(bytes))
        .map(|n| nth(bytes, n))
        .find(|(tag, _)| *tag == section.tag)
        .unwrap_or_else(|| panic!("no section {}", section.name))
        .1
}

/// The block with another content of one section: none takes it out.
pub(crate) fn replaced(bytes: &[u8], section: Section, content: Option<&[u8]>) -> Vec<u8> {
    let sections: Vec<(Section, &[u8])> = (0..n_sections(bytes))
        .map(|n| nth(bytes, n))
        .filter_map(|(tag, place)| match tag == section.tag {
            true => content.map(|content| (section, content)),
            false => Some((Section::new(tag, ""), &bytes[place])),
        })
        .collect();
    let mut out = Vec::new();
    container::write(word16(bytes, header::KIND), &sections, &mut out);
    out
}

fn word16(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes(bytes[at..at + 2].try_into().unwrap())
}

fn word32(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
}

/// A stream over all of `samples`, to its end; if the tables have visual densities, with feedback too.
pub(crate) fn hear_out(model: &AnyModel, samples: &[i16]) {
    let ways = match model.understands(Setting::Feedback) {
        true => &[None, Some(0), Some(1 << 16)][..],
        false => &[None],
    };
    for &feedback in ways {
        let settings = StreamSettings {
            feedback,
            ..StreamSettings::default()
        };
        let mut stream = AnyStream::new(model, settings);
        let mut rest = samples;
        while !rest.is_empty() {
            rest = &rest[stream.push(rest).0..];
        }
        while stream.finish().is_some() {}
    }
}
