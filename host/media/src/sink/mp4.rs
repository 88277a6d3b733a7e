//! MP4 with H.264 and AAC, without any program but this one.
use std::path::{Path, PathBuf};

use anyhow::Result;
use lipstream_core::SAMPLE_RATE_HZ;

use super::{Film, Sink};
use crate::encode::{aac, colour, h264, mp4};
use crate::files;

/// A film in memory: for a page that carries it. Grows by what the encoded film takes, not by its pictures.
pub struct Mp4Bytes {
    encoder: h264::VideoEncoder,
    sound: Option<aac::Sound>,
    width: usize,
    height: usize,
}

impl Mp4Bytes {
    pub fn new(film: &Film) -> Result<Self> {
        Ok(Self {
            encoder: h264::VideoEncoder::new(film.width, film.height, film.fps)?,
            sound: match film.sound {
                Some(samples) if !samples.is_empty() => Some(aac::encode(samples, SAMPLE_RATE_HZ)?),
                _ => None,
            },
            width: film.width,
            height: film.height,
        })
    }

    /// The next picture, see [`Sink::picture`].
    pub fn picture(&mut self, rgb: &[u8]) -> Result<()> {
        self.encoder.push(colour::from_rgb(rgb, self.width, self.height))
    }

    /// The file's bytes.
    pub fn bytes(self) -> Result<Vec<u8>> {
        mp4::write(&self.encoder.finish()?, self.sound.as_ref())
    }
}

/// A film in a file, which appears when it is whole.
pub struct Mp4 {
    path: PathBuf,
    film: Mp4Bytes,
}

impl Mp4 {
    pub fn new(path: &Path, film: &Film) -> Result<Self> {
        Ok(Self {
            path: path.to_owned(),
            film: Mp4Bytes::new(film)?,
        })
    }
}

impl Sink for Mp4 {
    fn picture(&mut self, rgb: &[u8]) -> Result<()> {
        self.film.picture(rgb)
    }

    fn finish(self: Box<Self>) -> Result<()> {
        files::write_bytes(&self.path, &self.film.bytes()?)
    }
}
