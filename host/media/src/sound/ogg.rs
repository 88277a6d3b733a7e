//! Ogg Vorbis through lewton; the pages' CRCs are checked by its Ogg reader.
use std::io::Cursor;

use lewton::inside_ogg::OggStreamReader;
use lewton::samples::InterleavedSamples;

use super::{Decoded, Result, SoundError, damaged, library, mix_down};

/// Bytes of a page before its segment table.
const PAGE_HEADER: usize = 27;
/// Flag of a stream's last page.
const LAST: u8 = 4;
/// The codec that is decoded, as [`codec`] names it.
pub(super) const VORBIS: &str = "Vorbis";

/// Walks the pages from end to end: they must follow each other and end with a last one, which alone tells a file that was
/// cut between two pages from a whole one.
fn check_pages(bytes: &[u8]) -> Result<()> {
    let (mut at, mut flags) = (0, 0);
    while at < bytes.len() {
        let page = &bytes[at..];
        if !page.starts_with(b"OggS") && !b"OggS".starts_with(page) {
            return damaged(format!(
                "garbage at byte {at}, where a page of the Ogg file should begin"
            ));
        }
        let length = page.get(26).and_then(|&segments| {
            let table = page.get(PAGE_HEADER..PAGE_HEADER + usize::from(segments))?;
            Some(PAGE_HEADER + table.len() + table.iter().map(|&s| usize::from(s)).sum::<usize>())
        });
        match length {
            Some(length) if length <= page.len() => {
                at += length;
                flags = page[5];
            }
            _ => return damaged(format!("the Ogg page at byte {at} is cut short")),
        }
    }
    if flags & LAST == 0 {
        return damaged("the Ogg file ends without its last page: it is cut short");
    }
    Ok(())
}

/// What the first page's packet begins with says what the stream holds.
pub(super) fn codec(bytes: &[u8]) -> &'static str {
    let start = PAGE_HEADER + usize::from(bytes.get(26).copied().unwrap_or(0));
    match bytes.get(start..).unwrap_or_default() {
        [1, b'v', b'o', b'r', b'b', b'i', b's', ..] => VORBIS,
        [b'O', b'p', b'u', b's', ..] => "Opus",
        [0x7f, b'F', b'L', b'A', b'C', ..] => "FLAC",
        [b'S', b'p', b'e', b'e', b'x', ..] => "Speex",
        _ => "something unknown",
    }
}

/// Decodes a whole Ogg Vorbis file.
pub(super) fn decode(bytes: &[u8]) -> Result<Decoded> {
    match codec(bytes) {
        VORBIS => {}
        other => {
            return Err(SoundError::Unsupported(format!(
                "an Ogg file that holds {other}, not Vorbis (convert it with `ffmpeg -i FILE out.wav`)"
            )));
        }
    }
    check_pages(bytes)?;
    let mut reader = OggStreamReader::new(Cursor::new(bytes)).map_err(library("damaged Vorbis header"))?;
    let (rate_hz, channels) = (
        reader.ident_hdr.audio_sample_rate,
        reader.ident_hdr.audio_channels,
    );
    let serial = reader.stream_serial();
    let mut samples = Vec::new();
    while let Some(packet) = reader
        .read_dec_packet_generic::<InterleavedSamples<f32>>()
        .map_err(|e| library(format!("damaged after {} samples", samples.len()))(e))?
    {
        if reader.stream_serial() != serial {
            return damaged(format!("a second stream begins after {} samples", samples.len()));
        }
        let interleaved: Vec<f64> = packet.samples.iter().map(|&s| f64::from(s)).collect();
        samples.extend(mix_down(&interleaved, usize::from(channels)));
    }
    Ok(Decoded {
        samples,
        rate_hz,
        channels: usize::from(channels),
    })
}
