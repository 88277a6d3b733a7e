//! Rows of numbers for spreadsheets and scripts.
use std::io::{self, Write};

use super::{Numbers, Openness};
use crate::phones::VISEMES;
use crate::session::Frame;
use crate::time::frame_seconds;

pub(super) struct Csv<W> {
    to: W,
    openness: Openness,
}

impl<W: Write> Csv<W> {
    pub(super) fn new(mut to: W, n_parameters: usize, openness: Openness) -> io::Result<Self> {
        write!(to, "time_s")?;
        for d in 1..=n_parameters {
            write!(to, ",p{d}")?;
        }
        for viseme in VISEMES {
            write!(to, ",{viseme}")?;
        }
        writeln!(to, ",open")?;
        Ok(Self { to, openness })
    }
}

impl<W: Write> Numbers for Csv<W> {
    fn frame(&mut self, frame: &Frame) -> io::Result<()> {
        write!(self.to, "{:.4}", frame_seconds(frame.index))?;
        for value in frame.parameters {
            write!(self.to, ",{value}")?;
        }
        // What is not known is an empty cell, so that every column stays in its place.
        for viseme in 0..VISEMES.len() {
            cell(&mut self.to, frame.visemes.get(viseme))?;
        }
        cell(&mut self.to, self.openness.of(frame).as_ref())?;
        writeln!(self.to)
    }

    fn finish(mut self: Box<Self>) -> io::Result<()> {
        self.to.flush()
    }
}

fn cell(to: &mut impl Write, value: Option<&f32>) -> io::Result<()> {
    match value {
        Some(value) => write!(to, ",{value}"),
        None => write!(to, ","),
    }
}
