//! Hobby servos on six pins: PWM0 has the first four, PWM1 the others.
//!
//! The peripheral reads its four compare values from RAM, each time that a sequence is started, and takes them on with its next period. Bit 15 of
//! a value makes the pulse come first and the pause afterwards; without it a short pulse would be a long one.
use core::convert::Infallible;
use core::sync::atomic::{AtomicU16, Ordering};

use embedded_hal::pwm::{ErrorType, SetDutyCycle};
use lipstream_core::model::Head;
use lipstream_core::servo::Driver;
use lipstream_firmware::servo::Rig;
use lipstream_firmware::servo::pins::{PERIOD_US, Pins, ServoPin};
use nrf52840_hal::gpio::{Output, Pin, PushPull};
use nrf52840_hal::pac;
use pac::pwm0::RegisterBlock;
use static_cell::StaticCell;

pub(crate) type Servos = Rig<Pins<'static, 6>>;
/// Outputs 0 to 5.
pub(crate) type ServoPins = [Pin<Output<PushPull>>; 6];

/// Steps of a period: 16 MHz / 16, a microsecond each.
const STEPS: u16 = PERIOD_US as u16;
/// The pulse comes first.
const PULSE_FIRST: u16 = 1 << 15;

/// What the peripherals read.
static VALUES: [[AtomicU16; 4]; 2] = [const { [const { AtomicU16::new(PULSE_FIRST) }; 4] }; 2];
static SERVOS: StaticCell<Servos> = StaticCell::new();
static CHANNELS: StaticCell<[Channel; 6]> = StaticCell::new();

/// One output of a peripheral.
struct Channel {
    pwm: &'static RegisterBlock,
    value: &'static AtomicU16,
}

// SAFETY: registers are written by the main program alone, until nothing else runs any more.
unsafe impl Send for Channel {}

impl ErrorType for Channel {
    type Error = Infallible;
}

impl SetDutyCycle for Channel {
    fn max_duty_cycle(&self) -> u16 {
        STEPS
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
        // Before the peripheral is told to read it.
        self.value.store(PULSE_FIRST | duty.min(STEPS), Ordering::Release);
        // SAFETY: starts the sequence that `begin` described.
        self.pwm.tasks_seqstart[0].write(|w| unsafe { w.bits(1) });
        Ok(())
    }
}

/// Sets a peripheral up, without pulses.
fn begin_pwm(pwm: &RegisterBlock, values: &'static [AtomicU16; 4], pins: &[Pin<Output<PushPull>>]) {
    for (select, pin) in pwm.psel.out.iter().zip(pins) {
        // SAFETY: the number of a pin that is an output.
        select.write(|w| unsafe { w.bits(pin.psel_bits()) });
    }
    pwm.prescaler.write(|w| w.prescaler().div_16());
    // SAFETY: 15 bits; a sequence of four values in RAM, which live for ever.
    unsafe {
        pwm.countertop.write(|w| w.countertop().bits(STEPS));
        pwm.seq0.ptr.write(|w| w.bits(values.as_ptr() as u32));
        pwm.seq0.cnt.write(|w| w.bits(4));
        pwm.seq0.refresh.write(|w| w.bits(0));
        pwm.seq0.enddelay.write(|w| w.bits(0));
    }
    pwm.decoder
        .write(|w| w.load().individual().mode().refresh_count());
    pwm.loop_.write(|w| w.cnt().disabled());
    pwm.enable.write(|w| w.enable().enabled());
}

/// Servos by the calibration in flash, on these pins.
#[inline(never)]
pub(crate) fn begin(
    _: pac::PWM0,
    _: pac::PWM1,
    pins: &ServoPins,
    calibration: &[u8],
    head: &Head,
) -> &'static mut Servos {
    // SAFETY: both peripherals were given away to this function.
    let blocks = unsafe { [&*pac::PWM0::ptr(), &*pac::PWM1::ptr()] };
    for (k, block) in blocks.into_iter().enumerate() {
        begin_pwm(block, &VALUES[k], &pins[4 * k..pins.len().min(4 * k + 4)]);
    }
    let channels = core::array::from_fn(|k| Channel {
        pwm: blocks[k / 4],
        value: &VALUES[k / 4][k % 4],
    });
    let pins = CHANNELS
        .init(channels)
        .each_mut()
        .map(|channel| channel as &mut ServoPin);
    SERVOS.init_with(|| {
        Rig::new(calibration, head, |driver| match driver {
            Driver::Pins => Ok(Pins(pins)),
            _ => Err("this board has pins"),
        })
    })
}
