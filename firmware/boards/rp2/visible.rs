//! Words, light and servos without interrupts, when the program is over (`common/trouble.rs`).
use crate::hal;
use hal::pac;
use lipstream_core::servo::output::PCA9685_ALL_OFF;

/// The LED's pin.
const LED: u32 = 25;

/// Sends a byte on UART0. Does nothing where that was not set up yet.
pub(crate) fn put(byte: u8) {
    // SAFETY: interrupts are off for good, so nobody else uses it any more.
    let uart = unsafe { &*pac::UART0::ptr() };
    if uart.uartcr().read().uarten().bit_is_clear() {
        return;
    }
    while uart.uartfr().read().txff().bit_is_set() {}
    // SAFETY: any byte.
    uart.uartdr().write(|w| unsafe { w.bits(byte.into()) });
}

pub(crate) fn led(on: bool) {
    // SAFETY: as above, and one pin's bit.
    unsafe {
        let pins = &*pac::SIO::ptr();
        if on {
            pins.gpio_out_set().write(|w| w.bits(1 << LED));
        } else {
            pins.gpio_out_clr().write(|w| w.bits(1 << LED));
        }
    }
}

/// The watchdog lets the code be shown.
pub(crate) fn keep() {
    // SAFETY: as above.
    let watchdog = unsafe { &*pac::WATCHDOG::ptr() };
    watchdog.ctrl().modify(|_, w| w.enable().clear_bit());
}

/// Ends all pulses: those on the pins with the period that has begun, those of a PCA9685 as soon as its bus has carried two bytes.
pub(crate) fn release() {
    // SAFETY: as above; compare values of 0, and two bytes for a bus that its controller sends by itself.
    unsafe {
        let pwm = &*pac::PWM::ptr();
        for slice in 1..=3 {
            pwm.ch(slice).cc().write(|w| w.bits(0));
        }
        let bus = &*pac::I2C0::ptr();
        if bus.ic_enable().read().enable().bit_is_set() {
            let [register, value] = PCA9685_ALL_OFF;
            // Behind whatever was being sent, as a message of its own.
            bus.ic_data_cmd()
                .write(|w| w.restart().set_bit().dat().bits(register));
            bus.ic_data_cmd().write(|w| w.stop().set_bit().dat().bits(value));
        }
    }
}

/// Since the start; it begins anew after 71 minutes.
#[cfg(feature = "defmt")]
pub(crate) fn microseconds() -> u32 {
    #[cfg(feature = "pico")]
    use pac::TIMER;
    #[cfg(feature = "pico2")]
    use pac::TIMER0 as TIMER;
    // SAFETY: reading the count has no effect.
    unsafe { (*TIMER::ptr()).timerawl().read().bits() }
}

/// What stands in a register that only power and the reset pin clear when the program has ended by itself.
#[cfg(feature = "defmt")]
const ENDED: u32 = u32::from_le_bytes(*b"over");

/// The next start is by the program itself.
#[cfg(feature = "defmt")]
pub(crate) fn about_to_end() {
    // SAFETY: a register that means nothing to the chip.
    unsafe { (*pac::WATCHDOG::ptr()).scratch0().write(|w| w.bits(ENDED)) };
}

/// What made the chip start. The watchdog's own register goes on saying so after a debug probe's start.
#[cfg(feature = "defmt")]
pub(crate) fn why_started() -> &'static str {
    // SAFETY: as above; reading the reason has no effect.
    let watchdog = unsafe { &*pac::WATCHDOG::ptr() };
    let ended = watchdog.scratch0().read().bits() == ENDED;
    // SAFETY: as above.
    watchdog.scratch0().write(|w| unsafe { w.bits(0) });
    if ended {
        "the program itself"
    } else if watchdog.reason().read().timer().bit_is_set() {
        "the watchdog"
    } else {
        "power, its reset pin or a probe"
    }
}
