//! Sound files to what the front end takes: 16 kHz, mono, i16.
//!
//! WAV, FLAC, MP3, Ogg (Vorbis, Opus), MP4 and M4A (AAC, ALAC), WebM, Matroska, AIFF, CAF and ADTS, told apart by their first bytes. A file that is cut
//! short, damaged or contradicts itself is refused as a whole, in one line; nothing is guessed and no part of it is passed over.
//!
//! Channels are averaged (`mix.rs` has the exception); other rates are resampled (rubato's synchronous FFT resampler, which trims its own
//! delay, so that time 0 stays time 0). A 16 kHz mono 16-bit file passes unchanged, bit for bit.
//!
//! [`Reader`] gives a sound piece by piece as it comes and keeps no more of it than a decoder needs; [`read`] and [`decode`] collect it.
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

mod codec;
mod container;
mod flac;
mod input;
mod live;
mod mix;
mod mp3;
mod ogg;
mod resample;
mod wav;

use container::{Container, Track};
use input::{Counted, Input};
use mix::Mixer;
pub use resample::Resampler;
use resample::To16Khz;

use crate::Cause;
use crate::files::{self, FileError};

/// Why a sound was not read or not written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SoundError {
    /// The file that holds the sound: `source` says what is wrong with it.
    #[error("cannot read {name} as sound")]
    In {
        /// What messages call it.
        name: String,
        /// What happened.
        source: Box<SoundError>,
    },
    /// The file cannot be read or written at all.
    #[error(transparent)]
    File(#[from] FileError),
    /// What it comes from cannot be read on.
    #[error("it cannot be read to its end")]
    Io(#[from] io::Error),
    /// There is not a byte.
    #[error("the file is empty")]
    Empty,
    /// It begins like no file that is read here.
    #[error(
        "not a sound file of a kind that is read here: {KINDS} (convert it with `ffmpeg -i FILE out.wav`)"
    )]
    Unknown,
    /// It is of a kind that is read here, and holds what is not.
    #[error("{0}")]
    Unsupported(String),
    /// Its rate is none that is read.
    #[error("its rate is {rate_hz} Hz; from {} to {} Hz can be read", RATES_HZ.start(), RATES_HZ.end())]
    Rate {
        /// Samples a second.
        rate_hz: u32,
    },
    /// It is whole, and there is no sound in it.
    #[error("it holds no samples")]
    NoSamples,
    /// It is cut short, damaged or contradicts itself.
    #[error("{0}")]
    Damaged(String),
    /// A decoder or the resampler refuses it: what it was doing, and in its own words why.
    #[error("{what}")]
    Library {
        /// What was being done.
        what: String,
        /// What happened.
        source: Cause,
    },
    /// The WAV writer refuses it, in its own words.
    #[error(transparent)]
    Wav(#[from] hound::Error),
}

/// What [`read`] reads, for words to people.
pub const KINDS: &str = "WAV, FLAC, MP3, Ogg (Vorbis or Opus), MP4 and M4A, WebM, AIFF, CAF, AAC";

/// What every decoder here returns.
type Result<T, E = SoundError> = std::result::Result<T, E>;

/// An error for a file that is cut short, damaged or contradicts itself.
fn damaged<T>(what: impl Into<String>) -> Result<T> {
    Err(SoundError::Damaged(what.into()))
}

/// Says what a library was doing when it refused.
fn library<E: Into<Cause>>(what: impl Into<String>) -> impl FnOnce(E) -> SoundError {
    |source| SoundError::Library {
        what: what.into(),
        source: source.into(),
    }
}

/// Samples of the longest sound that is kept whole: six hours, 700 MB. Piece by piece a sound may be as long as it likes.
const MOST_AT_ONCE: usize = 6 * 3600 * lipstream_core::SAMPLE_RATE_HZ as usize;

/// Rates that are read. 8-48 kHz is what speech comes in; studio files go up to four times that.
const RATES_HZ: std::ops::RangeInclusive<u32> = 8_000..=192_000;

/// A sound as the front end takes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sound {
    /// 16 kHz mono.
    pub samples: Vec<i16>,
    /// Rate of the file.
    pub source_rate_hz: u32,
    /// Channels of the file.
    pub source_channels: usize,
}

impl Sound {
    /// Length in seconds.
    pub fn seconds(&self) -> f64 {
        self.samples.len() as f64 / f64::from(lipstream_core::SAMPLE_RATE_HZ)
    }
}

/// A sound that is read piece by piece.
///
/// ```no_run
/// # fn hear(_samples: &[i16]) {}
/// let mut sound = lipstream_media::sound::Reader::open("speech.flac".as_ref())?;
/// while let Some(samples) = sound.piece()? {
///     hear(samples); // 16 kHz mono, some tenths of a second
/// }
/// # Ok::<(), lipstream_media::sound::SoundError>(())
/// ```
pub struct Reader<'a> {
    name: String,
    decoder: Box<dyn Decode + 'a>,
    mixer: Mixer,
    to_16_khz: To16Khz,
    /// Bytes of the file that have been read, and all of them, where it is a file.
    read: Option<(Arc<AtomicU64>, u64)>,
    /// Whether a sample has come.
    any: bool,
    /// Whether the last piece has been given.
    ended: bool,
    decoded: Vec<f64>,
    mixed: Vec<f64>,
    resampled: Vec<f64>,
    samples: Vec<i16>,
}

/// Decodes one kind of file, piece by piece.
trait Decode: Send {
    /// Samples a second of the file.
    fn rate_hz(&self) -> u32;

    /// Channels of the file.
    fn channels(&self) -> usize;

    /// Channels of the samples that [`Decode::next`] gives.
    fn interleaved(&self) -> usize {
        self.channels()
    }

    /// Appends the next piece, channels interleaved, full scale ±1; false when the sound has ended, and the file is whole.
    fn next(&mut self, out: &mut Vec<f64>) -> Result<bool>;
}

impl Reader<'static> {
    /// Opens a sound file.
    ///
    /// # Errors
    ///
    /// That the file cannot be read, or does not begin like a sound that is read here. The error names the file.
    pub fn open(path: &Path) -> Result<Self> {
        let unread = |source| FileError::Read {
            path: path.to_owned(),
            source,
        };
        let file = File::open(path).map_err(unread)?;
        let about = file.metadata().map_err(unread)?;
        let length = about.is_file().then_some(about.len());
        let read = Arc::new(AtomicU64::new(0));
        let mut input = Input::new(Box::new(Counted(file, Arc::clone(&read))), length);
        // What a disk or a folder refuses shows here.
        input.peek(1).map_err(unread)?;
        let name = path.display().to_string();
        let mut reader = Self::of_input(&name, input, length.map(|_| path)).map_err(in_file(&name))?;
        reader.read = length.map(|length| (read, length));
        Ok(reader)
    }

    /// Reads a sound as it comes, from a pipe for instance; errors call it `name`.
    ///
    /// # Errors
    ///
    /// That it does not begin like a sound that is read here.
    pub fn of_stream(name: &str, stream: impl Read + Send + 'static) -> Result<Self> {
        Self::of_input(name, Input::new(Box::new(stream), None), None).map_err(in_file(name))
    }
}

impl<'a> Reader<'a> {
    /// Sound that is made while it is read, by a microphone for instance; errors call it `name`. `next` appends samples, all channels averaged,
    /// full scale ±1, waits until there are some, and gives false when there will be no more.
    ///
    /// # Errors
    ///
    /// [`SoundError::Rate`]: the rate is none that is read.
    pub fn of_live(
        name: &str,
        rate_hz: u32,
        channels: usize,
        next: impl FnMut(&mut Vec<f64>) -> io::Result<bool> + Send + 'a,
    ) -> Result<Self> {
        let live = live::Live {
            rate_hz,
            channels,
            next,
        };
        Self::of_decoder(name, Box::new(live)).map_err(in_file(name))
    }

    /// `path` is where the input can be opened anew, if it can.
    fn of_input(name: &str, mut input: Input<'a>, path: Option<&Path>) -> Result<Self> {
        if input.peek(1)?.is_empty() {
            return Err(SoundError::Empty);
        }
        let kind = Kind::of(&mut input)?;
        let at = input.at();
        let decoder: Box<dyn Decode + 'a> = match kind {
            Kind::Wav => Box::new(wav::Wav::open(input)?),
            Kind::Flac => Box::new(flac::Flac::open(input)?),
            Kind::Ogg => Box::new(ogg::Ogg::open(input)?),
            Kind::Mp3 => Box::new(mp3::Mp3::open(input)?),
            // Behind a tag it is not the file's beginning that is to be opened.
            Kind::In(kind) => Box::new(Track::open(kind, input, path.filter(|_| at == 0))?),
        };
        Self::of_decoder(name, decoder)
    }

    fn of_decoder(name: &str, decoder: Box<dyn Decode + 'a>) -> Result<Self> {
        let rate_hz = decoder.rate_hz();
        Ok(Self {
            name: name.to_owned(),
            to_16_khz: To16Khz::new(rate_hz)?,
            decoder,
            mixer: Mixer::default(),
            read: None,
            any: false,
            ended: false,
            decoded: Vec::new(),
            mixed: Vec::new(),
            resampled: Vec::new(),
            samples: Vec::new(),
        })
    }

    /// How much of the file has been read, 0 to 1, by its bytes; None of what is no file, whose end nobody knows. The files of video programs (MP4, WebM) are looked up in
    /// any order and say little about it.
    pub fn part_read(&self) -> Option<f64> {
        let (read, all) = self.read.as_ref()?;
        Some((read.load(Ordering::Relaxed) as f64 / (*all).max(1) as f64).min(1.0))
    }

    /// Rate of the file.
    pub fn source_rate_hz(&self) -> u32 {
        self.decoder.rate_hz()
    }

    /// Channels of the file.
    pub fn source_channels(&self) -> usize {
        self.decoder.channels()
    }

    /// The next samples, 16 kHz mono, at least one; None when the sound has ended. Pieces are as long as the decoder makes them.
    ///
    /// # Errors
    ///
    /// What is wrong with the file, which it names. What came before was read rightly.
    pub fn piece(&mut self) -> Result<Option<&[i16]>> {
        self.resampled.clear();
        while self.resampled.is_empty() && !self.ended {
            self.decode().map_err(in_file(&self.name))?;
        }
        self.samples.clear();
        self.samples.extend(self.resampled.iter().copied().map(to_i16));
        Ok((!self.samples.is_empty()).then_some(&self.samples))
    }

    fn decode(&mut self) -> Result<()> {
        self.decoded.clear();
        if self.decoder.next(&mut self.decoded)? {
            self.any |= !self.decoded.is_empty();
            self.mixed.clear();
            self.mixer
                .push(&self.decoded, self.decoder.interleaved().max(1), &mut self.mixed)?;
            return self.to_16_khz.push(&self.mixed, &mut self.resampled);
        }
        self.mixer.finish()?;
        if !self.any {
            return Err(SoundError::NoSamples);
        }
        self.ended = true;
        self.to_16_khz.finish(&mut self.resampled)
    }

    /// Everything that is still to come.
    ///
    /// # Errors
    ///
    /// As [`Reader::piece`]'s.
    pub fn rest(mut self) -> Result<Sound> {
        let mut samples = Vec::new();
        while let Some(piece) = self.piece()? {
            samples.extend(piece);
            if samples.len() > MOST_AT_ONCE {
                let hours = MOST_AT_ONCE / 3600 / lipstream_core::SAMPLE_RATE_HZ as usize;
                let long = format!(
                    "it goes on for more than {hours} hours, which do not fit in memory at once: cut it into pieces"
                );
                return Err(in_file(&self.name)(SoundError::Unsupported(long)));
            }
        }
        Ok(Sound {
            samples,
            source_rate_hz: self.source_rate_hz(),
            source_channels: self.source_channels(),
        })
    }
}

/// Says in which file something is wrong.
fn in_file(name: &str) -> impl FnOnce(SoundError) -> SoundError {
    |source| SoundError::In {
        name: name.to_owned(),
        source: Box::new(source),
    }
}

/// Reads a whole sound file. The error is one line that names the file, what is wrong, and what to do.
///
/// # Errors
///
/// As [`Reader`]'s.
pub fn read(path: &Path) -> Result<Sound> {
    Reader::open(path)?.rest()
}

/// A kind of file, after its first bytes.
enum Kind {
    Wav,
    Flac,
    Ogg,
    Mp3,
    In(Container),
}

/// Bytes in which a file without a signature shows what it is: MP3's frames must follow each other.
const START: usize = 16_384;

impl Kind {
    fn signed(bytes: &[u8]) -> Option<Kind> {
        Some(match bytes {
            [b'R', b'I', b'F', b'F', ..] | [b'R', b'F', b'6', b'4', ..] | [b'B', b'W', b'6', b'4', ..] => {
                Kind::Wav
            }
            [b'f', b'L', b'a', b'C', ..] => Kind::Flac,
            [b'O', b'g', b'g', b'S', ..] => Kind::Ogg,
            _ => Kind::In(Container::of(bytes)?),
        })
    }

    /// What follows, after a tag before it, which is passed over.
    fn of(input: &mut Input) -> Result<Kind> {
        let tag = nanomp3::id3v2_len(input.peek(10)?) as u64;
        let there = input.length().unwrap_or(tag).min(tag);
        if there < tag || input.skip(tag)? < tag {
            return damaged(format!(
                "its ID3 tag promises {tag} bytes, the file has {}: it is cut short",
                input.length().unwrap_or(input.at())
            ));
        }
        // As little as is enough is looked at, because a pipe may give no more for a while.
        if let Some(kind) = Kind::signed(input.peek(12)?) {
            return Ok(kind);
        }
        match tag > 0 || mp3::detect(input.peek(START)?) {
            true => Ok(Kind::Mp3),
            false => Err(SoundError::Unknown),
        }
    }
}

/// Whether a file begins like those that [`read`] can read. True of one that can't be opened, so that `read` says why.
pub fn knows(path: &Path) -> bool {
    let Ok(file) = File::open(path) else { return true };
    let mut input = Input::new(Box::new(file), None);
    match Kind::of(&mut input) {
        Ok(Kind::Ogg) => input.peek(START).is_ok_and(|start| ogg::reads(ogg::codec(start))),
        Ok(_) | Err(SoundError::Io(_)) => true,
        Err(_) => false,
    }
}

/// [`read`] for a file that is in memory already.
///
/// # Errors
///
/// As [`read`]'s, without the file's name.
pub fn decode(bytes: &[u8]) -> Result<Sound> {
    let input = Input::new(Box::new(bytes), Some(bytes.len() as u64));
    let said = Reader::of_input("", input, None).and_then(Reader::rest);
    said.map_err(|error| match error {
        SoundError::In { source, .. } => *source,
        other => other,
    })
}

/// Full scale ±1 to i16, rounded to nearest, clipped.
fn to_i16(x: f64) -> i16 {
    (x * 32768.0).round_ties_even() as i16 // `as` saturates
}

/// A WAV file of 16 bits, 16 kHz mono, that is written piece by piece.
pub struct Writer(hound::WavWriter<io::BufWriter<File>>);

impl Writer {
    /// Makes or overwrites `path`, which is whole after [`Writer::finish`].
    ///
    /// # Errors
    ///
    /// What the disk says.
    pub fn create(path: &Path) -> Result<Self> {
        Ok(Self(hound::WavWriter::create(path, SPEC)?))
    }

    /// Appends samples.
    ///
    /// # Errors
    ///
    /// What the disk says.
    pub fn write(&mut self, samples: &[i16]) -> Result<()> {
        for sample in samples {
            self.0.write_sample(*sample)?;
        }
        Ok(())
    }

    /// Writes the header's lengths.
    ///
    /// # Errors
    ///
    /// What the disk says.
    pub fn finish(self) -> Result<()> {
        Ok(self.0.finalize()?)
    }
}

/// What is written.
const SPEC: hound::WavSpec = hound::WavSpec {
    channels: 1,
    sample_rate: lipstream_core::SAMPLE_RATE_HZ,
    bits_per_sample: 16,
    sample_format: hound::SampleFormat::Int,
};

/// Writes 16 kHz mono samples as a WAV file of 16 bits, whole or not at all.
///
/// # Errors
///
/// What the disk says.
pub fn write(path: &Path, samples: &[i16]) -> Result<()> {
    let mut bytes = io::Cursor::new(Vec::with_capacity(samples.len() * 2 + 64));
    let mut writer = hound::WavWriter::new(&mut bytes, SPEC)?;
    for sample in samples {
        writer.write_sample(*sample)?;
    }
    writer.finalize()?;
    Ok(files::write_bytes(path, bytes.get_ref())?)
}

#[cfg(test)]
mod tests;
