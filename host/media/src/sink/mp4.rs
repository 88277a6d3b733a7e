//! MP4 with H.264 and AAC, without any program but this one.
//!
//! The header comes first and says where each picture lies, so nothing can be written before the last picture is encoded. Until then
//! the encoded film waits in two spools, one a track: files for [`Mp4`], memory for [`Mp4Bytes`]. The files have no name, but that of the pictures
//! in a film that may be gone on with ([`Mp4::going_on`]).
use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use lipstream_core::SAMPLE_RATE_HZ;

use super::part::{self, Begun, Part, Spool};
use super::{Film, Sink, SinkError};
use crate::encode::{aac, colour, h264, mp4};
use crate::files::{self, Target, aside_error};

/// A film whose encoded tracks wait in spools.
struct Spooled<S> {
    encoder: h264::VideoEncoder,
    pictures: S,
    /// Where the first picture lies in its spool.
    start: u64,
    sound: Option<(aac::Sound, S)>,
    width: usize,
    height: usize,
    comment: Option<String>,
}

impl<S: Read + Write + Seek> Spooled<S> {
    /// Pictures are written to `pictures`, at whose end it stands: behind those of `sizes` bytes each that lie from `start` on.
    fn new(
        film: &Film,
        (pictures, start, sizes): (S, u64, Vec<u32>),
        spool: impl FnOnce() -> Result<S, SinkError>,
    ) -> Result<Self, SinkError> {
        let encoder = h264::VideoEncoder::new(film.width, film.height, film.fps)?.behind(sizes);
        let sound = match film.sound {
            Some(sound) => {
                let mut units = spool()?;
                let mut encoder = aac::SoundEncoder::new(SAMPLE_RATE_HZ)?;
                let samples = sound.each(|samples| Ok::<_, SinkError>(encoder.feed(samples, &mut units)?))?;
                match samples {
                    0 => None,
                    _ => Some((encoder.finish(&mut units)?, units)),
                }
            }
            None => None,
        };
        Ok(Self {
            encoder,
            pictures,
            start,
            sound,
            width: film.width,
            height: film.height,
            comment: film.comment.map(str::to_owned),
        })
    }

    fn picture(&mut self, rgb: &[u8]) -> Result<(), SinkError> {
        let picture = colour::from_rgb(rgb, self.width, self.height);
        Ok(self.encoder.push(picture, &mut self.pictures)?)
    }

    /// Writes the file.
    fn write(mut self, out: &mut dyn Write) -> Result<(), SinkError> {
        let video = self.encoder.finish(&mut self.pictures)?;
        let from = |start, mut spool: S| -> Result<BufReader<S>, SinkError> {
            spool.seek(SeekFrom::Start(start))?;
            Ok(BufReader::new(spool))
        };
        let mut pictures = from(self.start, self.pictures)?;
        let comment = self.comment.as_deref();
        match self.sound {
            Some((sound, units)) => {
                let mut units = from(0, units)?;
                mp4::write(out, &video, &mut pictures, Some((&sound, &mut units)), comment)?;
            }
            None => mp4::write(out, &video, &mut pictures, None, comment)?,
        }
        Ok(())
    }
}

/// A film in memory: for a page that carries it. Grows by what the encoded film takes, not by its pictures.
pub struct Mp4Bytes(Spooled<Cursor<Vec<u8>>>);

impl Mp4Bytes {
    /// Encodes the film's sound and waits for its pictures.
    ///
    /// # Errors
    ///
    /// That an encoder refuses the film's size, rate or sound.
    pub fn new(film: &Film) -> Result<Self, SinkError> {
        let memory = Cursor::default;
        Ok(Self(Spooled::new(film, (memory(), 0, Vec::new()), || {
            Ok(memory())
        })?))
    }

    /// The next picture, see [`Sink::picture`].
    ///
    /// # Errors
    ///
    /// As [`Sink::picture`].
    pub fn picture(&mut self, rgb: &[u8]) -> Result<(), SinkError> {
        self.0.picture(rgb)
    }

    /// The file's bytes.
    ///
    /// # Errors
    ///
    /// That there was no picture, or too many for an MP4 file of this kind.
    pub fn bytes(self) -> Result<Vec<u8>, SinkError> {
        let mut out = Vec::new();
        self.0.write(&mut out)?;
        Ok(out)
    }
}

/// A film in a file, which appears when it is whole. Memory grows by 5 bytes a picture: what the header says of it.
pub struct Mp4 {
    path: PathBuf,
    film: Spooled<File>,
    part: Option<Part>,
    begun: Begun,
}

impl Mp4 {
    /// Encodes the film's sound into a spool in the folder of `path`, which is made if it is missing.
    ///
    /// # Errors
    ///
    /// That the folder cannot be written in, or an encoder refuses the film's size, rate or sound.
    pub fn new(path: &Path, film: &Film) -> Result<Self, SinkError> {
        // The spools lie where the film will: a folder for temporary files may be memory. They have no name, so nothing is left of
        // them however this program ends.
        let film = Spooled::new(film, (unnamed(path)?, 0, Vec::new()), || unnamed(path))?;
        Ok(Self {
            path: path.to_owned(),
            film,
            part: None,
            begun: Begun::Nothing,
        })
    }

    /// The same, but should the program be killed, what was encoded stays in `path` with `.part` behind it, and the next call with this `key`, a
    /// number for everything that the pictures depend on, goes on behind it: see [`Sink::begun`].
    ///
    /// # Errors
    ///
    /// As [`Mp4::new`].
    pub fn going_on(path: &Path, film: &Film, key: u64) -> Result<Self, SinkError> {
        let target = Target::at(path);
        let Target::Replaced(behind) = &target else {
            // What went into a pipe is gone, and a device keeps nothing to go on from.
            return Self::new(path, film);
        };
        let folder = target.folder()?;
        let Some(spool) = part::open(behind, film, key).map_err(aside_error(&folder))? else {
            return Self::new(path, film);
        };
        let Spool {
            part,
            file,
            start,
            sizes,
            begun,
        } = spool;
        Ok(Self {
            path: path.to_owned(),
            film: Spooled::new(film, (file, start, sizes), || unnamed(path))?,
            part: Some(part),
            begun,
        })
    }
}

/// A file without a name in the folder of `path`.
fn unnamed(path: &Path) -> Result<File, SinkError> {
    let folder = Target::at(path).folder()?;
    Ok(tempfile::tempfile_in(&folder).map_err(aside_error(&folder))?)
}

impl Sink for Mp4 {
    fn picture(&mut self, rgb: &[u8]) -> Result<(), SinkError> {
        self.film.picture(rgb)
    }

    fn begun(&self) -> Begun {
        self.begun
    }

    fn finish(self: Box<Self>) -> Result<(), SinkError> {
        let Self {
            path, film, mut part, ..
        } = *self;
        if let Some(part) = part.as_mut().filter(|_| !film.encoder.is_empty()) {
            // A full disk, say, costs no picture.
            part.keep();
        }
        files::write_whole(&path, |out| film.write(out))?;
        if let Some(part) = part {
            part.remove();
        }
        Ok(())
    }
}
