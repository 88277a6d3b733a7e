//! What the boards of Raspberry Pi have in common: clocks, pins, ports, and the loop around the application.
//!
//! | pin | |
//! |---|---|
//! | GP0, GP1 | UART: what the board sends, what it hears |
//! | GP2 to GP7, GP20, GP21 | servos, see [`servos`] |
//! | GP16, GP17, GP18 | I²S: bit clock, word select, data |
//! | GP23, GP26 | with the feature `adc`: the regulator's way, the microphone's voltage |
//! | GP25 | LED |
#[cfg(feature = "adc")]
mod adc;
mod fast;
mod hot;
#[cfg(not(feature = "adc"))]
mod i2s;
#[cfg(feature = "defmt")]
#[path = "../common/log.rs"]
mod log;
#[path = "../common/model.rs"]
mod model;
#[path = "../common/servos.rs"]
mod servo_flash;
mod servos;
mod sound;
#[path = "../common/trouble.rs"]
mod trouble;
mod uart;
#[path = "../common/usb.rs"]
mod usb;
mod usb_bus;
mod visible;

use cortex_m::peripheral::SYST;
use cortex_m_rt::exception;
use embedded_hal::digital::StatefulOutputPin;
use lipstream_core::Model;
#[cfg(feature = "pico")]
use lipstream_core::logmath::LogProb;
use lipstream_firmware::port::{Ports, Queues};
use lipstream_firmware::turn::Turn;
use lipstream_firmware::{App, Clock};
use static_cell::{ConstStaticCell, StaticCell};

use crate::hal;
use hal::Clock as _;
#[cfg(not(feature = "adc"))]
use hal::gpio::FunctionPio0;
use hal::gpio::{FunctionUart, Pins, PullDown, PullUp};
use hal::pac;
use model::Kind;
use servos::{Servos, Ways};

static MODEL: StaticCell<DeviceModel> = StaticCell::new();
static APP: StaticCell<DeviceApp> = StaticCell::new();
static SERVOS: StaticCell<Servos> = StaticCell::new();
static USB_QUEUES: ConstStaticCell<Queues> = ConstStaticCell::new(Queues::new());
static UART_QUEUES: ConstStaticCell<Queues> = ConstStaticCell::new(Queues::new());

type DeviceModel = Model<'static, Kind>;
type DeviceApp = App<'static, Kind, Ports, Microseconds, &'static mut Servos>;

/// Both boards' crystal.
pub(crate) const CRYSTAL_HZ: u32 = 12_000_000;
/// After so long without a turn of the loop the board starts anew.
const WATCHDOG: hal::fugit::MicrosDurationU32 = hal::fugit::MicrosDurationU32::millis(1000);
/// What the processor sleeps at most: sound is looked for as often.
const WAKE_HZ: u32 = 1_000;
/// The widest beam of the Pico, 10 bits, with which speech takes less than 60 % of it; the mouth is as near to the true one as with 11 (docs/cost.md).
#[cfg(feature = "pico")]
const WIDEST_BEAM: LogProb = LogProb::from_q12(10 << 12);
/// The chip's timer.
struct Microseconds(Timer);

#[cfg(feature = "pico")]
type Timer = hal::Timer;
#[cfg(feature = "pico2")]
type Timer = hal::Timer<hal::timer::CopyableTimer0>;

impl Clock for Microseconds {
    fn ticks(&self) -> u32 {
        self.0.get_counter_low()
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

/// The servos in their place, for the same reason.
#[inline(never)]
fn make_servos(ways: Ways, model: &DeviceModel) -> &'static mut Servos {
    SERVOS.init_with(|| ways.rig(servo_flash::calibration(), model.head()))
}

/// Everything, for ever.
pub(crate) fn run() -> ! {
    hot::load();
    let mut board = pac::Peripherals::take().expect("the first to ask");
    let mut processor = cortex_m::Peripherals::take().expect("the first to ask");
    let mut watchdog = hal::Watchdog::new(board.WATCHDOG);
    let clocks = crate::begin_clocks(
        board.XOSC,
        board.CLOCKS,
        board.PLL_SYS,
        board.PLL_USB,
        &mut board.RESETS,
        &mut watchdog,
    )
    .expect("the crystal runs");
    let sio = hal::Sio::new(board.SIO);
    let pins = Pins::new(
        board.IO_BANK0,
        board.PADS_BANK0,
        sio.gpio_bank0,
        &mut board.RESETS,
    );
    let mut led = pins.gpio25.into_push_pull_output();

    #[cfg(feature = "pico")]
    let timer = hal::Timer::new(board.TIMER, &mut board.RESETS, &clocks);
    #[cfg(feature = "pico2")]
    let timer = hal::Timer::new_timer0(board.TIMER0, &mut board.RESETS, &clocks);
    let (usb_app, usb_port) = USB_QUEUES.take().split();
    let (uart_app, uart_port) = UART_QUEUES.take().split();
    #[cfg(feature = "pico")]
    let (usb_registers, usb_memory) = (board.USBCTRL_REGS, board.USBCTRL_DPRAM);
    #[cfg(feature = "pico2")]
    let (usb_registers, usb_memory) = (board.USB, board.USB_DPRAM);
    let bus = hal::usb::UsbBus::new(
        usb_registers,
        usb_memory,
        clocks.usb_clock,
        true,
        &mut board.RESETS,
    );
    usb::begin(bus, usb_port);
    uart::begin(
        board.UART0,
        (
            pins.gpio0.reconfigure::<FunctionUart, PullDown>(),
            pins.gpio1.reconfigure::<FunctionUart, PullUp>(),
        ),
        &mut board.RESETS,
        clocks.peripheral_clock.freq(),
        uart_port,
    );
    let ports = Ports {
        usb: usb_app,
        uart: uart_app,
        baud: uart::BAUD,
        serve: || {
            usb::serve();
            uart::serve();
        },
    };
    let ways = Ways::begin(
        board.PWM,
        board.I2C0,
        &mut board.RESETS,
        clocks.system_clock.freq(),
        (
            pins.gpio2, pins.gpio3, pins.gpio4, pins.gpio5, pins.gpio6, pins.gpio7,
        ),
        (pins.gpio20, pins.gpio21),
    );
    // With the ports at hand, to say it where it is wrong.
    let (bytes, refused) = model::chosen();
    let model = match Model::new_placed(bytes, fast::place) {
        Ok(model) => MODEL.init(model),
        Err(error) => panic!("{error}"),
    };
    #[cfg(feature = "defmt")]
    log::started(model.head());
    let servos = make_servos(ways, model);
    let app = make_app(model, ports, Microseconds(timer), servos);
    app.model_refused(refused);
    #[cfg(feature = "pico")]
    app.narrow(WIDEST_BEAM);
    #[cfg(feature = "adc")]
    let mut microphone = adc::Microphone::begin(
        board.ADC,
        board.DMA,
        &mut board.RESETS,
        (pins.gpio26, pins.gpio23),
    );
    #[cfg(not(feature = "adc"))]
    let mut microphone = i2s::Microphone::begin(
        board.PIO0,
        board.DMA,
        &mut board.RESETS,
        clocks.system_clock.freq().to_Hz(),
        (
            pins.gpio16.reconfigure::<FunctionPio0, PullDown>(),
            pins.gpio17.reconfigure::<FunctionPio0, PullDown>(),
            pins.gpio18.reconfigure::<FunctionPio0, PullDown>(),
        ),
    );
    wake_up_every_millisecond(&mut processor.SYST, clocks.system_clock.freq().to_Hz());

    let mut turn = Turn::new();
    watchdog.pause_on_debug(true);
    watchdog.start(WATCHDOG);
    loop {
        watchdog.feed();
        let heard = turn.take(app, &mut microphone, || {
            // The pin's error type is one that cannot be.
            let _ = led.toggle();
        });
        if !heard {
            cortex_m::asm::wfi();
        }
    }
}

fn wake_up_every_millisecond(timer: &mut SYST, processor_hz: u32) {
    timer.set_clock_source(cortex_m::peripheral::syst::SystClkSource::Core);
    timer.set_reload(processor_hz / WAKE_HZ - 1);
    timer.clear_current();
    timer.enable_counter();
    timer.enable_interrupt();
}

/// Only ends the processor's sleep.
#[exception]
fn SysTick() {}
