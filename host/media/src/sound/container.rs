//! Sound in MP4 and M4A, WebM and Matroska, AIFF, CAF, and AAC on its own (ADTS), through symphonia.
//!
//! Time 0 of a file is time 0 of its sound: what an encoder put before the sound is left out, and a track that begins late is padded. Matroska says so
//! by its packets' times; MP4 by an edit list, which is read here because symphonia passes over it. What an encoder fills its last packet up with is left out
//! where the file says so, which leaves up to a packet (20 ms) at the end of a Matroska file.
use std::fs::File;
use std::io::{Cursor, Read, Seek, SeekFrom};
use std::path::Path;

use symphonia::core::formats::{FormatOptions, FormatReader, TrackType};
use symphonia::core::io::{MediaSource, MediaSourceStream};
use symphonia::core::units::{TimeBase, Timestamp};
use symphonia::default::formats::{AdtsReader, AiffReader, CafReader, IsoMp4Reader, MkvReader};

use super::codec::{Codec, said};
use super::input::Input;
use super::{Decode, Result, SoundError, damaged};

/// Bytes of a file that is not on a disk but comes through a pipe: its parts may be needed in any order, so it is collected first.
const MOST_PIPED: usize = 1 << 28;
/// Bytes of an MP4's index, which for ten hours of sound has some 10 MB.
const MOST_INDEX: u64 = 1 << 26;
/// Seconds by which a track may begin late.
const MOST_LATE_S: f64 = 3600.0;
/// How much of a track may be missing before its file counts as cut short: an encoder's last packets and rounded lengths.
const MISSING_S: f64 = 0.25;

/// Matroska counts in milliseconds: a delay that is this close to one that encoders have is that one.
const ROUNDED_S: f64 = 0.0011;

/// A kind of container.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Container {
    Mp4,
    Matroska,
    Aiff,
    Caf,
    Adts,
}

impl Container {
    /// What the first 12 bytes of a file show.
    pub(super) fn of(start: &[u8]) -> Option<Self> {
        match start {
            [_, _, _, _, b'f', b't', b'y', b'p', ..] => Some(Self::Mp4),
            // QuickTime before there was `ftyp`.
            [0, _, _, _, b'm', b'o', b'o', b'v', ..] | [0, _, _, _, b'w', b'i', b'd', b'e', ..] => {
                Some(Self::Mp4)
            }
            [0x1a, 0x45, 0xdf, 0xa3, ..] => Some(Self::Matroska),
            [
                b'F',
                b'O',
                b'R',
                b'M',
                _,
                _,
                _,
                _,
                b'A',
                b'I',
                b'F',
                b'F' | b'C',
                ..,
            ] => Some(Self::Aiff),
            [b'c', b'a', b'f', b'f', ..] => Some(Self::Caf),
            // Sync word, layer 0: MP3 has another layer.
            [0xff, second, ..] if second & 0xf6 == 0xf0 => Some(Self::Adts),
            _ => None,
        }
    }
}

/// A track of sound whose packets come next.
pub(super) struct Track {
    reader: Box<dyn FormatReader>,
    id: u32,
    codec: Codec,
    time_base: Option<TimeBase>,
    /// Seconds of the track, where the container says them.
    promised_s: Option<f64>,
    edit: Edit,
    /// Samples of the first packet, which was decoded to learn the rate.
    first: Option<Vec<f64>>,
    /// Samples of every channel still to be left out, and given so far.
    skip: u64,
    given: u64,
    keep: Option<u64>,
}

impl Track {
    /// Opens the file at `path`; without one, what `input` brings.
    pub(super) fn open(kind: Container, mut input: Input, path: Option<&Path>) -> Result<Self> {
        match path {
            Some(path) => Self::of(kind, File::open(path)?),
            None => {
                let mut bytes = Vec::new();
                if input.append(MOST_PIPED + 1, &mut bytes)? > MOST_PIPED {
                    return Err(SoundError::Unsupported(format!(
                        "more than {} MB of a kind of file that is not read piece by piece (write it to a disk first)",
                        MOST_PIPED >> 20
                    )));
                }
                Self::of(kind, Cursor::new(bytes))
            }
        }
    }

    fn of(kind: Container, mut source: impl MediaSource + 'static) -> Result<Self> {
        let edit = match kind {
            Container::Mp4 => Edit::read(&mut source)?,
            _ => Edit::default(),
        };
        source.rewind()?;
        let stream = MediaSourceStream::new(Box::new(source), Default::default());
        let options = FormatOptions::default();
        let reader = match kind {
            Container::Mp4 => IsoMp4Reader::try_new(stream, options).map(boxed),
            Container::Matroska => MkvReader::try_new(stream, options).map(boxed),
            Container::Aiff => AiffReader::try_new(stream, options).map(boxed),
            Container::Caf => CafReader::try_new(stream, options).map(boxed),
            Container::Adts => AdtsReader::try_new(stream, options).map(boxed),
        };
        let reader = reader.map_err(said("its header cannot be understood"))?;
        let none = || SoundError::Unsupported("there is no sound in it".to_owned());
        let track = reader.default_track(TrackType::Audio).ok_or_else(none)?;
        let parameters = track.codec_params.as_ref().and_then(|p| p.audio()).ok_or_else(|| {
            SoundError::Unsupported(
                "its sound is of a kind that is not known here (convert it with `ffmpeg -i FILE out.wav`)".to_owned(),
            )
        })?;
        let promised = track.duration.zip(track.time_base);
        let mut new = Self {
            id: track.id,
            codec: Codec::new(parameters)?,
            time_base: track.time_base,
            promised_s: promised.and_then(|(ticks, base)| seconds(base, i64::try_from(ticks.get()).ok()?)),
            edit,
            first: None,
            skip: 0,
            given: 0,
            keep: None,
            reader,
        };
        new.begin()?;
        Ok(new)
    }

    /// Decodes the first packet: containers may leave rate and channels to it.
    fn begin(&mut self) -> Result<()> {
        let mut samples = Vec::new();
        let Some(begins) = self.packet(&mut samples)? else {
            return Ok(());
        };
        let rate_hz = f64::from(self.codec.rate_hz());
        let begins_s = self
            .time_base
            .and_then(|base| seconds(base, begins))
            .unwrap_or(0.0)
            - self.edit.skip_s
            + self.edit.late_s;
        if begins_s > MOST_LATE_S {
            return damaged(format!("its sound begins {begins_s:.0} s after the file does"));
        }
        let begins_s = match self
            .codec
            .usual_delays()
            .into_iter()
            .find(|d| (begins_s + *d as f64 / rate_hz).abs() < ROUNDED_S)
        {
            Some(delay) => -(delay as f64) / rate_hz,
            None => begins_s,
        };
        let samples_of = |seconds: f64| (seconds * rate_hz).round() as usize;
        // Float to integer saturates, so that a negative number is 0.
        self.skip = samples_of(-begins_s) as u64;
        self.keep = self.edit.keep_s.map(|s| samples_of(s + self.edit.late_s) as u64);
        let late = samples_of(begins_s) * self.codec.channels();
        let mut first = vec![0.0; late];
        self.give(samples, &mut first);
        self.given += samples_of(begins_s) as u64;
        self.first = Some(first);
        Ok(())
    }

    /// Decodes the next packet of the track; gives its time in the track's units, None at the end.
    fn packet(&mut self, out: &mut Vec<f64>) -> Result<Option<i64>> {
        loop {
            let next = self
                .reader
                .next_packet()
                .map_err(said("its packets cannot be told apart"))?;
            let Some(packet) = next else { return Ok(None) };
            if packet.track_id == self.id {
                self.codec.decode(&packet.data, out)?;
                return Ok(Some(packet.pts.get()));
            }
        }
    }

    /// Passes samples on, less those before the sound's beginning and behind its end.
    fn give(&mut self, mut samples: Vec<f64>, out: &mut Vec<f64>) {
        let channels = self.codec.channels().max(1);
        let late = self.skip.min((samples.len() / channels) as u64);
        self.skip -= late;
        samples.drain(..late as usize * channels);
        if let Some(keep) = self.keep {
            let left = usize::try_from(keep.saturating_sub(self.given)).unwrap_or(usize::MAX);
            samples.truncate(left.saturating_mul(channels));
        }
        self.given += (samples.len() / channels) as u64;
        out.append(&mut samples);
    }
}

impl Decode for Track {
    fn rate_hz(&self) -> u32 {
        self.codec.rate_hz()
    }

    fn channels(&self) -> usize {
        self.codec.channels()
    }

    fn next(&mut self, out: &mut Vec<f64>) -> Result<bool> {
        if let Some(mut first) = self.first.take() {
            out.append(&mut first);
            return Ok(true);
        }
        let mut samples = Vec::new();
        if self.packet(&mut samples)?.is_some() {
            self.give(samples, out);
            return Ok(true);
        }
        let there_s = self.given as f64 / f64::from(self.codec.rate_hz().max(1));
        match self.promised_s {
            Some(promised) if there_s + self.edit.skip_s + MISSING_S < promised => damaged(format!(
                "the header promises {promised:.2} s of sound, the file has {there_s:.2}: it is cut short, or the header lies"
            )),
            _ => Ok(false),
        }
    }
}

fn boxed<'s>(reader: impl FormatReader + 's) -> Box<dyn FormatReader + 's> {
    Box::new(reader)
}

fn seconds(base: TimeBase, ticks: i64) -> Option<f64> {
    let time = base.calc_time(Timestamp::from(ticks))?;
    Some(time.as_secs_f64())
}

/// What an MP4's edit list (ISO/IEC 14496-12, section 8.6.6) says of its first track of sound.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Edit {
    /// Seconds of the track before the part that is heard.
    skip_s: f64,
    /// Seconds of silence before it.
    late_s: f64,
    /// Seconds that are heard.
    keep_s: Option<f64>,
}

impl Edit {
    fn read(source: &mut (impl Read + Seek)) -> Result<Self> {
        // Without an index there is no sound either, which whoever decodes it says better.
        Ok(index(source)?
            .and_then(|moov| Self::of(&moov))
            .unwrap_or_default())
    }

    fn of(moov: &[u8]) -> Option<Self> {
        let film_hz = scale(child(moov, b"mvhd")?)?;
        let sound = boxes(moov).find(|(name, body)| {
            let kind = || child(child(body, b"mdia")?, b"hdlr")?.get(8..12);
            name == b"trak" && kind() == Some(b"soun")
        })?;
        let track_hz = scale(child(child(sound.1, b"mdia")?, b"mdhd")?)?;
        let list = child(child(sound.1, b"edts")?, b"elst")?;
        let wide = list.first()? == &1;
        let count = u32::from_be_bytes(*list.get(4..8)?.first_chunk()?);
        let mut edit = Self::default();
        for entry in list
            .get(8..)?
            .chunks_exact(if wide { 20 } else { 12 })
            .take(count as usize)
        {
            let (duration, start) = match wide {
                true => (number(&entry[..8])?, number(&entry[8..16])? as i64),
                false => (
                    number(&entry[..4])?,
                    i64::from(number(&entry[4..8])? as u32 as i32),
                ),
            };
            let duration_s = duration as f64 / film_hz;
            if start < 0 {
                edit.late_s += duration_s;
                continue;
            }
            edit.skip_s = start as f64 / track_hz;
            // Fragmented films say 0: to the end.
            edit.keep_s = (count == 1 && duration > 0).then_some(duration_s);
            break;
        }
        Some(edit)
    }
}

/// The body of an MP4's index, `moov`.
fn index(source: &mut (impl Read + Seek)) -> Result<Option<Vec<u8>>> {
    source.rewind()?;
    let mut at = 0;
    loop {
        let mut head = Vec::new();
        source.by_ref().take(16).read_to_end(&mut head)?;
        let Some((size, name)) = head.first_chunk::<8>().map(|h| h.split_at(4)) else {
            return Ok(None);
        };
        let (size, header) = match (number(size), head.get(8..16).and_then(number)) {
            (Some(1), Some(wide)) => (wide, 16),
            (Some(size), _) => (size, 8),
            _ => return Ok(None),
        };
        if name == b"moov" && size > header && size <= MOST_INDEX {
            let mut body = Vec::new();
            source.seek(SeekFrom::Start(at + header))?;
            source.by_ref().take(size - header).read_to_end(&mut body)?;
            return Ok(Some(body));
        }
        // 0 reaches to the end of the file; less than a header would go round for ever.
        let Some(next) = at.checked_add(size).filter(|_| size >= header) else {
            return Ok(None);
        };
        at = next;
        source.seek(SeekFrom::Start(at))?;
    }
}

/// The boxes in a box: name and body.
fn boxes(mut bytes: &[u8]) -> impl Iterator<Item = (&[u8], &[u8])> {
    std::iter::from_fn(move || {
        let size = usize::try_from(number(bytes.get(..4)?)?).ok()?;
        let this = bytes.get(..size).filter(|this| this.len() >= 8)?;
        bytes = &bytes[size..];
        Some((&this[4..8], &this[8..]))
    })
}

fn child<'b>(bytes: &'b [u8], name: &[u8; 4]) -> Option<&'b [u8]> {
    boxes(bytes).find_map(|(this, body)| (this == name).then_some(body))
}

/// Units a second of an `mvhd` or `mdhd`, whose times before it are longer in version 1.
fn scale(body: &[u8]) -> Option<f64> {
    let at = if body.first()? == &1 { 20 } else { 12 };
    Some(number(body.get(at..at + 4)?)? as f64).filter(|hz| *hz > 0.0)
}

/// Big-endian.
fn number(bytes: &[u8]) -> Option<u64> {
    (bytes.len() <= 8).then(|| bytes.iter().fold(0, |sum, &byte| sum << 8 | u64::from(byte)))
}
