//! lipstream on the Raspberry Pi Pico 2 (RP2350, its Cortex-M33): an I²S microphone in, parameters on USB and UART.
#![no_std]
#![no_main]

use hal::block::ImageDef;
use rp235x_hal as hal;

#[path = "../rp2/mod.rs"]
mod rp2;

/// Tells the ROM that this is a program, and for which processor.
#[unsafe(link_section = ".start_block")]
#[used]
static IMAGE: ImageDef = ImageDef::secure_exe();

#[hal::entry]
fn main() -> ! {
    rp2::run()
}
