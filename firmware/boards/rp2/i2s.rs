//! A microphone with I²S output: a PIO program gives it its clocks and takes its bits, which go into a ring ([`super::sound`]).
//!
//! ```text
//! bit clock    1.024 MHz: 64 a sample
//! word select  low for 32 of them, the left slot, then high for 32; changes with the bit clock's fall
//! data         begins one bit after word select changed, highest bit first; changes with the fall, is read at the rise
//! ```
//!
//! Only the left slot is read: the microphone's channel pin (SEL, L/R) belongs to ground. Its 24 bits are the slot's upper ones.
use lipstream_core::SAMPLE_RATE_HZ;

use super::sound::Sound;
use crate::hal;
use hal::gpio::bank0::{Gpio16, Gpio17, Gpio18};
use hal::gpio::{FunctionPio0, Pin, PullDown};
use hal::pac;
use hal::pio::{Buffers, PIOBuilder, PIOExt, PinDir, ShiftDirection};

type PioPin<I> = Pin<I, FunctionPio0, PullDown>;

/// The PIO program's steps for a sample: two for each bit of both slots.
const STEPS: u32 = 2 * 64;
/// Bits below the 16 that become a sample: what MEMS microphones give for speech at arm's length (94 dB SPL are −26 dB of full scale)
/// comes to the level of recorded speech with 18 dB of gain.
const SHIFT: u32 = 16 - 3;

/// Sound from the microphone.
pub(crate) struct Microphone(Sound);

impl Microphone {
    /// Sets everything going; pins are bit clock, word select, data.
    pub(crate) fn begin(
        pio: pac::PIO0,
        dma: pac::DMA,
        resets: &mut pac::RESETS,
        system_hz: u32,
        (clock, select, data): (PioPin<Gpio16>, PioPin<Gpio17>, PioPin<Gpio18>),
    ) -> Self {
        let program = pio::pio_asm!(
            // Side-set: word select, bit clock. Periods are counted from the fall of word select.
            ".side_set 2",
            ".wrap_target",
            "    set x, 29       side 0b00", // period 0: still the right slot's last bit
            "    set y, 30       side 0b01",
            "    nop             side 0b00", // period 1: the left slot's first bit
            "left:",
            "    in pins, 1      side 0b01", // periods 1 to 30
            "    jmp x-- left    side 0b00",
            "    in pins, 1      side 0b01", // period 31
            "    nop             side 0b10", // period 32: word select rises with the last bit
            "    in pins, 1      side 0b11",
            "right:",
            "    nop             side 0b10", // periods 33 to 63: nobody listens
            "    jmp y-- right   side 0b11",
            ".wrap",
        );
        let (mut pio, machine, ..) = pio.split(resets);
        let installed = pio.install(&program.program).expect("the PIO is empty");
        // 2.048 MHz of 133 or 150 MHz: 64 241/256 and 73 62/256, both exact.
        let divisor = u64::from(system_hz) * 256 / u64::from(SAMPLE_RATE_HZ * STEPS);
        let (mut machine, fifo, _) = PIOBuilder::from_installed_program(installed)
            .side_set_pin_base(clock.id().num)
            .in_pin_base(data.id().num)
            .in_shift_direction(ShiftDirection::Left)
            .autopush(true)
            .push_threshold(32)
            .buffers(Buffers::OnlyRx)
            .clock_divisor_fixed_point((divisor >> 8) as u16, divisor as u8)
            .build(machine);
        machine.set_pindirs([
            (clock.id().num, PinDir::Output),
            (select.id().num, PinDir::Output),
            (data.id().num, PinDir::Input),
        ]);
        let sound = Sound::begin(dma, resets, fifo.fifo_address(), fifo.dreq_value());
        machine.start();
        Self(sound)
    }
}

impl lipstream_firmware::turn::Microphone for Microphone {
    fn read(&mut self, samples: &mut [i16]) -> (usize, u32) {
        self.0.read(samples, |[word]| {
            lipstream_core::fixed::saturate_i16(word as i32 >> SHIFT)
        })
    }
}
