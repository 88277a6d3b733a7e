//! What ends the program ends it visibly: words on the UART, a code on the LED, and then a new start.
//!
//! | LED | |
//! |---|---|
//! | twice, pause | a panic, such as a model that is refused; the words say which |
//! | three times, pause | a hard fault |
//!
//! A program that hangs, and a processor that gave up (a fault within a fault: the stack was too small), are started again by the watchdog.
use core::fmt::{self, Write};

use cortex_m::peripheral::SCB;
use cortex_m_rt::{ExceptionFrame, exception};

use crate::hal;
use hal::pac;

/// The LED's pin.
const LED: u32 = 25;
/// What `delay` is told for a tenth to a quarter of a second: it takes one to two times as many cycles, by the processor.
const SHORT: u32 = 16_000_000;
/// How often the code is shown before the new start.
const ROUNDS: u32 = 4;

/// UART0 without interrupts. Does nothing where it was not set up yet.
struct Words;

impl Write for Words {
    fn write_str(&mut self, words: &str) -> fmt::Result {
        // SAFETY: interrupts are off for good, so nobody else uses it any more.
        let uart = unsafe { &*pac::UART0::ptr() };
        if uart.uartcr().read().uarten().bit_is_clear() {
            return Ok(());
        }
        for byte in words.bytes() {
            while uart.uartfr().read().txff().bit_is_set() {}
            // SAFETY: any byte.
            uart.uartdr().write(|w| unsafe { w.bits(byte.into()) });
        }
        Ok(())
    }
}

fn end(blinks: u32, words: fmt::Arguments) -> ! {
    cortex_m::interrupt::disable();
    // Between zeros, so that a receiver of messages is back in step.
    let _ = write!(Words, "\0lipstream: {words}\r\n\0");
    // SAFETY: the LED alone; the watchdog is off as long as the code is shown.
    let (pins, watchdog) = unsafe { (&*pac::SIO::ptr(), &*pac::WATCHDOG::ptr()) };
    watchdog.ctrl().modify(|_, w| w.enable().clear_bit());
    for _ in 0..ROUNDS {
        // SAFETY: one pin's bit each.
        pins.gpio_out_clr().write(|w| unsafe { w.bits(1 << LED) });
        cortex_m::asm::delay(4 * SHORT);
        for _ in 0..2 * blinks {
            // SAFETY: the same.
            pins.gpio_out_xor().write(|w| unsafe { w.bits(1 << LED) });
            cortex_m::asm::delay(SHORT);
        }
    }
    SCB::sys_reset()
}

#[panic_handler]
fn panic(info: &core::panic::PanicInfo) -> ! {
    end(2, format_args!("{}", info.message()))
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    end(3, format_args!("hard fault at {:#x}", frame.pc()))
}
