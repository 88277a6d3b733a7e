//! Rows of numbers for spreadsheets and scripts.
use std::io::{self, Write};

use super::Numbers;
use crate::phones::VISEMES;
use crate::session::Frame;
use crate::time::frame_seconds;

pub(super) struct Csv<W>(W);

impl<W: Write> Csv<W> {
    pub(super) fn new(mut to: W, n_parameters: usize) -> io::Result<Self> {
        write!(to, "time_s")?;
        for d in 1..=n_parameters {
            write!(to, ",p{d}")?;
        }
        for viseme in VISEMES {
            write!(to, ",{viseme}")?;
        }
        writeln!(to)?;
        Ok(Self(to))
    }
}

impl<W: Write> Numbers for Csv<W> {
    fn frame(&mut self, frame: &Frame) -> io::Result<()> {
        write!(self.0, "{:.4}", frame_seconds(frame.index))?;
        for value in frame.parameters.iter().chain(frame.visemes) {
            write!(self.0, ",{value}")?;
        }
        writeln!(self.0)
    }

    fn finish(mut self: Box<Self>) -> io::Result<()> {
        self.0.flush()
    }
}
