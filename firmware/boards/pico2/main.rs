//! lipstream on the Raspberry Pi Pico 2 (RP2350, its Cortex-M33): an I²S microphone in, parameters on USB and UART.
#![no_std]
#![no_main]

use hal::block::ImageDef;
use hal::clocks::{ClocksManager, InitError, init_clocks_and_plls};
use hal::{Watchdog, pac};
use rp235x_hal as hal;

#[path = "../rp2/mod.rs"]
mod rp2;

/// Tells the ROM that this is a program, and for which processor.
#[unsafe(link_section = ".start_block")]
#[used]
static IMAGE: ImageDef = ImageDef::secure_exe();

/// The HAL's own 150 MHz.
fn begin_clocks(
    crystal: pac::XOSC,
    clocks: pac::CLOCKS,
    pll_sys: pac::PLL_SYS,
    pll_usb: pac::PLL_USB,
    resets: &mut pac::RESETS,
    watchdog: &mut Watchdog,
) -> Result<ClocksManager, InitError> {
    init_clocks_and_plls(
        rp2::CRYSTAL_HZ,
        crystal,
        clocks,
        pll_sys,
        pll_usb,
        resets,
        watchdog,
    )
}

#[hal::entry]
fn main() -> ! {
    rp2::run()
}
