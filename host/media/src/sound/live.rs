//! Sound that is made while it is read.
use std::io;

use super::{Decode, Result};

/// Samples from somebody who is called for them.
pub(super) struct Live<F> {
    pub(super) rate_hz: u32,
    pub(super) channels: usize,
    pub(super) next: F,
}

impl<F: FnMut(&mut Vec<f64>) -> io::Result<bool> + Send> Decode for Live<F> {
    fn rate_hz(&self) -> u32 {
        self.rate_hz
    }

    fn channels(&self) -> usize {
        self.channels
    }

    /// Whoever is called averages them.
    fn interleaved(&self) -> usize {
        1
    }

    fn next(&mut self, out: &mut Vec<f64>) -> Result<bool> {
        Ok((self.next)(out)?)
    }
}
