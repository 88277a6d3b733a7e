//! Hobby servos on six pins, or on a PCA9685.
//!
//! | pin | |
//! |---|---|
//! | GP2 to GP7 | outputs 0 to 5 |
//! | GP20, GP21 | I²C of a PCA9685: data, clock |
use embedded_hal::digital::InputPin;
use lipstream_core::model::Head;
use lipstream_core::servo::Driver;
use lipstream_firmware::servo::pca9685::Pca9685;
use lipstream_firmware::servo::pins::{PERIOD_US, Pins};
use lipstream_firmware::servo::{Either, Outputs, Rig};
use static_cell::StaticCell;

use crate::hal;
use hal::fugit::{HertzU32, RateExtU32};
use hal::gpio::bank0::{Gpio2, Gpio3, Gpio4, Gpio5, Gpio6, Gpio7, Gpio20, Gpio21};
use hal::gpio::{FunctionI2C, FunctionNull, FunctionSioInput, Pin, PullDown, PullUp};
use hal::i2c::I2C;
use hal::pac;
use hal::pwm::{FreeRunning, Pwm1, Pwm2, Pwm3, Slice, SliceId, Slices};

/// What modules with weak pull-ups bear.
const BUS_HZ: u32 = 400_000;
/// Steps of a pin's pulse in a microsecond.
const STEPS_PER_US: u32 = 2;

type Unused<I> = Pin<I, FunctionNull, PullDown>;
type BusPin<I> = Pin<I, FunctionI2C, PullUp>;
type Bus = I2C<pac::I2C0, (BusPin<Gpio20>, BusPin<Gpio21>)>;
type BoardOutputs = Either<Pins<'static, 6>, Pca9685<Bus>>;
pub(crate) type Servos = Rig<BoardOutputs>;

type Three = (
    Slice<Pwm1, FreeRunning>,
    Slice<Pwm2, FreeRunning>,
    Slice<Pwm3, FreeRunning>,
);
static SLICES: StaticCell<Three> = StaticCell::new();

/// Pins of the direct outputs, in order.
pub(crate) type ServoPins = (
    Unused<Gpio2>,
    Unused<Gpio3>,
    Unused<Gpio4>,
    Unused<Gpio5>,
    Unused<Gpio6>,
    Unused<Gpio7>,
);

/// Both ways to servos, without pulses. Begun before anything can go wrong with the model: a PCA9685 may still hold pulses of an earlier run.
pub(crate) struct Ways {
    pins: Pins<'static, 6>,
    /// None where the bus is held low, by a short circuit for one: the driver would wait for it for ever.
    chip: Option<Pca9685<Bus>>,
}

fn twenty_milliseconds<I: SliceId>(slice: &mut Slice<I, FreeRunning>, processor_hz: u32) {
    let steps_hz = STEPS_PER_US * 1_000_000;
    // In sixteenths: exact at 133 and at 150 MHz.
    let divisor = 16 * (processor_hz / 1_000_000) / (steps_hz / 1_000_000);
    slice.set_div_int((divisor / 16) as u8);
    slice.set_div_frac((divisor % 16) as u8);
    slice.set_top((STEPS_PER_US * PERIOD_US - 1) as u16);
    slice.enable();
}

impl Ways {
    /// A function of its own, whose stack is free again afterwards.
    #[inline(never)]
    pub(crate) fn begin(
        pwm: pac::PWM,
        i2c: pac::I2C0,
        resets: &mut pac::RESETS,
        clock: HertzU32,
        pins: ServoPins,
        (data, beat): (Unused<Gpio20>, Unused<Gpio21>),
    ) -> Self {
        let slices = Slices::new(pwm, resets);
        let (a, b, c) = SLICES.init((slices.pwm1, slices.pwm2, slices.pwm3));
        a.channel_a.output_to(pins.0);
        a.channel_b.output_to(pins.1);
        b.channel_a.output_to(pins.2);
        b.channel_b.output_to(pins.3);
        c.channel_a.output_to(pins.4);
        c.channel_b.output_to(pins.5);
        twenty_milliseconds(a, clock.to_Hz());
        twenty_milliseconds(b, clock.to_Hz());
        twenty_milliseconds(c, clock.to_Hz());
        let pins = Pins([
            &mut a.channel_a,
            &mut a.channel_b,
            &mut b.channel_a,
            &mut b.channel_b,
            &mut c.channel_a,
            &mut c.channel_b,
        ]);
        let mut data: Pin<_, FunctionSioInput, PullUp> = data.reconfigure();
        let mut beat: Pin<_, FunctionSioInput, PullUp> = beat.reconfigure();
        // The pull-ups need a moment with the wires.
        cortex_m::asm::delay(clock.to_Hz() / 10_000);
        let free = data.is_high() == Ok(true) && beat.is_high() == Ok(true);
        let chip = free.then(|| {
            let bus = (data.reconfigure(), beat.reconfigure());
            let bus = I2C::i2c0(i2c, bus.0, bus.1, BUS_HZ.Hz(), resets, clock);
            let mut chip = Pca9685::new(bus);
            chip.release();
            chip
        });
        Self { pins, chip }
    }

    /// Servos by the calibration in flash.
    pub(crate) fn rig(self, calibration: &[u8], head: &Head) -> Servos {
        Rig::new(calibration, head, |driver| match driver {
            Driver::Pins => Ok(Either::A(self.pins)),
            Driver::Pca9685 => match self.chip {
                Some(chip) => Ok(Either::B(chip)),
                None => Err("its wires are held low: look for a short circuit, then switch off and on"),
            },
            Driver::Maestro | Driver::Csv => Err("this board has pins and pca9685"),
        })
    }
}
