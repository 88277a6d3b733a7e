//! Servos on NXP's PCA9685, sixteen outputs on an I²C bus, through `embedded-hal`.
use embedded_hal::i2c::I2c;
use lipstream_core::servo::output::{
    PCA9685_ALL_OFF, PCA9685_AWAKE, PCA9685_MODE_REGISTER, PCA9685_PRESCALE, PCA9685_PRESCALE_REGISTER,
    PCA9685_SLEEP, pca9685,
};
use lipstream_core::servo::{MAX_CHANNELS, Pulse};

use super::{NoAnswer, Outputs, Wanted};

/// Its address with all jumpers open.
pub const ADDRESS: u8 = 0x40;
/// Hops between two writings: it makes a pulse every 20 ms, and the bus takes the processor's time.
const EVERY: u8 = 2;
/// Hops after which a chip that did not answer is asked again: half a second.
const PATIENCE: u8 = 50;

/// The chip on its bus.
pub struct Pca9685<I> {
    bus: I,
    /// It was set up, and has answered since.
    ready: bool,
    /// Hops until it is written to.
    wait: u8,
    /// What each channel's output was last told, in the order of the channels.
    told: [Option<Pulse>; MAX_CHANNELS],
}

impl<I: I2c> Pca9685<I> {
    /// The chip at [`ADDRESS`], which is not spoken to yet.
    pub fn new(bus: I) -> Self {
        Self {
            bus,
            ready: false,
            wait: 0,
            told: [None; MAX_CHANNELS],
        }
    }

    fn say(&mut self, bytes: &[u8]) -> Result<(), NoAnswer> {
        self.bus.write(ADDRESS, bytes).map_err(|_| {
            self.ready = false;
            NoAnswer
        })
    }

    /// No pulses, 50 of them a second. The chip keeps what it was told before when the board starts anew, so that it comes first.
    fn set_up(&mut self) -> Result<(), NoAnswer> {
        self.told = [None; MAX_CHANNELS];
        self.say(&PCA9685_ALL_OFF)?;
        self.say(&[PCA9685_MODE_REGISTER, PCA9685_SLEEP])?;
        self.say(&[PCA9685_PRESCALE_REGISTER, PCA9685_PRESCALE])?;
        self.say(&[PCA9685_MODE_REGISTER, PCA9685_AWAKE])?;
        self.ready = true;
        Ok(())
    }

    fn write(&mut self, pulses: &mut dyn Iterator<Item = Wanted>) -> Result<(), NoAnswer> {
        if !self.ready {
            // Its oscillator needs 500 µs to start: pulses come with the next hop.
            return self.set_up();
        }
        for (channel, (output, pulse)) in pulses.enumerate().take(MAX_CHANNELS) {
            let (Some(pulse), true) = (pulse, self.told[channel] != pulse) else {
                continue;
            };
            if let Some(bytes) = pca9685(output, pulse) {
                self.say(&bytes)?;
                self.told[channel] = Some(pulse);
            }
        }
        Ok(())
    }
}

impl<I: I2c> Outputs for Pca9685<I> {
    fn has(&self, output: u8) -> bool {
        output < 16
    }

    fn give(&mut self, pulses: &mut dyn Iterator<Item = Wanted>) -> Result<(), NoAnswer> {
        if self.wait > 0 {
            self.wait -= 1;
            return if self.ready { Ok(()) } else { Err(NoAnswer) };
        }
        let done = self.write(pulses);
        self.wait = if done.is_ok() { EVERY } else { PATIENCE } - 1;
        done
    }

    fn release(&mut self) {
        // Who does not answer now is asked again with the first pulses.
        self.wait = 0;
        let _ = self.set_up();
    }
}
