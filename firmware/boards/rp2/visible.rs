//! Words and light without interrupts, when the program is over (`common/trouble.rs`).
use crate::hal;
use hal::pac;

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
