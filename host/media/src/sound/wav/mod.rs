//! WAV: integers of 8 to 64 bits, floats of 32 and 64, A-law and µ-law, plain or extensible; RF64 and BW64.
//!
//! The chunks are walked here, strictly where sound could be lost: a chunk that is longer than the file is refused, and so are bytes between chunks
//! that belong to none. The length of the whole file, which players do not look at either, is not held against it, and what follows its end is
//! a tag of some other program's. Chunks besides `fmt `, `ds64` and `data` (LIST, bext, id3, …) are passed over.
use super::input::Input;
use super::{Decode, Result, SoundError, damaged};

mod coding;

use coding::Format;

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
    format: Format,
    /// Where the file ends, where its header says so: chunks are looked for up to there.
    ends: Option<u64>,
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
        let ends = (!not_known(size, &input)).then_some(8 + u64::from(size));
        let (mut format, mut long) = (None, None);
        let left = loop {
            let Some(chunk) = Chunk::next(&mut input)? else {
                return without(if format.is_none() { "fmt " } else { "data" });
            };
            match &chunk.name {
                b"fmt " if format.is_some() => return chunk.second(),
                b"fmt " => format = Some(Format::parse(&chunk.body(&mut input)?)?),
                b"ds64" => {
                    let body = chunk.body(&mut input)?;
                    // The length of the file, then that of the samples, 8 bytes each.
                    long = body
                        .get(8..16)
                        .map(|b| b.iter().rev().fold(0, |sum, &b| sum << 8 | u64::from(b)));
                }
                b"data" => match long.filter(|samples| *samples > 0) {
                    Some(samples) if chunk.size == NOT_KNOWN => {
                        chunk.check(samples, &input)?;
                        break Some(samples);
                    }
                    _ if not_known(chunk.size, &input)
                        && (chunk.size == NOT_KNOWN || input.length().is_none() || ends.is_none()) =>
                    {
                        break None;
                    }
                    _ if chunk.size == 0 && (nothing_said(ends, &input) || !a_chunk_follows(&mut input)?) => {
                        break None;
                    }
                    _ => {
                        chunk.check(u64::from(chunk.size), &input)?;
                        break Some(u64::from(chunk.size));
                    }
                },
                _ => chunk.skip(&mut input)?,
            }
        };
        let Some(format) = format else {
            return damaged(format!(
                "damaged WAV file: there is no chunk 'fmt ' before its samples at byte {}, which says how they are written",
                input.at()
            ));
        };
        let block = format.block() as u64;
        if let Some(odd) = left.filter(|left| left % block != 0) {
            return damaged(format!(
                "{odd} bytes of samples are not a multiple of the {block} that one of every channel takes: the file is cut short, or the header lies"
            ));
        }
        Ok(Self {
            input,
            format,
            ends,
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
        if self.padded {
            fill_up(&mut self.input)?;
        }
        while self.ends.is_none_or(|ends| self.input.at() < ends)
            && let Some(chunk) = Chunk::next(&mut self.input)?
        {
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
        self.format.rate_hz
    }

    fn channels(&self) -> usize {
        self.format.channels
    }

    fn next(&mut self, out: &mut Vec<f64>) -> Result<bool> {
        let most = PIECE * self.format.block();
        let wanted = self.left.map_or(most, |left| left.min(most as u64) as usize);
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
        let block = self.format.block();
        if read % block != 0 {
            return damaged(format!(
                "the last {} bytes are not a multiple of the {block} that one sample of every channel takes: the sound is cut short",
                read % block
            ));
        }
        self.format.decode(&self.bytes, self.decoded, out)?;
        self.decoded += (read / block * self.format.channels) as u64;
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

    /// Whether the input is long enough for the `size` bytes of the chunk's body, where the input's length is known.
    fn check(&self, size: u64, input: &Input) -> Result<()> {
        match input.length() {
            Some(length) => self.whole(size, length.saturating_sub(input.at())),
            None => Ok(()),
        }
    }

    /// Its body, of which the first bytes are enough; takes all of it.
    fn body(&self, input: &mut Input) -> Result<Vec<u8>> {
        let size = u64::from(self.size);
        self.check(size, input)?;
        let mut body = Vec::new();
        input.append(size.min(MOST_FORMAT) as usize, &mut body)?;
        let more = input.skip(size.saturating_sub(MOST_FORMAT))?;
        self.whole(size, body.len() as u64 + more)?;
        if size % 2 == 1 {
            fill_up(input)?;
        }
        Ok(body)
    }

    /// Whether the `follow` bytes that are there are enough for `size`.
    fn whole(&self, size: u64, follow: u64) -> Result<()> {
        if follow >= size {
            return Ok(());
        }
        damaged(format!(
            "the header of chunk '{}' at byte {} promises {size} bytes, {follow} follow: the file is cut short, or the header lies",
            self.name.escape_ascii(),
            self.at
        ))
    }

    /// Passes over its body.
    fn skip(&self, input: &mut Input) -> Result<()> {
        let size = u64::from(self.size);
        self.check(size, input)?;
        self.whole(size, input.skip(size)?)?;
        if size % 2 == 1 {
            fill_up(input)?;
        }
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

/// Chunks that writers put into sound files.
const KNOWN: [&[u8; 4]; 14] = [
    b"data", b"fmt ", b"LIST", b"fact", b"bext", b"cue ", b"smpl", b"JUNK", b"junk", b"id3 ", b"ID3 ",
    b"iXML", b"_PMX", b"PEAK",
];

/// Passes over the byte behind a chunk of odd length, since chunks begin at even places; some writers leave it out, and the next chunk's name is there.
fn fill_up(input: &mut Input) -> Result<()> {
    let next_begins = KNOWN
        .iter()
        .any(|name| input.peek(4).is_ok_and(|next| next == *name));
    input.skip(u64::from(!next_begins))?;
    Ok(())
}

/// Whether what comes next is a chunk that ends within the input, or nothing, in a file whose length is known.
fn a_chunk_follows(input: &mut Input) -> Result<bool> {
    let Some(length) = input.length() else {
        return Ok(true);
    };
    let ends = length.saturating_sub(input.at() + 8);
    let head = input.peek(8)?;
    Ok(head.is_empty()
        || (head.len() == 8
            && head[..4].iter().all(|c| (b' '..=b'~').contains(c))
            && u64::from(little_endian(&head[4..])) <= ends))
}

/// Whether a size says that its writer did not know it. On a pipe, and in a file that came out of one and is shorter, that may be said in several
/// ways.
fn not_known(size: u32, input: &Input) -> bool {
    match input.length() {
        None => size == 0 || size >= NEARLY_ENDLESS,
        Some(length) => size == NOT_KNOWN || (size >= NEARLY_ENDLESS && length < u64::from(NEARLY_ENDLESS)),
    }
}

/// Whether the file's length was left out as well, or is that of the header alone, and yet something follows.
fn nothing_said(ends: Option<u64>, input: &Input) -> bool {
    ends.is_none_or(|ends| ends <= input.at()) && input.length().is_some_and(|length| length > input.at())
}

fn little_endian(bytes: &[u8]) -> u32 {
    bytes
        .iter()
        .rev()
        .fold(0, |sum, &byte| sum << 8 | u32::from(byte))
}
