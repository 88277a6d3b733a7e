//! NumPy's array file. Its header says how many rows there are, so that the rows wait in a temporary file.
use std::io::{self, Write};

use super::{Numbers, Spool};
use crate::session::Frame;

pub(super) struct Npy<W> {
    to: W,
    rows: Spool,
    count: usize,
    width: usize,
}

impl<W: Write> Npy<W> {
    pub(super) fn new(to: W, width: usize) -> io::Result<Self> {
        Ok(Self {
            to,
            rows: Spool::new()?,
            count: 0,
            width,
        })
    }
}

impl<W: Write> Numbers for Npy<W> {
    fn frame(&mut self, frame: &Frame) -> io::Result<()> {
        for value in frame.parameters {
            self.rows.write_all(&value.to_le_bytes())?;
        }
        self.count += 1;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> io::Result<()> {
        // Version 1.0: magic, version, length of the header, and the header as a Python dictionary, filled up with spaces so that the
        // numbers begin at a multiple of 64.
        let (count, width) = (self.count, self.width);
        let mut header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({count}, {width}), }}");
        let before = 10;
        let whole = (before + header.len() + 1).next_multiple_of(64);
        while header.len() + 1 < whole - before {
            header.push(' ');
        }
        header.push('\n');
        self.to.write_all(b"\x93NUMPY\x01\x00")?;
        self.to.write_all(&(header.len() as u16).to_le_bytes())?;
        self.to.write_all(header.as_bytes())?;
        self.rows.pour(&mut self.to)?;
        self.to.flush()
    }
}
