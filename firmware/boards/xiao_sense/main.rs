//! lipstream on Seeed's XIAO nRF52840 Sense.
#![no_std]
#![no_main]

use nrf52840_hal::gpio::{DriveConfig, Level, p0, p1};

#[path = "../nrf52840/mod.rs"]
mod nrf52840;

use nrf52840::{BoardPins, uart};

#[cortex_m_rt::entry]
fn main() -> ! {
    nrf52840::run(pins)
}

fn pins(p0: p0::Parts, p1: p1::Parts) -> BoardPins {
    BoardPins {
        led: p0.p0_26.into_push_pull_output(Level::High).degrade(),
        uart: uart::pins(
            p1.p1_11.into_push_pull_output(Level::High).degrade(),
            p1.p1_12.into_floating_input().degrade(),
        ),
        // The microphone's supply current needs the strong driver.
        power: p1
            .p1_10
            .into_push_pull_output_drive(Level::High, DriveConfig::HighDrive0HighDrive1)
            .degrade(),
        pdm_clock: p1.p1_00.into_push_pull_output(Level::Low).degrade(),
        pdm_data: p0.p0_16.into_floating_input().degrade(),
        // D0 to D5.
        servos: [
            p0.p0_02.into_push_pull_output(Level::Low).degrade(),
            p0.p0_03.into_push_pull_output(Level::Low).degrade(),
            p0.p0_28.into_push_pull_output(Level::Low).degrade(),
            p0.p0_29.into_push_pull_output(Level::Low).degrade(),
            p0.p0_04.into_push_pull_output(Level::Low).degrade(),
            p0.p0_05.into_push_pull_output(Level::Low).degrade(),
        ],
    }
}
