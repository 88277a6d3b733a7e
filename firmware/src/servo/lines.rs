//! Servos behind a serial line: a Maestro, or another board that reads CSV.
use core::fmt::{self, Write};

use lipstream_core::servo::output;

use super::{NoAnswer, Outputs, Wanted};

/// Bytes that leave by a serial line.
pub trait Sender {
    /// Sends one, waiting for room.
    fn put(&mut self, byte: u8);
}

/// Commands "Set Target" of the compact protocol, channel by channel, each hop.
pub struct Maestro<S>(pub S);

/// Maestros have 24 channels at most.
const MAESTRO_CHANNELS: u8 = 24;

impl<S: Sender> Maestro<S> {
    fn set(&mut self, channel: u8, pulse: u16) {
        output::maestro(channel, pulse)
            .into_iter()
            .for_each(|byte| self.0.put(byte));
    }
}

impl<S: Sender> Outputs for Maestro<S> {
    fn has(&self, output: u8) -> bool {
        output < MAESTRO_CHANNELS
    }

    fn give(&mut self, pulses: &mut dyn Iterator<Item = Wanted>) -> Result<(), NoAnswer> {
        for (channel, pulse) in pulses {
            if let Some(pulse) = pulse {
                self.set(channel, pulse);
            }
        }
        Ok(())
    }

    fn release(&mut self) {
        for channel in 0..MAESTRO_CHANNELS {
            self.set(channel, output::MAESTRO_OFF);
        }
    }
}

/// A line of microseconds each hop, a column a channel, 0.00 for a channel that is to have no pulses.
pub struct Csv<S>(pub S);

impl<S: Sender> Write for Csv<S> {
    fn write_str(&mut self, words: &str) -> fmt::Result {
        words.bytes().for_each(|byte| self.0.put(byte));
        Ok(())
    }
}

impl<S: Sender> Outputs for Csv<S> {
    fn has(&self, _: u8) -> bool {
        true
    }

    fn give(&mut self, pulses: &mut dyn Iterator<Item = Wanted>) -> Result<(), NoAnswer> {
        let columns = pulses.map(|(_, pulse)| pulse.unwrap_or(0));
        output::csv(columns, self).map_err(|_| NoAnswer)
    }

    /// Nothing to say: who gets no lines holds what it has.
    fn release(&mut self) {}
}
