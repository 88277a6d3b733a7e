//! UART0, served by its interrupt.
use core::cell::RefCell;

use cortex_m::peripheral::NVIC;
use critical_section::Mutex;
use lipstream_firmware::port::PortEnd;

use crate::hal;
use hal::fugit::{HertzU32, RateExtU32};
use hal::gpio::bank0::{Gpio0, Gpio1};
use hal::gpio::{FunctionUart, Pin, PullDown, PullUp};
use hal::pac;
use hal::pac::interrupt;
use hal::uart::{DataBits, Enabled, StopBits, UartConfig, UartPeripheral};

/// 8 bits, no parity, one stop bit. Carries 100 frames a second of the shipped model.
pub(crate) const BAUD: u32 = 115_200;

type UartPins = (
    Pin<Gpio0, FunctionUart, PullDown>,
    Pin<Gpio1, FunctionUart, PullUp>,
);

struct Port {
    uart: UartPeripheral<Enabled, pac::UART0, UartPins>,
    end: PortEnd<'static>,
}

static PORT: Mutex<RefCell<Option<Port>>> = Mutex::new(RefCell::new(None));

/// Sets the port going.
pub(crate) fn begin(
    uart: pac::UART0,
    pins: UartPins,
    resets: &mut pac::RESETS,
    clock: HertzU32,
    end: PortEnd<'static>,
) {
    let config = UartConfig::new(BAUD.Hz(), DataBits::Eight, None, StopBits::One);
    let mut uart = UartPeripheral::new(uart, pins, resets)
        .enable(config, clock)
        .expect("the clock can be divided");
    uart.enable_rx_interrupt();
    critical_section::with(|cs| *PORT.borrow_ref_mut(cs) = Some(Port { uart, end }));
    // SAFETY: the handler is below, and its port is in its place.
    unsafe { NVIC::unmask(pac::Interrupt::UART0_IRQ) };
}

/// What the interrupt does, at any time: there is something to send, or room again for what comes.
pub(crate) fn serve() {
    critical_section::with(|cs| {
        if let Some(port) = PORT.borrow_ref_mut(cs).as_mut() {
            port.serve();
        }
    });
}

impl Port {
    fn serve(&mut self) {
        // As many as the hardware holds. Never again and again: an error may stand for longer than it takes to read.
        let mut bytes = [0; 32];
        match self.uart.read_raw(&mut bytes) {
            Ok(count) => self.end.received(&bytes[..count]),
            // Noise on an open line, or a byte too many: what remains of its message has a wrong CRC.
            Err(nb::Error::Other(error)) => self.end.received(error.discarded),
            Err(nb::Error::WouldBlock) => {}
        }
        let uart = &self.uart;
        let all_gone = self.end.drain(|bytes| match uart.write_raw(bytes) {
            Ok(rest) => bytes.len() - rest.len(),
            Err(_) => 0,
        });
        // The interrupt stands as long as there is room in the hardware.
        if all_gone {
            self.uart.disable_tx_interrupt();
        } else {
            self.uart.enable_tx_interrupt();
        }
    }
}

#[interrupt]
fn UART0_IRQ() {
    serve();
}
