//! FLAC through claxon, which checks every frame's CRC.
use claxon::{Block, FlacReader};

use super::{Decoded, Result, damaged, library};

/// Decodes a whole FLAC file.
pub(super) fn decode(bytes: &[u8]) -> Result<Decoded> {
    let mut reader = FlacReader::new(bytes).map_err(library("damaged FLAC header"))?;
    let info = reader.streaminfo();
    let channels = info.channels as usize;
    let scale = 2f64.powi(1 - info.bits_per_sample as i32) / channels as f64;
    let mut samples = Vec::new();
    let mut frames = reader.blocks();
    let mut block = Block::empty();
    loop {
        let next = frames.read_next_or_eof(block.into_buffer());
        let Some(read) = next.map_err(|e| {
            library(format!(
                "damaged or cut short after {} samples{}",
                samples.len(),
                of(info.samples)
            ))(e)
        })?
        else {
            break;
        };
        block = read;
        if block.channels() as usize != channels {
            return damaged(format!(
                "{} channels turn into {} after {} samples",
                channels,
                block.channels(),
                samples.len()
            ));
        }
        samples.extend((0..block.duration()).map(|n| {
            let sum: f64 = (0..info.channels).map(|c| f64::from(block.sample(c, n))).sum();
            sum * scale
        }));
    }
    if info
        .samples
        .is_some_and(|promised| promised != samples.len() as u64)
    {
        return damaged(format!(
            "the FLAC header promises{} samples, the file has {}: it is cut short, or the header lies",
            of(info.samples).trim_start_matches(" of"),
            samples.len()
        ));
    }
    Ok(Decoded {
        samples,
        rate_hz: info.sample_rate,
        channels,
    })
}

/// " of N" where the header says how many samples there are.
fn of(samples: Option<u64>) -> String {
    samples.map_or(String::new(), |n| format!(" of {n}"))
}
