//! One JSON object. Its second array waits in a temporary file until the first one is complete.
use std::io::{self, Write};

use super::{Numbers, Spool};
use crate::phones::VISEMES;
use crate::session::Frame;
use crate::time::{FRAME_RATE_HZ, frame_seconds};

pub(super) struct Json<W> {
    to: W,
    visemes: Spool,
    begun: bool,
}

impl<W: Write> Json<W> {
    pub(super) fn new(mut to: W) -> io::Result<Self> {
        let first = frame_seconds(0);
        write!(to, "{{\"first_frame_s\":{first},\"parameters\":[")?;
        Ok(Self {
            to,
            visemes: Spool::new()?,
            begun: false,
        })
    }
}

impl<W: Write> Numbers for Json<W> {
    fn frame(&mut self, frame: &Frame) -> io::Result<()> {
        if std::mem::replace(&mut self.begun, true) {
            self.to.write_all(b",")?;
            self.visemes.write_all(b",")?;
        }
        serde_json::to_writer(&mut self.to, frame.parameters)?;
        serde_json::to_writer(&mut self.visemes, frame.visemes)?;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> io::Result<()> {
        let names = serde_json::to_string(&VISEMES)?;
        write!(
            self.to,
            "],\"rate_hz\":{FRAME_RATE_HZ},\"viseme_names\":{names},\"viseme_weights\":["
        )?;
        self.visemes.pour(&mut self.to)?;
        writeln!(self.to, "]}}")?;
        self.to.flush()
    }
}
