//! FLAC through claxon, which checks every frame's CRC.
use claxon::{Block, FlacReader};

use super::input::Input;
use super::{Decode, Result, damaged, library};

/// A FLAC file whose frames come next.
pub(super) struct Flac<'a> {
    reader: FlacReader<Input<'a>>,
    /// Samples decoded so far.
    decoded: u64,
    buffer: Vec<i32>,
}

impl<'a> Flac<'a> {
    pub(super) fn open(input: Input<'a>) -> Result<Self> {
        Ok(Self {
            reader: FlacReader::new(input).map_err(library("damaged FLAC header"))?,
            decoded: 0,
            buffer: Vec::new(),
        })
    }
}

impl Decode for Flac<'_> {
    fn rate_hz(&self) -> u32 {
        self.reader.streaminfo().sample_rate
    }

    fn channels(&self) -> usize {
        self.reader.streaminfo().channels as usize
    }

    fn next(&mut self, out: &mut Vec<f64>) -> Result<bool> {
        let info = self.reader.streaminfo();
        let channels = info.channels;
        let scale = 2f64.powi(1 - info.bits_per_sample as i32);
        let buffer = std::mem::take(&mut self.buffer);
        let next: Option<Block> = self.reader.blocks().read_next_or_eof(buffer).map_err(|e| {
            library(format!(
                "damaged or cut short after {} samples{}",
                self.decoded,
                of(info.samples)
            ))(e)
        })?;
        let Some(block) = next else {
            if info.samples.is_some_and(|promised| promised != self.decoded) {
                return damaged(format!(
                    "the FLAC header promises{} samples, the file has {}: it is cut short, or the header lies",
                    of(info.samples).trim_start_matches(" of"),
                    self.decoded
                ));
            }
            return Ok(false);
        };
        if block.channels() != channels {
            return damaged(format!(
                "{channels} channels turn into {} after {} samples",
                block.channels(),
                self.decoded
            ));
        }
        self.decoded += u64::from(block.duration());
        for n in 0..block.duration() {
            out.extend((0..channels).map(|c| f64::from(block.sample(c, n)) * scale));
        }
        self.buffer = block.into_buffer();
        Ok(true)
    }
}

/// " of N" where the header says how many samples there are.
fn of(samples: Option<u64>) -> String {
    samples.map_or(String::new(), |n| format!(" of {n}"))
}
