//! What ends the program ends it visibly: servos let go, words on the UART, a code on the LED, and then a new start.
//!
//! | LED | |
//! |---|---|
//! | twice, pause | a panic, such as a model that is refused; the words say which |
//! | three times, pause | a hard fault |
//!
//! A program that hangs, and a processor that gave up (a fault within a fault: the stack was too small), are started again by the watchdog. A
//! board says in its own `visible` how it ends its servos' pulses, sends a byte, turns its LED, and keeps its watchdog waiting.
use core::fmt::{self, Write};

use cortex_m::peripheral::SCB;
use cortex_m_rt::{ExceptionFrame, exception};

use super::visible;

/// What `delay` is told for a tenth to a quarter of a second: it takes one to two times as many cycles, by the processor.
const SHORT: u32 = 16_000_000;
/// How often the code is shown before the new start.
const ROUNDS: u32 = 4;

struct Words;

impl Write for Words {
    fn write_str(&mut self, words: &str) -> fmt::Result {
        words.bytes().for_each(visible::put);
        Ok(())
    }
}

fn end(blinks: u32, words: fmt::Arguments) -> ! {
    cortex_m::interrupt::disable();
    visible::release();
    // Between zeros, so that a receiver of messages is back in step.
    let _ = write!(Words, "\0lipstream: {words}\r\n\0");
    for _ in 0..ROUNDS {
        visible::led(false);
        visible::keep();
        cortex_m::asm::delay(4 * SHORT);
        for change in 0..2 * blinks {
            visible::led(change % 2 == 0);
            visible::keep();
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
