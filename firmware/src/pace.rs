//! Which frames go out: all of them, or every nth where the line is too slow for all. Whole frames always.
//!
//! By rule, so that a host and a test can say beforehand what a device does (docs/wire.md has the table):
//!
//! 1. At the start every nth frame goes out, n the least of [`EVERY`] with which frames of usual size, and what is said once a second
//!    beside them, take at most [`SHARE`] of the line.
//! 2. A second whose messages were more than the line carries is followed by the next n: parameters are shorter where they are small,
//!    and their usual size is no promise. It does not come down again before the next start: a rate that goes to and fro is worse
//!    to look at than a low one.
use lipstream_core::wire::{LONGEST_STATUS, encoded_size, longest_hello};

use crate::app::RATE_HZ;

/// Every how many frames of 10 ms one goes out: the divisors of [`RATE_HZ`], so that the rates are whole numbers.
pub const EVERY: [u16; 9] = [1, 2, 4, 5, 10, 20, 25, 50, 100];
/// Share of the line, in hundredths, that messages of usual size may take.
pub const SHARE: u32 = 95;

/// Bytes a second that a UART carries at a baud rate: start, eight bits, stop.
pub const fn uart_bytes_per_second(baud: u32) -> u32 {
    baud / 10
}

/// Bytes on the line of a frame: its parameters have two bytes each (a value of 64 to 8191 in size; smaller ones have one byte, larger ones
/// three), its sequence and its sample are those of the first hour.
pub const fn usual_frame(parameters: usize, visemes: usize) -> usize {
    encoded_size(1 + 3 + 4 + 1 + 2 * parameters + 1 + visemes)
}

/// Bytes of `Hello`, of one group, and `Status`, at most: what is said once a second.
const fn round(parameters: usize) -> usize {
    encoded_size(longest_hello(1, parameters)) + encoded_size(LONGEST_STATUS)
}

/// Bytes a second of frames of usual size, and what is said beside them, at a rate.
pub const fn usual_bytes_per_second(parameters: usize, visemes: usize, rate_hz: u16) -> u32 {
    (usual_frame(parameters, visemes) * rate_hz as usize + round(parameters)) as u32
}

/// Says of each frame whether it goes out.
#[derive(Clone, Debug)]
pub struct Pace {
    /// Bytes a second; None where the line is never full or waits for nobody.
    line: Option<u32>,
    /// Index in [`EVERY`].
    step: u8,
    /// Bytes said since the round began.
    said: u32,
}

impl Pace {
    /// The pace for a line of so many bytes a second.
    pub fn new(line: Option<u32>, parameters: usize, visemes: usize) -> Self {
        let fits = |every: &u16| {
            let bytes = u64::from(usual_bytes_per_second(parameters, visemes, RATE_HZ / every));
            line.is_none_or(|line| bytes * 100 <= u64::from(line) * u64::from(SHARE))
        };
        let step = EVERY.iter().position(fits).unwrap_or(EVERY.len() - 1) as u8;
        Self { line, step, said: 0 }
    }

    /// Every how many frames one goes out.
    pub fn every(&self) -> u32 {
        EVERY
            .get(usize::from(self.step))
            .copied()
            .unwrap_or(RATE_HZ)
            .into()
    }

    /// Frames a second.
    pub fn rate_hz(&self) -> u16 {
        RATE_HZ / self.every() as u16
    }

    /// So many bytes were given to the line, whether it took them or not.
    pub fn says(&mut self, bytes: usize) {
        self.said = self.said.saturating_add(bytes as u32);
    }

    /// A second is over; whether the rate falls from here.
    pub fn round(&mut self) -> bool {
        let said = core::mem::take(&mut self.said);
        let slower = self.line.is_some_and(|line| said > line) && usize::from(self.step) + 1 < EVERY.len();
        self.step += u8::from(slower);
        slower
    }
}
