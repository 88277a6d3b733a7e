//! One JSON object. Its other arrays wait in temporary files until the first one is complete.
use std::io::{self, Write};

use super::{Numbers, Openness, Spool};
use crate::phones::VISEMES;
use crate::session::Frame;
use crate::time::{FRAME_RATE_HZ, frame_seconds};

pub(super) struct Json<W> {
    to: W,
    visemes: Spool,
    open: Spool,
    openness: Openness,
    begun: bool,
}

impl<W: Write> Json<W> {
    pub(super) fn new(mut to: W, openness: Openness) -> io::Result<Self> {
        let first = frame_seconds(0);
        write!(to, "{{\"first_frame_s\":{first},\"parameters\":[")?;
        Ok(Self {
            to,
            visemes: Spool::new()?,
            open: Spool::new()?,
            openness,
            begun: false,
        })
    }
}

impl<W: Write> Numbers for Json<W> {
    fn frame(&mut self, frame: &Frame) -> io::Result<()> {
        if std::mem::replace(&mut self.begun, true) {
            self.to.write_all(b",")?;
            self.visemes.write_all(b",")?;
            self.open.write_all(b",")?;
        }
        serde_json::to_writer(&mut self.to, frame.parameters)?;
        serde_json::to_writer(&mut self.visemes, frame.visemes)?;
        serde_json::to_writer(&mut self.open, &self.openness.of(frame))?;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> io::Result<()> {
        let names = serde_json::to_string(&VISEMES)?;
        write!(
            self.to,
            "],\"rate_hz\":{FRAME_RATE_HZ},\"viseme_names\":{names},\"viseme_weights\":["
        )?;
        self.visemes.pour(&mut self.to)?;
        write!(self.to, "],\"open\":[")?;
        self.open.pour(&mut self.to)?;
        writeln!(self.to, "]}}")?;
        self.to.flush()
    }
}
