//! MP3 (MPEG audio, layers I to III) through nanomp3.
//!
//! The delay of encoder and decoder is taken off where the file states it (the LAME tag), so that time 0 stays time 0.
//! Frames must follow each other without gaps; tags at both ends and zeros in between are passed over.
use nanomp3::{Channels, Decoder, MAX_SAMPLES_PER_FRAME, VbrTag, frames, strip_trailing_tags};

use super::input::Input;
use super::{Decode, Result, SoundError, damaged, library};

/// Samples by which this decoder is late.
const DECODER_DELAY: u64 = 529;
/// Bytes that are looked at together.
const WINDOW: usize = 1 << 17;
/// A frame is one if ten more follow, so that the end of a window that is not the end of the file is left for the next: more than eleven
/// frames of the longest kind.
const MARGIN: usize = 1 << 15;
/// More bytes than a frame has.
const LONGEST_FRAME: usize = 3000;
/// What may follow the last frame: tags, with pictures in them.
const MOST_TRAILING: usize = 1 << 26;

/// Whether the bytes, the start of a file, look like MP3.
pub(super) fn detect(bytes: &[u8]) -> bool {
    nanomp3::detect(bytes)
}

/// An MP3 file whose frames come next.
pub(super) struct Mp3<'a> {
    frames: Frames<'a>,
    rate_hz: u32,
    channels: Channels,
    /// Frames that the file's tag promises.
    promised: Option<u32>,
    found: u32,
    decoder: Decoder,
    /// Samples that are still to be left out at the start, and that will be at the end.
    skip: u64,
    hold: usize,
    /// Decoded samples that may yet turn out to be the end's.
    held: Vec<f64>,
}

impl<'a> Mp3<'a> {
    /// `input` is past its ID3v2 tag.
    pub(super) fn open(input: Input<'a>) -> Result<Self> {
        let mut frames = Frames::new(input);
        let first = frames.peek()?;
        let no_frames = || SoundError::Damaged("it holds no MP3 frames".to_owned());
        let first = first.ok_or_else(no_frames)?;
        let (rate_hz, channels) = (first.rate_hz, first.channels);
        let tag = VbrTag::parse(frames.bytes(first));
        if tag.is_some() {
            frames.take(first);
        }
        let trim = tag.as_ref().and_then(|tag| tag.encoder_delay_padding);
        Ok(Self {
            frames,
            rate_hz,
            channels,
            promised: tag.as_ref().and_then(|tag| tag.frames),
            found: 0,
            decoder: Decoder::new(),
            skip: trim.map_or(0, |(delay, _)| u64::from(delay) + DECODER_DELAY),
            hold: trim.map_or(0, |(_, padding)| u64::from(padding).saturating_sub(DECODER_DELAY)) as usize,
            held: Vec::new(),
        })
    }

    /// The file has ended.
    fn end(&self) -> Result<()> {
        match self.promised {
            Some(promised) if promised != self.found => damaged(format!(
                "the MP3 header promises {promised} frames, the file has {}: it is cut short, or the header lies",
                self.found
            )),
            _ => Ok(()),
        }
    }
}

impl Decode for Mp3<'_> {
    fn rate_hz(&self) -> u32 {
        self.rate_hz
    }

    fn channels(&self) -> usize {
        usize::from(self.channels.num())
    }

    fn next(&mut self, out: &mut Vec<f64>) -> Result<bool> {
        let Some(frame) = self.frames.peek()? else {
            self.end()?;
            return Ok(false);
        };
        if (frame.rate_hz, frame.channels) != (self.rate_hz, self.channels) {
            return damaged(format!("rate or number of channels changes at byte {}", frame.at));
        }
        let mut buffer = [0f32; MAX_SAMPLES_PER_FRAME];
        let (_, result) = self.decoder.decode(self.frames.bytes(frame), &mut buffer);
        result.map_err(library(format!(
            "the MP3 frame at byte {} cannot be decoded",
            frame.at
        )))?;
        self.frames.take(frame);
        self.found += 1;
        let channels = self.channels();
        self.held
            .extend(buffer[..frame.samples * channels].iter().map(|&s| f64::from(s)));
        let late = self.skip.min((self.held.len() / channels) as u64);
        self.held.drain(..late as usize * channels);
        self.skip -= late;
        out.extend(
            self.held
                .drain(..self.held.len().saturating_sub(self.hold * channels)),
        );
        Ok(true)
    }
}

/// One frame in a window.
#[derive(Clone, Copy)]
struct Frame {
    /// Where it begins and ends in the window.
    start: usize,
    end: usize,
    /// Where it begins in the file.
    at: u64,
    rate_hz: u32,
    channels: Channels,
    samples: usize,
}

/// The frames of a file, found in windows of it; refuses bytes between them that are none.
struct Frames<'a> {
    input: Input<'a>,
    window: Vec<u8>,
    /// Where the window begins in the file.
    at: u64,
    ended: bool,
    /// Frames found in the window, the next one last.
    found: Vec<Frame>,
    /// Bytes of the window that have been taken.
    taken: usize,
}

impl<'a> Frames<'a> {
    fn new(input: Input<'a>) -> Self {
        Self {
            at: input.at(),
            input,
            window: Vec::new(),
            ended: false,
            found: Vec::new(),
            taken: 0,
        }
    }

    /// The bytes of a frame of [`Frames::peek`].
    fn bytes(&self, frame: Frame) -> &[u8] {
        &self.window[frame.start..frame.end]
    }

    /// Goes on behind a frame of [`Frames::peek`].
    fn take(&mut self, frame: Frame) {
        self.found.pop();
        self.taken = frame.end;
    }

    /// The next frame; None when the file has ended.
    fn peek(&mut self) -> Result<Option<Frame>> {
        while self.found.is_empty() && !(self.ended && self.taken == self.window.len()) {
            self.look_on()?;
        }
        Ok(self.found.last().copied())
    }

    /// Fills the window and finds the frames in it.
    fn look_on(&mut self) -> Result<()> {
        self.window.drain(..self.taken);
        self.at += self.taken as u64;
        self.taken = 0;
        let most = self.window.len() + WINDOW;
        if most > MOST_TRAILING {
            return damaged(format!("what follows byte {} is no MP3 frame", self.at));
        }
        self.ended = self.input.append(WINDOW, &mut self.window)? < WINDOW;
        // What follows the last frame would cost the frames before it, behind which ten more are looked for.
        let end = match self.ended {
            true => end_of_frames(&self.window),
            false => self.window.len(),
        };
        let mut place = 0;
        for frame in frames(&self.window[..end]) {
            let (start, stop) = (frame.offset, frame.offset + frame.data.len());
            if !self.ended && stop + MARGIN > end {
                break;
            }
            self.refuse_gap(place, start, "no MP3 frame: the file is damaged")?;
            place = stop;
            self.found.push(Frame {
                start,
                end: stop,
                at: self.at + start as u64,
                rate_hz: frame.sample_rate,
                channels: frame.channels,
                samples: frame.samples,
            });
        }
        self.found.reverse();
        if self.ended {
            self.refuse_gap(place, end, "no whole MP3 frame: the file is cut short or damaged")?;
            if self.found.is_empty() {
                self.taken = self.window.len();
            }
        } else if self.found.is_empty() {
            // Zeros are passed over; whatever else is a tag, or damaged, shows at the end.
            self.taken = self.window.iter().take_while(|&&byte| byte == 0).count();
        }
        Ok(())
    }

    fn refuse_gap(&self, from: usize, to: usize, what: &str) -> Result<()> {
        match self.window[from..to].iter().any(|&byte| byte != 0) {
            true => damaged(format!(
                "the {} bytes at byte {} are {what}",
                to - from,
                self.at + from as u64
            )),
            false => Ok(()),
        }
    }
}

/// Where the frames end in the last bytes of a file, behind which are tags and zeros.
///
/// The last frame may end in zeros of its own, so that where the zeros behind it begin is tried out.
fn end_of_frames(bytes: &[u8]) -> usize {
    let whole = strip_trailing_tags(bytes).len();
    let start = whole.saturating_sub(MARGIN);
    let ends_at = |end: usize| {
        let last = frames(&bytes[start..end]).last();
        last.is_some_and(|frame| start + frame.offset + frame.data.len() == end)
    };
    if ends_at(whole) {
        return whole;
    }
    let mut rest = bytes;
    loop {
        // Tags may end in zeros themselves, and go first.
        let tagless = strip_trailing_tags(rest);
        let zeros = tagless.iter().rev().take_while(|&&byte| byte == 0).count();
        let less = &tagless[..tagless.len() - zeros];
        if less.len() == rest.len() {
            break;
        }
        rest = less;
    }
    let most = bytes.len().min(rest.len() + LONGEST_FRAME);
    (rest.len().max(start)..=most)
        .find(|&end| ends_at(end))
        .unwrap_or(whole)
}
