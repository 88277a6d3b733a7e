//! A microphone with I²S output: a PIO program gives it its clocks and takes its bits, DMA puts them into a ring.
//!
//! ```text
//! bit clock    1.024 MHz: 64 a sample
//! word select  low for 32 of them, the left slot, then high for 32; changes with the bit clock's fall
//! data         begins one bit after word select changed, highest bit first; changes with the fall, is read at the rise
//! ```
//!
//! Only the left slot is read: the microphone's channel pin (SEL, L/R) belongs to ground. Its 24 bits are the slot's upper ones.
//!
//! Two DMA channels take turns, each with half of the ring, and start each other: nothing has to be set up again, and nobody has to be
//! in time. The interrupt at the end of a half only counts.
use core::cell::UnsafeCell;
use core::ptr;
use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::NVIC;
use lipstream_core::SAMPLE_RATE_HZ;
use lipstream_firmware::ring::RingReader;

use crate::hal;
use hal::dma::DMAExt;
use hal::gpio::bank0::{Gpio16, Gpio17, Gpio18};
use hal::gpio::{FunctionPio0, Pin, PullDown};
use hal::pac;
use hal::pac::interrupt;
use hal::pio::{Buffers, PIOBuilder, PIOExt, PinDir, ShiftDirection};

type PioPin<I> = Pin<I, FunctionPio0, PullDown>;

/// Words of half the ring: 16 ms.
const HALF: usize = 256;
const RING: usize = 2 * HALF;
/// log₂ of the bytes of a half: where a channel's write address wraps.
const HALF_BYTES_LOG2: u8 = (4 * HALF).ilog2() as u8;
/// The PIO program's steps for a sample: two for each bit of both slots.
const STEPS: u32 = 2 * 64;
/// Bits below the 16 that become a sample: what MEMS microphones give for speech at arm's length (94 dB SPL are −26 dB of full scale)
/// comes to the level of recorded speech with 18 dB of gain.
const SHIFT: u32 = 16 - 3;

/// The ring, written by DMA.
#[repr(align(2048))]
struct Ring(UnsafeCell<[u32; RING]>);

// SAFETY: written by DMA alone, read by `Microphone` alone, word by word and volatile.
unsafe impl Sync for Ring {}

static RING_OF_WORDS: Ring = Ring(UnsafeCell::new([0; RING]));
const _: () = assert!(align_of::<Ring>() == 4 * RING);

/// Halves that were filled, modulo 2³². Written by the interrupt alone.
static HALVES: AtomicU32 = AtomicU32::new(0);

/// Sound from the microphone.
pub(crate) struct Microphone {
    reader: RingReader<RING>,
}

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
        begin_dma(dma, resets, fifo.fifo_address(), fifo.dreq_value());
        machine.start();
        Self {
            reader: RingReader::new(),
        }
    }
}

impl lipstream_firmware::turn::Microphone for Microphone {
    fn read(&mut self, samples: &mut [i16]) -> (usize, u32) {
        let piece = self.reader.next(written(), samples.len());
        for (i, sample) in samples.iter_mut().take(piece.count).enumerate() {
            // SAFETY: inside the ring, see `RingReader`; volatile as DMA writes there.
            let word =
                unsafe { ptr::read_volatile(RING_OF_WORDS.0.get().cast::<u32>().add(piece.start + i)) };
            *sample = lipstream_core::fixed::saturate_i16(word as i32 >> SHIFT);
        }
        (piece.count, piece.lost)
    }
}

/// Channel 0 fills the first half, channel 1 the second; the end of each starts the other.
fn begin_dma(dma: pac::DMA, resets: &mut pac::RESETS, fifo: *const u32, request: u8) {
    // The channels of the HAL are let go: it knows no rings.
    dma.split(resets);
    let dma = registers();
    for (half, next) in [(0, 1), (1, 0)] {
        let channel = dma.ch(half);
        let to = RING_OF_WORDS.0.get() as u32 + (half * HALF * 4) as u32;
        // SAFETY: reads the FIFO, writes into the ring's half and wraps at its end.
        unsafe {
            channel.ch_read_addr().write(|w| w.bits(fifo as u32));
            channel.ch_write_addr().write(|w| w.bits(to));
            channel.ch_trans_count().write(|w| w.bits(HALF as u32));
            channel.ch_al1_ctrl().write(|w| {
                w.data_size().size_word();
                w.incr_read().clear_bit();
                w.incr_write().set_bit();
                w.ring_sel().set_bit();
                w.ring_size().bits(HALF_BYTES_LOG2);
                w.treq_sel().bits(request);
                w.chain_to().bits(next);
                w.high_priority().set_bit();
                w.en().set_bit()
            });
        }
    }
    // SAFETY: the two channels' bits; the handler is below.
    unsafe {
        dma.inte0().write(|w| w.bits(0b11));
        NVIC::unmask(pac::Interrupt::DMA_IRQ_0);
        dma.multi_chan_trigger().write(|w| w.bits(0b01));
    }
}

/// What DMA is told by: two channels that only this file knows, and their interrupt.
fn registers() -> &'static pac::dma::RegisterBlock {
    // SAFETY: the microphone took DMA, and nobody else has it.
    unsafe { &*pac::DMA::ptr() }
}

/// Words written since the start, modulo 2³².
fn written() -> u32 {
    let dma = registers();
    loop {
        let halves = HALVES.load(Ordering::Acquire);
        let half = (halves % 2) as usize;
        let address = dma.ch(half).ch_write_addr().read().bits();
        if HALVES.load(Ordering::Acquire) == halves {
            let start = RING_OF_WORDS.0.get() as u32 + (half * HALF * 4) as u32;
            // A half that was filled and not yet counted has its address at its start again: less than before, which the reader ignores.
            return halves
                .wrapping_mul(HALF as u32)
                .wrapping_add((address - start) / 4);
        }
    }
}

#[interrupt]
fn DMA_IRQ_0() {
    let dma = registers();
    let ended = dma.ints0().read().bits();
    // SAFETY: clears the flags that were read.
    dma.ints0().write(|w| unsafe { w.bits(ended) });
    // Nobody else writes it; both halves at once if this came 16 ms late.
    HALVES.store(
        HALVES.load(Ordering::Relaxed).wrapping_add(ended.count_ones()),
        Ordering::Release,
    );
}
