//! Ogg (RFC 3533) that holds Vorbis or Opus (RFC 7845): pages into packets, and packets into samples.
//!
//! Pages are held to what they say: their CRC, that none is missing, and that the last one is there, which alone tells a file that was cut between two
//! pages from a whole one. Where the sound begins and ends, inside a packet mostly, is said by the pages' granule positions.
use std::collections::VecDeque;

use symphonia::core::audio::Channels;
use symphonia::core::codecs::audio::AudioCodecParameters;
use symphonia::core::codecs::audio::well_known::CODEC_ID_VORBIS;

use super::codec::{Codec, Opus};
use super::input::Input;
use super::{Decode, Result, SoundError, damaged};

/// Bytes of a page before its segment table.
const PAGE_HEADER: usize = 27;
/// Flags of a page: it goes on with a packet, it is a stream's first, its last.
const GOES_ON: u8 = 1;
const FIRST: u8 = 2;
const LAST: u8 = 4;
/// The granule position of a page on which no packet ends.
const NO_GRANULE: u64 = u64::MAX;
/// Bytes of the longest packet that is read. Comments may hold pictures; sound takes a few kilobytes.
const MOST_PACKET: usize = 1 << 26;

/// What the first page's packet begins with says what the stream holds.
pub(super) fn codec(bytes: &[u8]) -> &'static str {
    let start = PAGE_HEADER + usize::from(bytes.get(26).copied().unwrap_or(0));
    match bytes.get(start..).unwrap_or_default() {
        [1, b'v', b'o', b'r', b'b', b'i', b's', ..] => VORBIS,
        [b'O', b'p', b'u', b's', ..] => OPUS,
        [0x7f, b'F', b'L', b'A', b'C', ..] => "FLAC",
        [b'S', b'p', b'e', b'e', b'x', ..] => "Speex",
        _ => "something unknown",
    }
}

const VORBIS: &str = "Vorbis";
const OPUS: &str = "Opus";

/// Whether what [`codec`] names is read here.
pub(super) fn reads(codec: &str) -> bool {
    matches!(codec, VORBIS | OPUS)
}

/// An Ogg file whose packets of sound come next.
pub(super) struct Ogg<'a> {
    packets: Packets<'a>,
    codec: Codec,
    /// Samples of every channel decoded so far, of which the first `skip` are still to be left out.
    decoded: u64,
    skip: u64,
    /// The granule position of the first sample decoded, once it is known.
    begins: Option<u64>,
}

impl<'a> Ogg<'a> {
    pub(super) fn open(mut input: Input<'a>) -> Result<Self> {
        let kind = codec(input.peek(PAGE_HEADER + 256 + 8)?);
        if !reads(kind) {
            return Err(SoundError::Unsupported(format!(
                "an Ogg file that holds {kind}, not Vorbis or Opus (convert it with `ffmpeg -i FILE out.wav`)"
            )));
        }
        let mut packets = Packets::new(input);
        let mut header = || {
            let next = packets.next()?.map(|packet| packet.bytes);
            next.ok_or_else(|| SoundError::Damaged(format!("the {kind} headers are cut short")))
        };
        let first = header()?;
        let comment = header()?;
        let codec = if kind == OPUS {
            check_comment(comment.strip_prefix(b"OpusTags"), kind)?;
            Codec::Opus(Box::new(Opus::new(&first)?))
        } else {
            check_comment(comment.strip_prefix(b"\x03vorbis"), kind)?;
            vorbis(first, &header()?)?
        };
        let skip = match &codec {
            Codec::Opus(opus) => opus.pre_skip,
            Codec::Other { .. } => 0,
        };
        Ok(Self {
            packets,
            codec,
            decoded: 0,
            skip,
            begins: None,
        })
    }
}

/// Vorbis's decoder, from the first of its headers, which says the rate (Vorbis I specification, section 4.2.2), and the third.
fn vorbis(mut first: Vec<u8>, setup: &[u8]) -> Result<Codec> {
    let Some(&[channels, r0, r1, r2, r3]) = first.get(11..16).and_then(|bytes| bytes.first_chunk()) else {
        return damaged("damaged Vorbis header");
    };
    let mut parameters = AudioCodecParameters::new();
    parameters
        .for_codec(CODEC_ID_VORBIS)
        .with_sample_rate(u32::from_le_bytes([r0, r1, r2, r3]))
        .with_channels(Channels::Discrete(u16::from(channels)));
    first.extend(setup);
    parameters.with_extra_data(first.into_boxed_slice());
    Codec::new(&parameters)
}

/// Holds the lengths that a comment header promises (Vorbis I specification, section 5.2.1; Opus has the same) against the bytes that are there.
/// Nothing in it is needed; one that lies is a file that cannot be trusted.
fn check_comment(body: Option<&[u8]>, kind: &str) -> Result<()> {
    let whole = || {
        let mut rest = body?;
        let take = |rest: &mut &[u8]| {
            let (length, after) = rest.split_first_chunk::<4>()?;
            *rest = after;
            Some(u32::from_le_bytes(*length) as usize)
        };
        let vendor = take(&mut rest)?;
        rest = rest.get(vendor..)?;
        for _ in 0..take(&mut rest)? {
            let length = take(&mut rest)?;
            rest = rest.get(length..)?;
        }
        Some(())
    };
    match whole() {
        Some(()) => Ok(()),
        None => damaged(format!(
            "damaged {kind} header: its comments promise more bytes than it has"
        )),
    }
}

impl Decode for Ogg<'_> {
    fn rate_hz(&self) -> u32 {
        self.codec.rate_hz()
    }

    fn channels(&self) -> usize {
        self.codec.channels()
    }

    fn next(&mut self, out: &mut Vec<f64>) -> Result<bool> {
        let Some(packet) = self.packets.next()? else {
            return Ok(false);
        };
        let channels = self.channels();
        let mut samples = Vec::new();
        self.codec.decode(&packet.bytes, &mut samples)?;
        let before = self.decoded;
        self.decoded += (samples.len() / channels.max(1)) as u64;
        if let Some(end) = packet.granule {
            // A stream that was cut out of a longer one begins later than at 0.
            let begins = *self.begins.get_or_insert(end.saturating_sub(self.decoded));
            if packet.last {
                let keep = end.saturating_sub(begins).saturating_sub(before) as usize;
                samples.truncate(keep.saturating_mul(channels));
            }
        }
        let late = self.skip.min((samples.len() / channels.max(1)) as u64);
        self.skip -= late;
        samples.drain(..late as usize * channels);
        out.append(&mut samples);
        Ok(true)
    }
}

/// A packet of the stream.
struct Packet {
    bytes: Vec<u8>,
    /// Where the sound stands behind it, in samples, where its page says so: the last packet that ends on a page does.
    granule: Option<u64>,
    /// Whether it is the stream's last.
    last: bool,
}

/// The packets of an Ogg file.
struct Packets<'a> {
    input: Input<'a>,
    /// Packets of the pages read so far.
    ready: VecDeque<Packet>,
    /// The beginning of a packet that goes on.
    begun: Vec<u8>,
    page: Vec<u8>,
    /// The stream's serial number and the next page's number, once the first page is read.
    follows: Option<(u32, u32)>,
    last: bool,
}

impl<'a> Packets<'a> {
    fn new(input: Input<'a>) -> Self {
        Self {
            input,
            ready: VecDeque::new(),
            begun: Vec::new(),
            page: Vec::new(),
            follows: None,
            last: false,
        }
    }

    /// The next packet; None at the end of a whole file.
    fn next(&mut self) -> Result<Option<Packet>> {
        while self.ready.is_empty() {
            if !self.turn()? {
                return Ok(None);
            }
        }
        Ok(self.ready.pop_front())
    }

    /// Reads the next page whole; false at the end.
    fn turn(&mut self) -> Result<bool> {
        self.page.clear();
        let at = self.input.at();
        let page = &mut self.page;
        let header = self.input.append(PAGE_HEADER, page)?;
        if header == 0 {
            return match self.last {
                true => Ok(false),
                false => damaged("the Ogg file ends without its last page: it is cut short"),
            };
        }
        if !page.starts_with(b"OggS") && !b"OggS".starts_with(page) {
            return damaged(format!(
                "garbage at byte {at}, where a page of the Ogg file should begin"
            ));
        }
        let cut_short = || SoundError::Damaged(format!("the Ogg page at byte {at} is cut short"));
        let segments = usize::from(*page.get(26).ok_or_else(cut_short)?);
        if self.input.append(segments, page)? < segments {
            return Err(cut_short());
        }
        let body = page[PAGE_HEADER..].iter().map(|&s| usize::from(s)).sum();
        if self.input.append(body, page)? < body {
            return Err(cut_short());
        }
        self.take_page(at, segments)?;
        Ok(true)
    }

    /// Cuts the page that was read into packets.
    fn take_page(&mut self, at: u64, segments: usize) -> Result<()> {
        let field = |from: usize| u32::from_le_bytes([0, 1, 2, 3].map(|n| self.page[from + n]));
        let (flags, serial, number, crc) = (self.page[5], field(14), field(18), field(22));
        let granule = u64::from(field(6)) | u64::from(field(10)) << 32;
        if crc != checksum(&self.page) {
            return damaged(format!("the Ogg page at byte {at} is damaged: its CRC is wrong"));
        }
        match self.follows {
            Some((stream, _)) if flags & FIRST != 0 || serial != stream => {
                return damaged(format!("a second stream begins at byte {at}"));
            }
            Some((_, expected)) if number != expected => {
                return damaged(format!("a page of the Ogg file is missing before byte {at}"));
            }
            _ => self.follows = Some((serial, number.wrapping_add(1))),
        }
        if (flags & GOES_ON != 0) == self.begun.is_empty() {
            return damaged(format!("a packet is torn at byte {at} of the Ogg file"));
        }
        self.last = flags & LAST != 0;
        let (table, body) = self.page[PAGE_HEADER..].split_at(segments);
        let (mut taken, first) = (0, self.ready.len());
        for &size in table {
            self.begun.extend(&body[taken..taken + usize::from(size)]);
            taken += usize::from(size);
            if self.begun.len() > MOST_PACKET {
                return damaged(format!(
                    "a packet that goes on at byte {at} has more than {MOST_PACKET} bytes"
                ));
            }
            // A packet ends with a segment that is not full.
            if size < 255 {
                self.ready.push_back(Packet {
                    bytes: std::mem::take(&mut self.begun),
                    granule: None,
                    last: false,
                });
            }
        }
        if self.ready.len() > first
            && let Some(packet) = self.ready.back_mut()
        {
            packet.granule = (granule != NO_GRANULE).then_some(granule);
            packet.last = self.last;
        }
        Ok(())
    }
}

/// CRC-32 of a page (RFC 3533, section 6: polynomial 0x04C11DB7, not reflected, from 0) in which the field of the CRC itself is 0.
fn checksum(page: &[u8]) -> u32 {
    const TABLE: [u32; 256] = {
        let mut table = [0u32; 256];
        let mut n = 0;
        while n < 256 {
            let (mut value, mut bit) = ((n as u32) << 24, 0);
            while bit < 8 {
                value = if value >> 31 == 1 {
                    value << 1 ^ 0x04c1_1db7
                } else {
                    value << 1
                };
                bit += 1;
            }
            table[n] = value;
            n += 1;
        }
        table
    };
    page.iter().enumerate().fold(0, |crc, (n, &byte)| {
        let byte = if (22..26).contains(&n) { 0 } else { byte };
        crc << 8 ^ TABLE[(crc >> 24) as usize ^ usize::from(byte)]
    })
}
