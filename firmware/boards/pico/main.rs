//! lipstream on the Raspberry Pi Pico (RP2040, Cortex-M0+): an I²S microphone in, parameters on USB and UART.
#![no_std]
#![no_main]

use rp2040_hal as hal;

#[path = "../rp2/mod.rs"]
mod rp2;

/// The flash chip's set-up, which the ROM runs first.
#[unsafe(link_section = ".boot2")]
#[used]
static BOOT2: [u8; 256] = rp2040_boot2::BOOT_LOADER_W25Q080;

#[hal::entry]
fn main() -> ! {
    rp2::run()
}
