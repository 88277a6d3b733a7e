//! Pictures to H.264 (ITU-T H.264, Constrained Baseline: the profile that every player decodes).
//!
//! A key picture every second, and between them each macroblock is one of the picture before, moved by whole pixels, plus what has changed, or
//! is skipped. What a decoder shows is what the encoder went on from, to the bit (a test says so). The codes of levels are those of
//! `rusty_h264-common`.
//!
//! Groups of pictures from one key picture to the next know nothing of each other and are encoded side by side, on as many cores as there
//! are; the film is the same on any number of them.
use std::collections::VecDeque;
use std::io::Write;
use std::sync::mpsc::{Receiver, Sender, channel};

use super::EncodeError;
use super::colour::Picture;
use coder::{Coder, QP};

mod blocks;
mod coder;
mod deblock;
mod macroblock;
mod motion;
mod predict;
mod stream;

/// Bytes of pictures that wait to be encoded, at most: the memory that a film takes on many cores.
const WAITING_BYTES: usize = 64 << 20;

/// What an MP4 header says of an H.264 track whose encoded pictures lie elsewhere.
#[derive(Clone, Debug)]
pub struct Video {
    /// Width in pixels.
    pub width: u16,
    /// Height in pixels.
    pub height: u16,
    /// Pictures a second.
    pub fps: u32,
    /// Sequence parameter set, without start code.
    pub sps: Vec<u8>,
    /// Picture parameter set, without start code.
    pub pps: Vec<u8>,
    /// Bytes of each picture's sample.
    pub sizes: Vec<u32>,
    /// Whether playing can start at the sample.
    pub key: Vec<bool>,
}

/// A track that grows picture by picture. The encoded pictures are written out, not kept.
pub struct VideoEncoder {
    video: Video,
    /// Pictures that came.
    pushed: usize,
    /// Pictures that may be on their way at the same time.
    most: usize,
    /// Groups on their way, oldest first.
    groups: VecDeque<Group>,
}

/// A key picture and those that follow it, in a thread of their own.
struct Group {
    pictures: Sender<Picture>,
    samples: Receiver<Vec<u8>>,
}

impl Group {
    fn start(width: usize, height: usize, number: u32) -> Result<Self, EncodeError> {
        let (pictures, to_encode) = channel::<Picture>();
        let (encoded, samples) = channel();
        let encode = move || {
            let mut coder = Coder::new(width, height, number);
            for picture in to_encode {
                if encoded.send(coder.code(&picture)).is_err() {
                    // Nobody waits for the film any more.
                    break;
                }
            }
        };
        std::thread::Builder::new().name("h264".into()).spawn(encode)?;
        Ok(Self { pictures, samples })
    }
}

impl VideoEncoder {
    /// `fps` pictures a second; a key picture every second, so that seeking is quick.
    ///
    /// # Errors
    ///
    /// That the size is odd, nothing at all, or more than a file can hold.
    pub fn new(width: usize, height: usize, fps: u32) -> Result<Self, EncodeError> {
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        Self::on(threads, width, height, fps)
    }

    /// Goes on behind pictures that were encoded before, whole groups of `fps` pictures, whose samples have these sizes.
    pub fn behind(mut self, sizes: Vec<u32>) -> Self {
        let fps = self.video.fps as usize;
        debug_assert!(sizes.len().is_multiple_of(fps));
        self.pushed = sizes.len();
        self.video.key = (0..sizes.len()).map(|n| n.is_multiple_of(fps)).collect();
        self.video.sizes = sizes;
        self
    }

    /// Whether no picture came yet.
    pub fn is_empty(&self) -> bool {
        self.pushed == 0
    }

    /// [`VideoEncoder::new`] on so many threads.
    fn on(threads: usize, width: usize, height: usize, fps: u32) -> Result<Self, EncodeError> {
        let even = |side: usize| side > 0 && side.is_multiple_of(2);
        if !even(width) || !even(height) || fps == 0 {
            return Err(EncodeError::Video(format!(
                "{fps} pictures of {width}×{height} a second: sides must be even"
            )));
        }
        let side = |side: usize| u16::try_from(side).map_err(|_| EncodeError::Size { width, height });
        let bytes = width * height * 3 / 2;
        Ok(Self {
            video: Video {
                width: side(width)?,
                height: side(height)?,
                fps,
                sps: stream::sequence(width, height, fps),
                pps: stream::picture(QP),
                sizes: Vec::new(),
                key: Vec::new(),
            },
            pushed: 0,
            most: (threads * fps as usize).min(WAITING_BYTES / bytes).max(1),
            groups: VecDeque::new(),
        })
    }

    /// Takes the next picture, and writes the samples that are encoded as MP4 holds them: a NAL unit after its length in 4 bytes, big-endian.
    ///
    /// # Errors
    ///
    /// That the picture is of another size, and what `out` says.
    pub fn push(&mut self, picture: Picture, out: &mut dyn Write) -> Result<(), EncodeError> {
        let (width, height) = (usize::from(self.video.width), usize::from(self.video.height));
        let planes = [&picture.y, &picture.cb, &picture.cr].map(Vec::len);
        let area = width * height;
        if (picture.width, picture.height) != (width, height) || planes != [area, area / 4, area / 4] {
            return Err(EncodeError::Picture {
                picture: self.pushed,
                said: format!("it is not {width}×{height}"),
            });
        }
        while self.pushed - self.video.sizes.len() >= self.most {
            self.write_one(out)?;
        }
        let fps = self.video.fps as usize;
        if self.pushed.is_multiple_of(fps) {
            let number = (self.pushed / fps) as u32;
            self.groups.push_back(Group::start(width, height, number)?);
        }
        let group = self.groups.back().expect("the first picture starts a group");
        // A thread that has ended says so when its picture is asked for.
        let _ = group.pictures.send(picture);
        self.pushed += 1;
        Ok(())
    }

    /// Waits for the oldest picture on its way.
    fn write_one(&mut self, out: &mut dyn Write) -> Result<(), EncodeError> {
        let number = self.video.sizes.len();
        let fps = self.video.fps as usize;
        let key = number.is_multiple_of(fps);
        let nothing = || EncodeError::NothingOf(number);
        let group = self.groups.front().ok_or_else(nothing)?;
        let unit = group.samples.recv().map_err(|_| nothing())?;
        let length = unit.len() as u32;
        out.write_all(&length.to_be_bytes())?;
        out.write_all(&unit)?;
        self.video.sizes.push(4 + length);
        self.video.key.push(key);
        if (number + 1).is_multiple_of(fps) {
            self.groups.pop_front();
        }
        Ok(())
    }

    /// Writes the last samples and gives the finished track.
    ///
    /// # Errors
    ///
    /// That no picture came, and what `out` says.
    pub fn finish(mut self, out: &mut dyn Write) -> Result<Video, EncodeError> {
        if self.pushed == 0 {
            return Err(EncodeError::NoPicture);
        }
        while self.video.sizes.len() < self.pushed {
            self.write_one(out)?;
        }
        Ok(self.video)
    }
}

#[cfg(test)]
mod tests;
