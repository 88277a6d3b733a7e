//! WAV: 8, 16, 24 and 32 bit integers, 32 bit floats.
//!
//! The chunks are walked here, strictly: a file whose lengths contradict each other is refused, and so are bytes that
//! belong to no chunk. Chunks besides `fmt ` and `data` (LIST, bext, id3, …) are passed over. Samples are decoded by hound.
use std::io::{Cursor, Read};

use hound::{SampleFormat, WavReader};

use super::{Decoded, Result, SoundError, damaged, library, mix_down};

/// What of a WAV file matters.
struct Parts<'a> {
    format: &'a [u8],
    data: &'a [u8],
}

/// Walks the chunks of a RIFF file from end to end.
fn parts(bytes: &[u8]) -> Result<Parts<'_>> {
    let Some((header, mut rest)) = bytes.split_at_checked(12) else {
        return damaged(format!(
            "damaged WAV header: {} bytes are too few for one",
            bytes.len()
        ));
    };
    if &header[8..12] != b"WAVE" {
        return Err(SoundError::Unsupported("a RIFF file, but not WAV".to_owned()));
    }
    let promised = 8 + u64::from(little_endian(&header[4..8]));
    let length = bytes.len() as u64;
    if promised > length {
        return damaged(format!(
            "the WAV header promises {promised} bytes, the file has {length}: it is cut short, or the header lies"
        ));
    }
    // One byte more pads a last chunk of odd length whose writer forgot to count it.
    if promised + u64::from(promised % 2 == 1) < length {
        return damaged(format!(
            "the WAV header says that the file ends at byte {promised}, but {} more bytes follow",
            length - promised
        ));
    }
    let (mut format, mut data) = (None, None);
    while !rest.is_empty() {
        let at = bytes.len() - rest.len();
        let Some((head, body)) = rest.split_at_checked(8) else {
            return damaged(format!(
                "{} stray bytes at byte {at}, after the last chunk",
                rest.len()
            ));
        };
        let (name, size) = (&head[..4], little_endian(&head[4..]) as usize);
        if !name.iter().all(|c| (b' '..=b'~').contains(c)) {
            return damaged(format!(
                "garbage at byte {at}, where a chunk of the WAV file should begin"
            ));
        }
        let Some((body, after)) = body.split_at_checked(size) else {
            return damaged(format!(
                "the header of chunk '{}' at byte {at} promises {size} bytes, {} follow: the file is cut short, \
                 or the header lies",
                name.escape_ascii(),
                body.len()
            ));
        };
        let slot = match name {
            b"fmt " => &mut format,
            b"data" => &mut data,
            _ => &mut None,
        };
        if slot.replace(body).is_some() {
            return damaged(format!("a second chunk '{}' at byte {at}", name.escape_ascii()));
        }
        // Chunks begin at even places.
        rest = after.get(size % 2..).unwrap_or_default();
    }
    let without = |name| SoundError::Damaged(format!("damaged WAV file: it has no chunk '{name}'"));
    Ok(Parts {
        format: format.ok_or_else(|| without("fmt "))?,
        data: data.ok_or_else(|| without("data"))?,
    })
}

fn little_endian(bytes: &[u8]) -> u32 {
    bytes
        .iter()
        .rev()
        .fold(0, |sum, &byte| sum << 8 | u32::from(byte))
}

/// Decodes a whole WAV file.
pub(super) fn decode(bytes: &[u8]) -> Result<Decoded> {
    let Parts { mut format, data } = parts(bytes)?;
    // What follows in chunks of plain integers (1) and floats (3) says nothing, and hound is particular about it.
    if let [1 | 3, 0, ..] = format {
        format = format.get(..16).unwrap_or(format);
    }
    if data.is_empty() {
        return Err(SoundError::NoSamples);
    }
    let mut header = b"RIFF\0\0\0\0WAVEfmt ".to_vec();
    header.extend((format.len() as u32).to_le_bytes());
    header.extend(format);
    header.extend(b"data");
    header.extend((data.len() as u32).to_le_bytes());
    let reader =
        WavReader::new(Cursor::new(header).chain(data)).map_err(library("damaged or unusual WAV header"))?;
    let spec = reader.spec();
    let interleaved: Vec<f64> = match spec.sample_format {
        SampleFormat::Int => {
            let full_scale = 2f64.powi(i32::from(spec.bits_per_sample) - 1);
            reader
                .into_samples::<i32>()
                .map(|s| Ok(f64::from(s?) / full_scale))
                .collect::<Result<_>>()
        }
        SampleFormat::Float => reader
            .into_samples::<f32>()
            .enumerate()
            .map(|(i, s)| match s? {
                s if s.is_finite() => Ok(f64::from(s)),
                _ => damaged(format!("sample {i} is not a finite number")),
            })
            .collect(),
    }?;
    let channels = usize::from(spec.channels);
    Ok(Decoded {
        samples: mix_down(&interleaved, channels),
        rate_hz: spec.sample_rate,
        channels,
    })
}
