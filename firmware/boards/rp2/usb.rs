//! A serial port over USB (CDC ACM), served by the USB interrupt.
//!
//! It does not claim to understand AT commands (protocol 0): ModemManager leaves it alone.
use core::cell::RefCell;
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::peripheral::NVIC;
use critical_section::Mutex;
use lipstream_firmware::port::PortEnd;
use static_cell::StaticCell;
use usb_device::bus::UsbBusAllocator;
use usb_device::device::{StringDescriptors, UsbDevice, UsbDeviceBuilder, UsbDeviceState, UsbVidPid};
use usbd_serial::{SerialPort, USB_CLASS_CDC};

use crate::hal;
use hal::pac;
use hal::pac::interrupt;
use hal::usb::UsbBus;

/// Of pid.codes, for tests: a product needs a number of its own.
const ID: UsbVidPid = UsbVidPid(0x1209, 0x0001);

struct Port {
    device: UsbDevice<'static, UsbBus>,
    serial: SerialPort<'static, UsbBus>,
    end: PortEnd<'static>,
}

static BUS: StaticCell<UsbBusAllocator<UsbBus>> = StaticCell::new();
static PORT: Mutex<RefCell<Option<Port>>> = Mutex::new(RefCell::new(None));
/// Whether a program on the host has the port open.
static OPEN: AtomicBool = AtomicBool::new(false);

/// Sets the port going.
pub(crate) fn begin(bus: UsbBus, end: PortEnd<'static>) {
    let bus = BUS.init(UsbBusAllocator::new(bus));
    let serial = SerialPort::new(bus);
    let words = StringDescriptors::default()
        .manufacturer("lipstream")
        .product("lipstream mouth");
    let device = UsbDeviceBuilder::new(bus, ID)
        .device_class(USB_CLASS_CDC)
        // Windows asks for more than the first eight bytes and goes on before they are fetched.
        .max_packet_size_0(64)
        .expect("64 is a size")
        .strings(&[words])
        .expect("one language")
        .build();
    critical_section::with(|cs| {
        *PORT.borrow_ref_mut(cs) = Some(Port { device, serial, end });
    });
    serve();
}

/// Whether somebody may listen.
pub(crate) fn is_open() -> bool {
    OPEN.load(Ordering::Relaxed)
}

/// What the interrupt does, at any time: there is something to send, or room again for what comes.
pub(crate) fn serve() {
    critical_section::with(|cs| {
        if let Some(port) = PORT.borrow_ref_mut(cs).as_mut() {
            port.serve();
            // A packet that stays where it is keeps the interrupt pending, and the application, which makes room, from running: until
            // it did, its own calls serve the port.
            if port.end.room() == 0 {
                NVIC::mask(pac::Interrupt::USBCTRL_IRQ);
            } else {
                // SAFETY: the handler is below, and its port is in its place.
                unsafe { NVIC::unmask(pac::Interrupt::USBCTRL_IRQ) };
            }
        }
    });
}

impl Port {
    fn serve(&mut self) {
        self.device.poll(&mut [&mut self.serial]);
        let open = self.device.state() == UsbDeviceState::Configured && self.serial.dtr();
        OPEN.store(open, Ordering::Relaxed);
        let mut bytes = [0; 64];
        // What there is no room for stays in the host.
        loop {
            let room = self.end.room().min(bytes.len());
            if room == 0 {
                break;
            }
            match self.serial.read(&mut bytes[..room]) {
                Ok(count) => self.end.received(&bytes[..count]),
                Err(_) => break,
            }
        }
        if open {
            let serial = &mut self.serial;
            self.end.drain(|bytes| serial.write(bytes).unwrap_or(0));
            // What `serial` itself still holds goes with the next packet; it says WouldBlock until then.
            let _ = serial.flush();
        } else {
            self.end.discard();
        }
    }
}

#[interrupt]
fn USBCTRL_IRQ() {
    serve();
}
