//! The chip's USB for `common/usb.rs`.
use cortex_m_rt::exception;
use nrf52840_hal::usbd::{UsbPeripheral, Usbd};

/// The USB controller.
pub(crate) type Bus = Usbd<UsbPeripheral<'static>>;

/// Nothing to do: the port is served every millisecond, not when it asks for it.
pub(crate) fn may_interrupt(_: bool) {}

/// Every millisecond: the driver of this chip's USB clears its events when it is asked, and knows no interrupts. Ends the processor's sleep too.
#[exception]
fn SysTick() {
    super::usb::serve();
}
