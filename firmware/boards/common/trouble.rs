//! What ends the program ends it visibly: servos let go, a `Notice` on the UART, which a terminal shows as its words, a code on the LED, and then a new start.
//!
//! | LED | |
//! |---|---|
//! | twice, pause | a panic, such as a model that is refused; the words say which |
//! | three times, pause | a hard fault |
//!
//! A program that hangs, and a processor that gave up (a fault within a fault: the stack was too small), are started again by the watchdog. A
//! board says in its own `visible` how it ends its servos' pulses, sends a byte, turns its LED, and keeps its watchdog waiting.
use core::fmt;

use cortex_m::peripheral::SCB;
use cortex_m_rt::{ExceptionFrame, exception};
use lipstream_core::wire::{MAX_ENCODED, Notice, ToHost, encode};

use super::visible;

/// What `delay` is told for a tenth to a quarter of a second: it takes one to two times as many cycles, by the processor.
const SHORT: u32 = 16_000_000;
/// How often the code is shown before the new start.
const ROUNDS: u32 = 4;

fn end(blinks: u32, words: fmt::Arguments) -> ! {
    cortex_m::interrupt::disable();
    visible::release();
    #[cfg(feature = "defmt")]
    super::log::ended(&words);
    // The zero ends whatever stands half sent on the line.
    visible::put(0);
    if let Ok(bytes) = encode(&ToHost::Notice(Notice::new(words)), &mut [0; MAX_ENCODED]) {
        bytes.iter().copied().for_each(visible::put);
    }
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
