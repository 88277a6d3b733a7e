//! Raw pictures one after the other, for another program's pipe: `ffmpeg -f rawvideo -pix_fmt rgb24 -s WIDTHxHEIGHT -r FPS -i -`.
use std::io::Write;

use super::{Sink, SinkError};

/// Writes rows of R, G, B, nothing between them.
pub struct RawFrames<W>(W);

impl<W: Write> RawFrames<W> {
    /// Pictures go to `to`.
    pub fn new(to: W) -> Self {
        Self(to)
    }
}

impl<W: Write> Sink for RawFrames<W> {
    fn picture(&mut self, rgb: &[u8]) -> Result<(), SinkError> {
        Ok(self.0.write_all(rgb)?)
    }

    fn finish(mut self: Box<Self>) -> Result<(), SinkError> {
        Ok(self.0.flush()?)
    }
}
