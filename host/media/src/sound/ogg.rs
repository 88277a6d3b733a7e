//! Ogg Vorbis through lewton; the pages' CRCs are checked by its Ogg reader.
use std::io::{self, Read, Seek, SeekFrom};

use lewton::inside_ogg::OggStreamReader;
use lewton::samples::InterleavedSamples;
use lewton::{OggReadError, VorbisError};

use super::input::Input;
use super::{Decode, Result, SoundError, damaged, library, mix_down};

/// Bytes of a page before its segment table.
const PAGE_HEADER: usize = 27;
/// Flag of a stream's last page.
const LAST: u8 = 4;
/// The codec that is decoded, as [`codec`] names it.
pub(super) const VORBIS: &str = "Vorbis";

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

/// An Ogg Vorbis file whose packets come next.
pub(super) struct Vorbis<'a> {
    reader: OggStreamReader<Pages<'a>>,
    serial: u32,
    /// Samples decoded so far.
    decoded: usize,
}

impl<'a> Vorbis<'a> {
    pub(super) fn open(mut input: Input<'a>) -> Result<Self> {
        match codec(input.peek(PAGE_HEADER + 256 + 8)?) {
            VORBIS => {}
            other => {
                return Err(SoundError::Unsupported(format!(
                    "an Ogg file that holds {other}, not Vorbis (convert it with `ffmpeg -i FILE out.wav`)"
                )));
            }
        }
        let pages = Pages {
            input,
            page: Vec::new(),
            taken: 0,
        };
        let reader = OggStreamReader::new(pages).map_err(of("damaged Vorbis header"))?;
        Ok(Self {
            serial: reader.stream_serial(),
            reader,
            decoded: 0,
        })
    }
}

impl Decode for Vorbis<'_> {
    fn rate_hz(&self) -> u32 {
        self.reader.ident_hdr.audio_sample_rate
    }

    fn channels(&self) -> usize {
        usize::from(self.reader.ident_hdr.audio_channels)
    }

    fn next(&mut self, out: &mut Vec<f64>) -> Result<bool> {
        let next = self.reader.read_dec_packet_generic::<InterleavedSamples<f32>>();
        let Some(packet) = next.map_err(|e| of(format!("damaged after {} samples", self.decoded))(e))? else {
            return Ok(false);
        };
        if self.reader.stream_serial() != self.serial {
            return damaged(format!("a second stream begins after {} samples", self.decoded));
        }
        let interleaved: Vec<f64> = packet.samples.iter().map(|&s| f64::from(s)).collect();
        self.decoded += interleaved.len() / self.channels().max(1);
        mix_down(&interleaved, self.channels(), out);
        Ok(true)
    }
}

/// What [`Pages`] found wrong, in its own words; what lewton found, with what it was doing.
fn of(what: impl Into<String>) -> impl FnOnce(VorbisError) -> SoundError {
    |error| match error {
        VorbisError::OggError(OggReadError::ReadError(e))
            if e.get_ref().is_some_and(|e| e.is::<SoundError>()) =>
        {
            let found = e.into_inner().and_then(|e| e.downcast().ok());
            found.map_or_else(|| SoundError::Damaged("damaged".to_owned()), |found| *found)
        }
        VorbisError::OggError(OggReadError::ReadError(e)) if e.kind() != io::ErrorKind::UnexpectedEof => {
            SoundError::Io(e)
        }
        other => library(what)(other),
    }
}

/// Passes pages on one by one: they must follow each other and end with a last one, which alone tells a file that was cut between two
/// pages from a whole one.
struct Pages<'a> {
    input: Input<'a>,
    /// The page that is being passed on; from `taken` on it is still to be read.
    page: Vec<u8>,
    taken: usize,
}

impl Pages<'_> {
    /// Reads the next page whole; none at the end.
    fn turn(&mut self) -> Result<()> {
        let last = self.page.get(5).is_some_and(|flags| flags & LAST != 0);
        self.page.clear();
        self.taken = 0;
        let at = self.input.at();
        let page = &mut self.page;
        let header = self.input.append(PAGE_HEADER, page)?;
        if header == 0 {
            return match last {
                true => Ok(()),
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
        Ok(())
    }
}

impl Read for Pages<'_> {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        if self.taken == self.page.len() {
            self.turn().map_err(io::Error::other)?;
        }
        let read = (&self.page[self.taken..]).read(to)?;
        self.taken += read;
        Ok(read)
    }
}

/// Asked for by lewton's reader, which goes back only to look for a page that does not begin where it should: [`Pages`] has none.
impl Seek for Pages<'_> {
    fn seek(&mut self, _: SeekFrom) -> io::Result<u64> {
        Err(io::ErrorKind::Unsupported.into())
    }
}
