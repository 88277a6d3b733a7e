//! Servos on the board's own pins, through `embedded-hal`'s PWM.
use core::convert::Infallible;

use embedded_hal::pwm::SetDutyCycle;
use lipstream_core::servo::Pulse;

use super::{NoAnswer, Outputs, Wanted};

/// What hobby servos are made for: a pulse every 20 ms. The board sets its counters to it.
pub const PERIOD_US: u32 = 20_000;

/// A pin that makes pulses, and cannot fail to.
pub type ServoPin = dyn SetDutyCycle<Error = Infallible>;

/// Output k is pin k. A duty cycle of 1 is a whole period of [`PERIOD_US`].
pub struct Pins<'p, const N: usize>(pub [&'p mut ServoPin; N]);

/// A pulse as a share of the period, in the pin's own steps.
fn duty(pulse: Pulse, pin: &ServoPin) -> u16 {
    let most = u32::from(pin.max_duty_cycle());
    let period = 4 * PERIOD_US;
    // Pulses are at most 10,400: below 2³⁰.
    ((u32::from(pulse) * most + period / 2) / period).min(most) as u16
}

impl<const N: usize> Outputs for Pins<'_, N> {
    fn has(&self, output: u8) -> bool {
        usize::from(output) < N
    }

    fn give(&mut self, pulses: &mut dyn Iterator<Item = Wanted>) -> Result<(), NoAnswer> {
        for (output, pulse) in pulses {
            if let Some(pin) = self.0.get_mut(usize::from(output)) {
                let duty = pulse.map_or(0, |pulse| duty(pulse, *pin));
                let Ok(()) = pin.set_duty_cycle(duty);
            }
        }
        Ok(())
    }

    fn release(&mut self) {
        for pin in &mut self.0 {
            let Ok(()) = pin.set_duty_cycle(0);
        }
    }
}
