//! Words, light and servos without interrupts, when the program is over (`common/trouble.rs`).
use core::sync::atomic::{AtomicU32, Ordering};

use nrf52840_hal::pac;

/// Bit of the LED's pin, which is one of port 0; 0 until the board has said which.
static LED: AtomicU32 = AtomicU32::new(0);
/// Cycles that a byte may take: more than its 87 µs.
const BYTE_CYCLES: u32 = 10_000;

/// The LED is on this pin of port 0.
pub(crate) fn led_is(pin: u8) {
    LED.store(1 << pin, Ordering::Relaxed);
}

/// Sends a byte on the UART. Does nothing where that was not set up yet.
pub(crate) fn put(byte: u8) {
    // SAFETY: interrupts are off for good, so nobody else uses it any more.
    let uart = unsafe { &*pac::UART0::ptr() };
    if uart.enable.read().bits() == 0 {
        return;
    }
    // Whatever was on its way is gone by then, and so is this byte before the next.
    cortex_m::asm::delay(BYTE_CYCLES);
    // SAFETY: any byte.
    uart.txd.write(|w| unsafe { w.txd().bits(byte) });
}

pub(crate) fn led(on: bool) {
    let bit = LED.load(Ordering::Relaxed);
    // SAFETY: as above, and one pin's bit.
    unsafe {
        let pins = &*pac::P0::ptr();
        if on {
            pins.outset.write(|w| w.bits(bit));
        } else {
            pins.outclr.write(|w| w.bits(bit));
        }
    }
}

/// Starts the watchdog: four seconds, long enough for the longest darkness of a code. It cannot be stopped.
pub(crate) fn begin_watchdog(watchdog: &pac::WDT) {
    // SAFETY: 32,768 a second; one register to reload it; starting has no other effect.
    unsafe {
        watchdog.crv.write(|w| w.bits(4 * 32_768));
        watchdog.rren.write(|w| w.bits(1));
        watchdog.tasks_start.write(|w| w.bits(1));
    }
}

/// The watchdog begins to wait anew. Without effect before it was started.
pub(crate) fn keep() {
    // SAFETY: the word that reloads it, from wherever it is written.
    unsafe { (*pac::WDT::ptr()).rr[0].write(|w| w.bits(0x6e52_4635)) };
}

/// Ends all pulses, with the period that has begun.
pub(crate) fn release() {
    // SAFETY: stopping has no other effect, whether they were begun or not.
    unsafe {
        (*pac::PWM0::ptr()).tasks_stop.write(|w| w.bits(1));
        (*pac::PWM1::ptr()).tasks_stop.write(|w| w.bits(1));
    }
}

/// Since the start; it begins anew after 71 minutes.
#[cfg(feature = "defmt")]
pub(crate) fn microseconds() -> u32 {
    // SAFETY: copies the count to a register of its own, and reads it.
    unsafe {
        let timer = &*pac::TIMER0::ptr();
        timer.tasks_capture[1].write(|w| w.bits(1));
        timer.cc[1].read().bits()
    }
}

/// The next start is by the program itself: the chip knows that.
#[cfg(feature = "defmt")]
pub(crate) fn about_to_end() {}

/// What made the chip start, as its register says, which is emptied for the next time.
#[cfg(feature = "defmt")]
pub(crate) fn why_started() -> &'static str {
    // SAFETY: reads the register; a one that is written takes that reason away.
    let reason = unsafe {
        let power = &*pac::POWER::ptr();
        let reason = power.resetreas.read();
        power.resetreas.write(|w| w.bits(reason.bits()));
        reason
    };
    if reason.dog().bit_is_set() {
        "the watchdog"
    } else if reason.lockup().bit_is_set() {
        "a processor that gave up"
    } else if reason.sreq().bit_is_set() {
        "the program itself or a probe"
    } else if reason.resetpin().bit_is_set() {
        "its reset pin"
    } else {
        "power"
    }
}
