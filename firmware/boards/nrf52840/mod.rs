//! What boards with an nRF52840 and a PDM microphone have in common. A board brings its pins.
#[cfg(feature = "defmt")]
#[path = "../common/log.rs"]
mod log;
#[path = "../common/model.rs"]
mod model;
mod pdm;
#[path = "../common/servos.rs"]
mod servo_flash;
mod servos;
#[path = "../common/trouble.rs"]
mod trouble;
pub(crate) mod uart;
#[path = "../common/usb.rs"]
mod usb;
mod usb_bus;
mod visible;

use cortex_m::peripheral::syst::SystClkSource;
use embedded_hal::digital::StatefulOutputPin;
use lipstream_core::Model;
use lipstream_firmware::port::{Ports, Queues};
use lipstream_firmware::turn::Turn;
use lipstream_firmware::{App, Clock};
use nrf52840_hal::clocks::{ExternalOscillator, Internal, LfOscStopped};
use nrf52840_hal::gpio::{Floating, Input, Output, Pin, PushPull, p0, p1};
use nrf52840_hal::pac;
use nrf52840_hal::usbd::{UsbPeripheral, Usbd};
use static_cell::{ConstStaticCell, StaticCell};

use model::Kind;
use pdm::Microphone;
use servos::{ServoPins, Servos};

type DeviceModel = Model<'static, Kind>;
type DeviceApp = App<'static, Kind, Ports, Microseconds, &'static mut Servos>;
type Clocks = nrf52840_hal::Clocks<ExternalOscillator, Internal, LfOscStopped>;

static MODEL: StaticCell<DeviceModel> = StaticCell::new();
static APP: StaticCell<DeviceApp> = StaticCell::new();
static CLOCKS: StaticCell<Clocks> = StaticCell::new();
static USB_QUEUES: ConstStaticCell<Queues> = ConstStaticCell::new(Queues::new());
static UART_QUEUES: ConstStaticCell<Queues> = ConstStaticCell::new(Queues::new());

const PROCESSOR_HZ: u32 = 64_000_000;
/// How often the processor wakes up at least: sound is looked for as often.
const WAKE_HZ: u32 = 1_000;

/// What is where on a board.
pub(crate) struct BoardPins {
    pub(crate) led: Pin<Output<PushPull>>,
    pub(crate) uart: uart::UartPins,
    /// Gives the microphone its power while it is high. It stays so.
    pub(crate) power: Pin<Output<PushPull>>,
    pub(crate) pdm_clock: Pin<Output<PushPull>>,
    pub(crate) pdm_data: Pin<Input<Floating>>,
    pub(crate) servos: ServoPins,
}

/// TIMER0 at 1 MHz.
struct Microseconds(pac::TIMER0);

impl Microseconds {
    fn begin(timer: pac::TIMER0) -> Self {
        timer.bitmode.write(|w| w.bitmode()._32bit());
        // SAFETY: 16 MHz / 2⁴; starting has no other effect.
        unsafe {
            timer.prescaler.write(|w| w.prescaler().bits(4));
            timer.tasks_start.write(|w| w.bits(1));
        }
        Self(timer)
    }
}

impl Clock for Microseconds {
    fn ticks(&self) -> u32 {
        // SAFETY: copies the count to where it can be read.
        self.0.tasks_capture[0].write(|w| unsafe { w.bits(1) });
        self.0.cc[0].read().bits()
    }
}

/// The application in its place. A function of its own, so that what it takes to make one leaves the stack again.
#[inline(never)]
fn make_app(
    model: &'static DeviceModel,
    ports: Ports,
    clock: Microseconds,
    servos: &'static mut Servos,
) -> &'static mut DeviceApp {
    APP.init_with(|| App::followed_by(model, ports, clock, servos))
}

/// Everything, for ever.
pub(crate) fn run(pins: fn(p0::Parts, p1::Parts) -> BoardPins) -> ! {
    let board = pac::Peripherals::take().expect("the first to ask");
    let mut processor = cortex_m::Peripherals::take().expect("the first to ask");
    // USB and PDM want the crystal.
    let clocks = CLOCKS.init(nrf52840_hal::Clocks::new(board.CLOCK).enable_ext_hfosc());
    let BoardPins {
        mut led,
        uart,
        power: _stays_high,
        pdm_clock,
        pdm_data,
        servos,
    } = pins(p0::Parts::new(board.P0), p1::Parts::new(board.P1));
    visible::led_is(led.pin());

    let (usb_app, mut usb_port) = USB_QUEUES.take().split();
    let (uart_app, uart_port) = UART_QUEUES.take().split();
    usb_port.set_open(false);
    // Without its 5 V the controller never becomes ready, and its driver waits for ever.
    if board.POWER.usbregstatus.read().vbusdetect().bit_is_set() {
        usb::begin(Usbd::new(UsbPeripheral::new(board.USBD, clocks)), usb_port);
    }
    uart::begin(board.UART0, uart, uart_port);
    let ports = Ports {
        usb: usb_app,
        uart: uart_app,
        baud: uart::BAUD,
        serve: || {
            usb::serve();
            uart::serve();
        },
    };
    // With the UART at hand, to say it where it is wrong.
    let (bytes, refused) = model::chosen();
    let model = match Model::new_checked(bytes) {
        Ok(model) => MODEL.init(model),
        Err(error) => panic!("{error}"),
    };
    #[cfg(feature = "defmt")]
    log::started(model.head());
    let servos = servos::begin(
        board.PWM0,
        board.PWM1,
        &servos,
        servo_flash::calibration(),
        model.head(),
    );
    let app = make_app(model, ports, Microseconds::begin(board.TIMER0), servos);
    app.model_refused(refused);
    let mut microphone = Microphone::begin(board.PDM, &pdm_clock, &pdm_data);
    processor.SYST.set_clock_source(SystClkSource::Core);
    processor.SYST.set_reload(PROCESSOR_HZ / WAKE_HZ - 1);
    processor.SYST.clear_current();
    processor.SYST.enable_counter();
    processor.SYST.enable_interrupt();

    let mut turn = Turn::new();
    visible::begin_watchdog(&board.WDT);
    loop {
        visible::keep();
        let heard = turn.take(app, &mut microphone, || {
            // The pin's error type is one that cannot be.
            let _ = led.toggle();
        });
        if !heard {
            cortex_m::asm::wfi();
        }
    }
}
