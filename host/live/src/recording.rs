//! Recorded streams: what the line carried, byte for byte as `docs/wire.md` says, in a file.
//!
//! Frames have the number of their sample, so that a recording needs no other times. Nothing is lost if recording breaks off: what is there
//! can be read.
use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

use lipstream::link::{Link, LinkError, Losses};
use lipstream_core::wire::{Hello, MAX_ENCODED, ToHost, encode};
use lipstream_core::{FRAME_SAMPLES, HOP_SAMPLES};
use lipstream_media::sound::{self, SoundError};

use crate::event::{Event, Timed};

/// Why a stream was not read or not written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// The file cannot be read.
    #[error("cannot read {}", path.display())]
    Read {
        /// Which.
        path: PathBuf,
        /// What the disk says.
        source: io::Error,
    },
    /// The file cannot be written.
    #[error("cannot write {}", path.display())]
    Write {
        /// Which.
        path: PathBuf,
        /// What the disk says.
        source: io::Error,
    },
    /// There is no message in it.
    #[error("{} is no recorded stream: no device introduces itself in it", .0.display())]
    NoStream(PathBuf),
    /// The stream is of another protocol.
    #[error("cannot read {}", path.display())]
    Link {
        /// Which.
        path: PathBuf,
        /// Which protocol.
        source: LinkError,
    },
    /// The sound beside it cannot be written.
    #[error(transparent)]
    Sound(#[from] SoundError),
}

/// Bytes that are read at a time.
const PIECE: usize = 4096;
/// Bytes in which a device that speaks must have introduced itself: a second and a half at the fullest.
const INTRODUCTION: usize = 64 * 1024;

/// A recorded stream that is read from its beginning.
pub struct Recording {
    path: PathBuf,
    file: BufReader<Box<dyn Read + Send>>,
    link: Link,
    hello: Hello,
    /// Messages that have been read, the next one last.
    ready: Vec<ToHost>,
}

impl Recording {
    /// Opens a recording and reads up to the first `Hello`.
    ///
    /// # Errors
    ///
    /// That the file cannot be read, or is no recorded stream of this protocol.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let file = File::open(path).map_err(|source| RecordingError::Read {
            path: path.to_owned(),
            source,
        })?;
        Self::of_bytes(path, Box::new(file))
    }

    /// [`Recording::open`] for bytes from elsewhere, which errors call `path`.
    ///
    /// # Errors
    ///
    /// As [`Recording::open`].
    pub fn of_bytes(path: &Path, bytes: Box<dyn Read + Send>) -> Result<Self, RecordingError> {
        let mut file = BufReader::new(bytes);
        let mut link = Link::new(None);
        let (mut read, mut ready) = (0, Vec::new());
        loop {
            let count = fill(path, &mut file, &mut link, &mut ready)?;
            read += count;
            if let Some(hello) = link.hello() {
                ready.reverse();
                return Ok(Self {
                    path: path.to_owned(),
                    hello: hello.clone(),
                    file,
                    link,
                    ready,
                });
            }
            if count == 0 || read > INTRODUCTION {
                return Err(RecordingError::NoStream(path.to_owned()));
            }
        }
    }

    /// How to read the first frames.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// The next message; None at the end.
    ///
    /// # Errors
    ///
    /// What the disk says, and that another protocol follows.
    pub fn message(&mut self) -> Result<Option<ToHost>, RecordingError> {
        while self.ready.is_empty() {
            let count = fill(&self.path, &mut self.file, &mut self.link, &mut self.ready)?;
            self.ready.reverse();
            if count == 0 {
                return Ok(self.ready.pop());
            }
        }
        Ok(self.ready.pop())
    }

    /// What was lost or damaged in what has been read.
    pub fn losses(&self) -> Losses {
        self.link.losses()
    }
}

/// Reads a piece and appends its messages; gives the number of bytes.
fn fill(
    path: &Path,
    file: &mut impl Read,
    link: &mut Link,
    ready: &mut Vec<ToHost>,
) -> Result<usize, RecordingError> {
    let mut bytes = [0; PIECE];
    let count = file.read(&mut bytes).map_err(|source| RecordingError::Read {
        path: path.to_owned(),
        source,
    })?;
    link.push(&bytes[..count], |message| ready.push(message))
        .map_err(|source| RecordingError::Link {
            path: path.to_owned(),
            source,
        })?;
    Ok(count)
}

/// What [`Recording::play`] has played.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Played {
    /// Frames given, 100 a second.
    pub frames: usize,
    /// Of them those that stand for one that was lost, or that a device of a lower rate does not send.
    pub between: usize,
    /// Whether a new run began, before which playing ended.
    pub began_anew: bool,
}

impl Recording {
    /// Calls `each` with parameters `[D]` in real units and viseme weights of every frame of the first run, 100 a second: what is missing between
    /// two frames lies on the line between them. Frame 0 is the first that was recorded; sound recorded beside it begins with its window.
    ///
    /// # Errors
    ///
    /// What the disk says, and what `each` says.
    pub fn play<E: From<RecordingError>>(
        &mut self,
        mut each: impl FnMut(&[f32], &[f32]) -> Result<(), E>,
    ) -> Result<Played, E> {
        let hello = self.hello.clone();
        let mut played = Played::default();
        let mut before: Option<(u32, Vec<f32>, Vec<f32>)> = None;
        while let Some(message) = self.message()? {
            let ToHost::Frame(frame) = message else { continue };
            if !frame.fits(&hello) {
                played.began_anew = true;
                break;
            }
            let parameters = frame.parameters.iter().zip(&hello.scales);
            let parameters: Vec<f32> = parameters.map(|(v, scale)| f32::from(*v) * scale).collect();
            let visemes: Vec<f32> = frame
                .viseme_weights
                .iter()
                .map(|w| f32::from(*w) / 255.0)
                .collect();
            if let Some((sample, from, weights)) = &before {
                let steps = frame.sample.wrapping_sub(*sample) / HOP_SAMPLES as u32;
                if steps == 0 || steps > MOST_MISSING {
                    played.began_anew = true;
                    break;
                }
                for step in 1..steps {
                    let part = step as f32 / steps as f32;
                    each(
                        &between(from, &parameters, part),
                        &between(weights, &visemes, part),
                    )?;
                    played.frames += 1;
                    played.between += 1;
                }
            }
            each(&parameters, &visemes)?;
            played.frames += 1;
            before = Some((frame.sample, parameters, visemes));
        }
        Ok(played)
    }
}

/// Frames that may be missing in one run: a minute. A device that was away longer has begun anew.
const MOST_MISSING: u32 = 6000;

fn between(from: &[f32], to: &[f32], part: f32) -> Vec<f32> {
    from.iter().zip(to).map(|(a, b)| a + part * (b - a)).collect()
}

/// Writes what happens to a file, and the sound to a WAV file beside it, which begins with the window of the first frame.
pub struct Recorder {
    path: PathBuf,
    file: BufWriter<File>,
    /// Sound that has come before the first frame: where it begins, and the samples.
    early: Option<(u64, Vec<i16>)>,
    sound: Option<sound::Writer>,
    frames: u64,
}

impl Recorder {
    /// Begins a recording. A file that is there is not overwritten.
    ///
    /// # Errors
    ///
    /// What the disk says.
    pub fn create(path: &Path) -> Result<Self, RecordingError> {
        let file = File::create_new(path).map_err(|source| RecordingError::Write {
            path: path.to_owned(),
            source,
        })?;
        Ok(Self {
            path: path.to_owned(),
            file: BufWriter::new(file),
            early: None,
            sound: None,
            frames: 0,
        })
    }

    /// Frames written so far.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Takes an event; those that the line does not carry are left out.
    ///
    /// # Errors
    ///
    /// What the disk says.
    pub fn take(&mut self, event: &Event) -> Result<(), RecordingError> {
        match event {
            Event::Hello(said) => self.put(&ToHost::Hello(said.hello.clone())),
            Event::Frame(timed) => self.frame(timed),
            Event::Status(health) => self.put(&ToHost::Status(health.device)),
            Event::Sound(piece) => match &mut self.sound {
                Some(writer) => Ok(writer.write(&piece.samples)?),
                None => {
                    let early = self.early.get_or_insert_with(|| (piece.sample, Vec::new()));
                    early.1.extend(&piece.samples);
                    Ok(())
                }
            },
            Event::Notice(_) | Event::End(_) => Ok(()),
        }
    }

    fn frame(&mut self, timed: &Timed) -> Result<(), RecordingError> {
        if timed.hello.sound && self.sound.is_none() {
            let window = timed.sample.saturating_sub(FRAME_SAMPLES as u64 / 2);
            // A frame whose sound was not recorded is left out.
            let Some((begins, samples)) = self.early.take_if(|(begins, _)| *begins <= window) else {
                return Ok(());
            };
            let skipped = (window - begins).min(samples.len() as u64) as usize;
            let mut writer = sound::Writer::create(&self.path.with_extension("wav"))?;
            writer.write(&samples[skipped..])?;
            self.sound = Some(writer);
        }
        self.frames += 1;
        self.put(&ToHost::Frame(timed.frame.clone()))
    }

    fn put(&mut self, message: &ToHost) -> Result<(), RecordingError> {
        let mut buffer = [0; MAX_ENCODED];
        let Ok(bytes) = encode(message, &mut buffer) else {
            return Ok(());
        };
        self.file
            .write_all(bytes)
            .map_err(|source| RecordingError::Write {
                path: self.path.clone(),
                source,
            })
    }

    /// Ends the recording.
    ///
    /// # Errors
    ///
    /// What the disk says.
    pub fn finish(mut self) -> Result<(), RecordingError> {
        self.file.flush().map_err(|source| RecordingError::Write {
            path: self.path.clone(),
            source,
        })?;
        match self.sound {
            Some(sound) => Ok(sound.finish()?),
            None => Ok(()),
        }
    }
}
