//! lipstream on the Raspberry Pi Pico (RP2040, Cortex-M0+): an I²S microphone in, parameters on USB and UART.
#![no_std]
#![no_main]

use hal::clocks::{ClocksManager, InitError};
use hal::fugit::{HertzU32, RateExtU32};
use hal::pll::common_configs::PLL_USB_48MHZ;
use hal::pll::{PLLConfig, setup_pll_blocking};
use hal::xosc::setup_xosc_blocking;
use hal::{Watchdog, pac};
use rp2040_hal as hal;

#[path = "../rp2/mod.rs"]
mod rp2;

/// The flash chip's set-up, which the ROM runs first.
#[unsafe(link_section = ".boot2")]
#[used]
static BOOT2: [u8; 256] = rp2040_boot2::BOOT_LOADER_W25Q080;

/// The most that the processor is made for, 133 MHz: 12 MHz · 133 / 6 / 2. The HAL's own set-up stays at 125.
const PLL_SYS_133MHZ: PLLConfig = PLLConfig {
    vco_freq: HertzU32::MHz(1596),
    refdiv: 1,
    post_div1: 6,
    post_div2: 2,
};

fn begin_clocks(
    crystal: pac::XOSC,
    clocks: pac::CLOCKS,
    pll_sys: pac::PLL_SYS,
    pll_usb: pac::PLL_USB,
    resets: &mut pac::RESETS,
    watchdog: &mut Watchdog,
) -> Result<ClocksManager, InitError> {
    let crystal = setup_xosc_blocking(crystal, rp2::CRYSTAL_HZ.Hz()).map_err(InitError::XoscErr)?;
    // The timer counts microseconds by it.
    watchdog.enable_tick_generation((rp2::CRYSTAL_HZ / 1_000_000) as u8);
    let mut clocks = ClocksManager::new(clocks);
    let hz = crystal.operating_frequency();
    let pll_sys =
        setup_pll_blocking(pll_sys, hz, PLL_SYS_133MHZ, &mut clocks, resets).map_err(InitError::PllError)?;
    let pll_usb =
        setup_pll_blocking(pll_usb, hz, PLL_USB_48MHZ, &mut clocks, resets).map_err(InitError::PllError)?;
    clocks
        .init_default(&crystal, &pll_sys, &pll_usb)
        .map_err(InitError::ClockError)?;
    Ok(clocks)
}

#[hal::entry]
fn main() -> ! {
    rp2::run()
}
