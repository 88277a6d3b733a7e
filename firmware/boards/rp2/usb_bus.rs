//! The chip's USB for `common/usb.rs`.
use cortex_m::peripheral::NVIC;

use crate::hal;
use hal::pac;
use hal::pac::interrupt;

/// The USB controller.
pub(crate) type Bus = hal::usb::UsbBus;

/// Whether the interrupt may come, or waits.
pub(crate) fn may_interrupt(may: bool) {
    if may {
        // SAFETY: the handler is below, and does nothing before there is a port.
        unsafe { NVIC::unmask(pac::Interrupt::USBCTRL_IRQ) };
    } else {
        NVIC::mask(pac::Interrupt::USBCTRL_IRQ);
    }
}

#[interrupt]
fn USBCTRL_IRQ() {
    super::usb::serve();
}
