//! Sound files to what the front end takes: 16 kHz, mono, i16.
//!
//! WAV, FLAC, MP3 and Ogg Vorbis, told apart by their first bytes. A file that is cut short, damaged or contradicts itself
//! is refused as a whole, in one line; nothing is guessed and no part of it is passed over.
//!
//! Channels are averaged; other rates are resampled (rubato's synchronous FFT resampler, which trims its own
//! delay, so that time 0 stays time 0). A 16 kHz mono 16-bit file passes unchanged, bit for bit.
use std::io::Read;
use std::path::{Path, PathBuf};

mod flac;
mod mp3;
mod ogg;
mod resample;
mod wav;

use crate::Cause;
use crate::files::{self, FileError};

/// Why a sound was not read or not written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SoundError {
    /// The file that holds the sound: `source` says what is wrong with it.
    #[error("cannot read {} as sound", path.display())]
    In { path: PathBuf, source: Box<SoundError> },
    /// The file cannot be read or written at all.
    #[error(transparent)]
    File(#[from] FileError),
    /// There is not a byte.
    #[error("the file is empty")]
    Empty,
    /// It begins like no file that is read here.
    #[error("not a WAV, FLAC, MP3 or Ogg Vorbis file (convert it with `ffmpeg -i FILE out.wav`)")]
    Unknown,
    /// It is of a kind that is read here, and holds what is not.
    #[error("{0}")]
    Unsupported(String),
    /// Its rate is none that is read.
    #[error("its rate is {rate_hz} Hz; from {} to {} Hz can be read", RATES_HZ.start(), RATES_HZ.end())]
    Rate { rate_hz: u32 },
    /// It is whole, and there is no sound in it.
    #[error("it holds no samples")]
    NoSamples,
    /// It is cut short, damaged or contradicts itself.
    #[error("{0}")]
    Damaged(String),
    /// A decoder or the resampler refuses it: what it was doing, and in its own words why.
    #[error("{what}")]
    Library { what: String, source: Cause },
    /// The WAV reader or writer refuses it, in its own words.
    #[error(transparent)]
    Wav(#[from] hound::Error),
}

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

/// What a decoder gives: all channels averaged, full scale ±1, at the file's own rate.
struct Decoded {
    samples: Vec<f64>,
    rate_hz: u32,
    channels: usize,
}

/// Reads a sound file. The error is one line that names the file, what is wrong, and what to do.
pub fn read(path: &Path) -> Result<Sound> {
    let bytes = files::read_bytes(path)?;
    decode(&bytes).map_err(|source| SoundError::In {
        path: path.to_owned(),
        source: Box::new(source),
    })
}

/// A kind of file, after its first bytes.
enum Kind {
    Wav,
    Flac,
    Ogg,
    Mp3,
}

impl Kind {
    fn of(bytes: &[u8]) -> Option<Kind> {
        Some(match bytes {
            [b'R', b'I', b'F', b'F', ..] => Kind::Wav,
            [b'f', b'L', b'a', b'C', ..] => Kind::Flac,
            [b'O', b'g', b'g', b'S', ..] => Kind::Ogg,
            _ if mp3::detect(bytes) => Kind::Mp3,
            _ => return None,
        })
    }
}

/// Whether a file begins like those that [`read`] can read. True of one that can't be opened, so that `read` says why.
pub fn knows(path: &Path) -> bool {
    // MP3 has no signature: several frames must follow each other.
    let mut start = Vec::new();
    let opened = std::fs::File::open(path);
    match opened.and_then(|file| file.take(16_384).read_to_end(&mut start)) {
        Ok(_) => match Kind::of(&start) {
            Some(Kind::Ogg) => ogg::codec(&start) == ogg::VORBIS,
            kind => kind.is_some(),
        },
        Err(_) => true,
    }
}

/// [`read`] for a file that is in memory already.
pub fn decode(bytes: &[u8]) -> Result<Sound> {
    if bytes.is_empty() {
        return Err(SoundError::Empty);
    }
    let decoded = match Kind::of(bytes) {
        Some(Kind::Wav) => wav::decode(bytes)?,
        Some(Kind::Flac) => flac::decode(bytes)?,
        Some(Kind::Ogg) => ogg::decode(bytes)?,
        Some(Kind::Mp3) => mp3::decode(bytes)?,
        None => return Err(SoundError::Unknown),
    };
    if !RATES_HZ.contains(&decoded.rate_hz) {
        return Err(SoundError::Rate {
            rate_hz: decoded.rate_hz,
        });
    }
    if decoded.samples.is_empty() {
        return Err(SoundError::NoSamples);
    }
    let at_16_khz = resample::to_16_khz(decoded.samples, decoded.rate_hz)?;
    Ok(Sound {
        samples: at_16_khz.into_iter().map(to_i16).collect(),
        source_rate_hz: decoded.rate_hz,
        source_channels: decoded.channels,
    })
}

/// Full scale ±1 to i16, rounded to nearest, clipped.
fn to_i16(x: f64) -> i16 {
    (x * 32768.0).round_ties_even() as i16 // `as` saturates
}

/// Averages interleaved channels.
fn mix_down(interleaved: &[f64], channels: usize) -> Vec<f64> {
    interleaved
        .chunks_exact(channels)
        .map(|frame| frame.iter().sum::<f64>() / channels as f64)
        .collect()
}

/// Writes 16 kHz mono samples as a WAV file of 16 bits, whole or not at all.
pub fn write(path: &Path, samples: &[i16]) -> Result<()> {
    let spec = hound::WavSpec {
        channels: 1,
        sample_rate: lipstream_core::SAMPLE_RATE_HZ,
        bits_per_sample: 16,
        sample_format: hound::SampleFormat::Int,
    };
    let mut bytes = std::io::Cursor::new(Vec::with_capacity(samples.len() * 2 + 64));
    let mut writer = hound::WavWriter::new(&mut bytes, spec)?;
    for sample in samples {
        writer.write_sample(*sample)?;
    }
    writer.finalize()?;
    Ok(files::write_bytes(path, bytes.get_ref())?)
}

#[cfg(test)]
mod tests;
