//! A microphone with a voltage: an electret with an amplifier (MAX4466, MAX9814) at the Pico's ADC.
//!
//! The ADC runs freely by its own divider, at eight times the rate of sound; its counts go into a ring ([`super::sound`]), from which
//! [`Decimator`] makes sound. Its converter has errors of some counts where the two highest bits but one change (erratum RP2040-E11); what one sample
//! of sound is made of spreads them.
use lipstream_core::SAMPLE_RATE_HZ;
use lipstream_firmware::decimate::{Decimator, FACTOR};

use super::sound::Sound;
use crate::hal;
use hal::adc::AdcPin;
use hal::gpio::bank0::{Gpio23, Gpio26};
use hal::gpio::{FunctionNull, FunctionSioOutput, Pin, PinState, PullDown};
use hal::pac;

/// The ADC's clock, the USB's.
const CLOCK_HZ: u32 = 48_000_000;
/// Its cycles from a count to the next.
const CYCLES: u32 = CLOCK_HZ / (SAMPLE_RATE_HZ * FACTOR as u32);
const _: () = assert!(CLOCK_HZ.is_multiple_of(SAMPLE_RATE_HZ * FACTOR as u32) && CYCLES >= 96);
/// The ADC's number among those that ask DMA.
const REQUEST: u8 = 36;

type Unused<I> = Pin<I, FunctionNull, PullDown>;

/// Sound from the microphone.
pub(crate) struct Microphone {
    sound: Sound,
    decimator: Decimator,
}

impl Microphone {
    /// Sets everything going; pins are the ADC's input, and the one that keeps the supply's regulator from its noisy way of saving power (on a
    /// Pico W it gives the radio power instead, which then waits).
    pub(crate) fn begin(
        adc: pac::ADC,
        dma: pac::DMA,
        resets: &mut pac::RESETS,
        (input, steady): (Unused<Gpio26>, Unused<Gpio23>),
    ) -> Self {
        let _stays_high: Pin<Gpio23, FunctionSioOutput, PullDown> =
            steady.into_push_pull_output_in_state(PinState::High);
        let mut adc = hal::Adc::new(adc, resets);
        let mut input = AdcPin::new(input.into_floating_disabled()).expect("GP26 is one of the ADC's");
        let mut fifo = adc
            .build_fifo()
            .clock_divider((CYCLES - 1) as u16, 0)
            .set_channel(&mut input)
            .enable_dma()
            .start_paused();
        // SAFETY: the address alone.
        let address = unsafe { (*pac::ADC::ptr()).fifo().as_ptr() };
        let sound = Sound::begin(dma, resets, address, REQUEST);
        fifo.resume();
        Self {
            sound,
            decimator: Decimator::new(),
        }
    }
}

impl lipstream_firmware::turn::Microphone for Microphone {
    fn read(&mut self, samples: &mut [i16]) -> (usize, u32) {
        self.sound.read(samples, |counts| self.decimator.push(counts))
    }
}
