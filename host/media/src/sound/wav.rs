//! WAV: 8, 16, 24 and 32 bit integers, 32 bit floats.
//!
//! The chunks are walked here, strictly: a file whose lengths contradict each other is refused, and so are bytes that
//! belong to no chunk. Chunks besides `fmt ` and `data` (LIST, bext, id3, …) are passed over. Samples are decoded by hound.
use std::io::{Cursor, Read};

use hound::{SampleFormat, WavReader, WavSpec};

use super::input::Input;
use super::{Decode, Result, SoundError, damaged, library, mix_down};

/// Frames (one sample of every channel) that are decoded at a time.
const PIECE: usize = 8192;
/// Bytes of the longest `fmt ` chunk that is read; the longest in use has 40.
const MOST_FORMAT: u64 = 4096;
/// A writer to a pipe cannot go back to say how long the sound has become. It leaves all ones, or, as sox and arecord do, about the
/// largest signed number.
const NOT_KNOWN: u32 = u32::MAX;
const NEARLY_ENDLESS: u32 = 0x7fff_0000;

/// A WAV file whose samples come next.
pub(super) struct Wav<'a> {
    input: Input<'a>,
    /// The body of the `fmt ` chunk, as hound likes it.
    format: Vec<u8>,
    spec: WavSpec,
    /// Bytes of samples that are still to come; None: to the end of the input.
    left: Option<u64>,
    /// Whether the data's length is odd, so that a byte fills it up.
    padded: bool,
    /// Samples decoded so far, all channels counted.
    decoded: u64,
    bytes: Vec<u8>,
}

impl<'a> Wav<'a> {
    /// Walks the chunks up to the samples.
    pub(super) fn open(mut input: Input<'a>) -> Result<Self> {
        let mut header = Vec::new();
        input.append(12, &mut header)?;
        if header.len() < 12 {
            return damaged(format!(
                "damaged WAV header: {} bytes are too few for one",
                header.len()
            ));
        }
        if &header[8..12] != b"WAVE" {
            return Err(SoundError::Unsupported("a RIFF file, but not WAV".to_owned()));
        }
        let size = little_endian(&header[4..8]);
        if !not_known(size, &input) {
            check_length(8 + u64::from(size), input.length())?;
        }
        let mut format = None;
        let left = loop {
            let Some(chunk) = Chunk::next(&mut input)? else {
                return without(if format.is_none() { "fmt " } else { "data" });
            };
            match &chunk.name {
                b"fmt " if format.is_some() => return chunk.second(),
                b"fmt " => {
                    chunk.check(&input)?;
                    let mut body = Vec::new();
                    input.append(u64::from(chunk.size).min(MOST_FORMAT) as usize, &mut body)?;
                    chunk.whole(
                        body.len() as u64 + input.skip(u64::from(chunk.size).saturating_sub(MOST_FORMAT))?,
                    )?;
                    input.skip(u64::from(chunk.size % 2))?;
                    format = Some(body);
                }
                b"data" if not_known(chunk.size, &input) => break None,
                b"data" => {
                    chunk.check(&input)?;
                    break Some(u64::from(chunk.size));
                }
                _ => chunk.skip(&mut input)?,
            }
        };
        let Some(mut format) = format else {
            return without("fmt ");
        };
        // What follows in chunks of plain integers (1) and floats (3) says nothing, and hound is particular about it.
        if let [1 | 3, 0, ..] = format[..] {
            format.truncate(16);
        }
        let spec = reader(&format, left.unwrap_or(0), &[])?.spec();
        Ok(Self {
            input,
            format,
            spec,
            left,
            padded: left.is_some_and(|n| n % 2 == 1),
            decoded: 0,
            bytes: Vec::new(),
        })
    }

    /// What follows the samples must be whole chunks.
    fn end(&mut self) -> Result<()> {
        if self.left.is_none() {
            return Ok(());
        }
        self.input.skip(u64::from(self.padded))?;
        while let Some(chunk) = Chunk::next(&mut self.input)? {
            if matches!(&chunk.name, b"fmt " | b"data") {
                return chunk.second();
            }
            chunk.skip(&mut self.input)?;
        }
        Ok(())
    }
}

impl Decode for Wav<'_> {
    fn rate_hz(&self) -> u32 {
        self.spec.sample_rate
    }

    fn channels(&self) -> usize {
        usize::from(self.spec.channels)
    }

    fn next(&mut self, out: &mut Vec<f64>) -> Result<bool> {
        let frame = usize::from(self.spec.channels) * usize::from(self.spec.bits_per_sample.div_ceil(8));
        let wanted = self
            .left
            .map_or(PIECE * frame, |left| left.min((PIECE * frame) as u64) as usize);
        self.bytes.clear();
        let read = self.input.append(wanted, &mut self.bytes)?;
        if let Some(left) = &mut self.left {
            *left -= read as u64;
            if read < wanted {
                return damaged(format!(
                    "the header promises {} bytes of samples more than there are: the file is cut short, or the header lies",
                    *left
                ));
            }
        }
        if read == 0 {
            self.end()?;
            return Ok(false);
        }
        let reader = reader(&self.format, read as u64, &self.bytes)?;
        let at = self.decoded;
        let interleaved: Vec<f64> = match self.spec.sample_format {
            SampleFormat::Int => {
                let full_scale = 2f64.powi(i32::from(self.spec.bits_per_sample) - 1);
                reader
                    .into_samples::<i32>()
                    .map(|s| Ok(f64::from(s?) / full_scale))
                    .collect::<Result<_>>()
            }
            SampleFormat::Float => (at..)
                .zip(reader.into_samples::<f32>())
                .map(|(i, s)| match s? {
                    s if s.is_finite() => Ok(f64::from(s)),
                    _ => damaged(format!("sample {i} is not a finite number")),
                })
                .collect(),
        }?;
        self.decoded += interleaved.len() as u64;
        mix_down(&interleaved, usize::from(self.spec.channels), out);
        Ok(true)
    }
}

/// The head of a chunk.
struct Chunk {
    name: [u8; 4],
    size: u32,
    at: u64,
}

impl Chunk {
    /// Reads the next chunk's head; None at the end.
    fn next(input: &mut Input) -> Result<Option<Self>> {
        let at = input.at();
        let mut head = Vec::new();
        match input.append(8, &mut head)? {
            0 => return Ok(None),
            8 => {}
            few => return damaged(format!("{few} stray bytes at byte {at}, after the last chunk")),
        }
        let name = [head[0], head[1], head[2], head[3]];
        if !name.iter().all(|c| (b' '..=b'~').contains(c)) {
            return damaged(format!(
                "garbage at byte {at}, where a chunk of the WAV file should begin"
            ));
        }
        let size = little_endian(&head[4..]);
        Ok(Some(Self { name, size, at }))
    }

    /// Whether the input is long enough for the chunk, where its length is known.
    fn check(&self, input: &Input) -> Result<()> {
        match input.length() {
            Some(length) => self.whole(length.saturating_sub(input.at())),
            None => Ok(()),
        }
    }

    /// Whether `follow` bytes are enough for its body.
    fn whole(&self, follow: u64) -> Result<()> {
        if follow >= u64::from(self.size) {
            return Ok(());
        }
        damaged(format!(
            "the header of chunk '{}' at byte {} promises {} bytes, {follow} follow: the file is cut short, or the header lies",
            self.name.escape_ascii(),
            self.at,
            self.size
        ))
    }

    /// Passes over its body.
    fn skip(&self, input: &mut Input) -> Result<()> {
        self.check(input)?;
        self.whole(input.skip(u64::from(self.size))?)?;
        // Chunks begin at even places.
        input.skip(u64::from(self.size % 2))?;
        Ok(())
    }

    fn second<T>(&self) -> Result<T> {
        damaged(format!(
            "a second chunk '{}' at byte {}",
            self.name.escape_ascii(),
            self.at
        ))
    }
}

fn without<T>(name: &str) -> Result<T> {
    damaged(format!("damaged WAV file: it has no chunk '{name}'"))
}

/// Whether a size says that its writer did not know it. On a pipe that may be said in several ways.
fn not_known(size: u32, input: &Input) -> bool {
    size == NOT_KNOWN || (input.length().is_none() && (size == 0 || size >= NEARLY_ENDLESS))
}

/// Holds the length that the header promises against the file's.
fn check_length(promised: u64, length: Option<u64>) -> Result<()> {
    let Some(length) = length else { return Ok(()) };
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
    Ok(())
}

/// Hound's reader of `samples`, of which a file of this format is to hold `length` bytes.
fn reader<'b>(format: &[u8], length: u64, samples: &'b [u8]) -> Result<WavReader<impl Read + use<'b>>> {
    let mut header = b"RIFF\0\0\0\0WAVEfmt ".to_vec();
    header.extend((format.len() as u32).to_le_bytes());
    header.extend(format);
    header.extend(b"data");
    header.extend((length as u32).to_le_bytes());
    WavReader::new(Cursor::new(header).chain(samples)).map_err(library("damaged or unusual WAV header"))
}

fn little_endian(bytes: &[u8]) -> u32 {
    bytes
        .iter()
        .rev()
        .fold(0, |sum, &byte| sum << 8 | u32::from(byte))
}
