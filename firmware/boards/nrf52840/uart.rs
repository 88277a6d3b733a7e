//! The UART without DMA, a byte at a time, served by its interrupt.
use core::cell::RefCell;

use cortex_m::peripheral::NVIC;
use critical_section::Mutex;
use lipstream_firmware::port::PortEnd;
use nrf52840_hal::gpio::{Floating, Input, Output, Pin, PullUp, PushPull};
use nrf52840_hal::pac;
use pac::interrupt;

/// 8 bits, no parity, one stop bit. Carries 100 frames a second of the shipped model.
pub(crate) const BAUD: u32 = 115_200;

/// Where it sends, where it hears.
pub(crate) type UartPins = (Pin<Output<PushPull>>, Pin<Input<PullUp>>);

struct Port {
    uart: pac::UART0,
    end: PortEnd<'static>,
    /// A byte is on its way.
    sending: bool,
}

static PORT: Mutex<RefCell<Option<Port>>> = Mutex::new(RefCell::new(None));

/// Sets the port going.
pub(crate) fn begin(uart: pac::UART0, (send, hear): UartPins, end: PortEnd<'static>) {
    // SAFETY: numbers of pins that are configured for it; starting tasks has no other effect.
    unsafe {
        uart.psel.txd.write(|w| w.bits(send.psel_bits()));
        uart.psel.rxd.write(|w| w.bits(hear.psel_bits()));
        uart.baudrate.write(|w| w.baudrate().baud115200());
        uart.enable.write(|w| w.enable().enabled());
        uart.intenset.write(|w| w.rxdrdy().set().txdrdy().set());
        uart.tasks_startrx.write(|w| w.bits(1));
        uart.tasks_starttx.write(|w| w.bits(1));
    }
    critical_section::with(|cs| {
        let sending = false;
        *PORT.borrow_ref_mut(cs) = Some(Port { uart, end, sending });
    });
    // SAFETY: the handler is below, and its port is in its place.
    unsafe { NVIC::unmask(pac::Interrupt::UARTE0_UART0) };
}

/// What the interrupt does, at any time: there is something to send.
pub(crate) fn serve() {
    critical_section::with(|cs| {
        if let Some(port) = PORT.borrow_ref_mut(cs).as_mut() {
            port.serve();
        }
    });
}

impl Port {
    fn serve(&mut self) {
        let Self { uart, end, sending } = self;
        // Six bytes at most wait in the hardware.
        for _ in 0..6 {
            if uart.events_rxdrdy.read().bits() == 0 {
                break;
            }
            uart.events_rxdrdy.reset();
            end.received(&[uart.rxd.read().rxd().bits()]);
        }
        if uart.events_txdrdy.read().bits() != 0 {
            uart.events_txdrdy.reset();
            *sending = false;
        }
        end.drain(|bytes| match bytes {
            [byte, ..] if !*sending => {
                // SAFETY: any byte.
                uart.txd.write(|w| unsafe { w.txd().bits(*byte) });
                *sending = true;
                1
            }
            _ => 0,
        });
    }
}

#[interrupt]
fn UARTE0_UART0() {
    serve();
}

/// Pins as the board has them, for [`UartPins`].
pub(crate) fn pins(send: Pin<Output<PushPull>>, hear: Pin<Input<Floating>>) -> UartPins {
    (send, hear.into_pullup_input())
}
