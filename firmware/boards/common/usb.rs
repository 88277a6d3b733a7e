//! A serial port over USB (CDC ACM), served by an interrupt. A board names its `Bus`, and has that interrupt, in its own `usb_bus`.
//!
//! It does not claim to understand AT commands (protocol 0): ModemManager leaves it alone.
use core::cell::RefCell;

use critical_section::Mutex;
use lipstream_firmware::port::PortEnd;
use static_cell::StaticCell;
use usb_device::bus::UsbBusAllocator;
use usb_device::device::{StringDescriptors, UsbDevice, UsbDeviceBuilder, UsbDeviceState, UsbVidPid};
use usbd_serial::{SerialPort, USB_CLASS_CDC};

use super::usb_bus::{self, Bus};

/// Of pid.codes, for tests: a product needs a number of its own.
const ID: UsbVidPid = UsbVidPid(0x1209, 0x0001);

struct Port {
    device: UsbDevice<'static, Bus>,
    serial: SerialPort<'static, Bus>,
    end: PortEnd<'static>,
}

static BUS: StaticCell<UsbBusAllocator<Bus>> = StaticCell::new();
static PORT: Mutex<RefCell<Option<Port>>> = Mutex::new(RefCell::new(None));

/// Sets the port going.
pub(crate) fn begin(bus: Bus, end: PortEnd<'static>) {
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

/// What the interrupt does, at any time: there is something to send, or room again for what comes.
pub(crate) fn serve() {
    critical_section::with(|cs| {
        if let Some(port) = PORT.borrow_ref_mut(cs).as_mut() {
            port.serve();
            // A packet that stays where it is keeps the interrupt pending, and the application, which makes room, from running: until
            // it did, its own calls serve the port.
            usb_bus::may_interrupt(port.end.room() > 0);
        }
    });
}

impl Port {
    fn serve(&mut self) {
        self.device.poll(&mut [&mut self.serial]);
        let open = self.device.state() == UsbDeviceState::Configured && self.serial.dtr();
        self.end.set_open(open);
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
