//! Sound that a peripheral's FIFO gives and DMA puts into a ring, word by word, without the processor.
//!
//! Two DMA channels take turns, each with half of the ring, and start each other: nothing has to be set up again, and nobody has to be
//! in time. The interrupt at the end of a half only counts.
use core::cell::UnsafeCell;
use core::ptr;
use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::NVIC;
use lipstream_firmware::ring::RingReader;

use crate::hal;
use hal::dma::DMAExt;
use hal::pac;
use hal::pac::interrupt;

/// What a FIFO gives: a slot of I²S, or a count of the ADC.
#[cfg(not(feature = "adc"))]
pub(crate) type Word = u32;
#[cfg(feature = "adc")]
pub(crate) type Word = u16;

/// Words for a sample of sound.
#[cfg(not(feature = "adc"))]
pub(crate) const GRAIN: usize = 1;
#[cfg(feature = "adc")]
pub(crate) const GRAIN: usize = lipstream_firmware::decimate::FACTOR;

/// Words of half the ring: 16 ms.
const HALF: usize = 256 * GRAIN;
const RING: usize = 2 * HALF;
const HALF_BYTES: usize = HALF * size_of::<Word>();

/// The ring, written by DMA. A channel's write address wraps where its low bits do.
#[cfg_attr(not(feature = "adc"), repr(align(1024)))]
#[cfg_attr(feature = "adc", repr(align(4096)))]
struct Ring(UnsafeCell<[Word; RING]>);

// SAFETY: written by DMA alone, read by `Sound` alone, word by word and volatile.
unsafe impl Sync for Ring {}

static RING_OF_WORDS: Ring = Ring(UnsafeCell::new([0; RING]));
const _: () = assert!(align_of::<Ring>() == HALF_BYTES);

/// Halves that were filled, modulo 2³². Written by the interrupt alone.
static HALVES: AtomicU32 = AtomicU32::new(0);

/// The reader's end.
pub(crate) struct Sound {
    reader: RingReader<RING>,
}

impl Sound {
    /// DMA waits for the FIFO at this address, which asks for it by this number.
    pub(crate) fn begin(dma: pac::DMA, resets: &mut pac::RESETS, fifo: *const u32, request: u8) -> Self {
        begin_dma(dma, resets, fifo, request);
        Self {
            reader: RingReader::new(),
        }
    }

    /// Fills the beginning of `samples` with what `make` makes of the words that have come: how many, and how many were lost before them.
    pub(crate) fn read(
        &mut self,
        samples: &mut [i16],
        mut make: impl FnMut([Word; GRAIN]) -> i16,
    ) -> (usize, u32) {
        // Whole grains: a ring of them has no grain across its end.
        let whole = written() & !(GRAIN as u32 - 1);
        let piece = self.reader.next(whole, samples.len() * GRAIN);
        let grains = (piece.start..).step_by(GRAIN).take(piece.count / GRAIN);
        for (sample, start) in samples.iter_mut().zip(grains) {
            // SAFETY: inside the ring, see `RingReader`; volatile as DMA writes there.
            *sample = make(core::array::from_fn(|k| unsafe {
                ptr::read_volatile(RING_OF_WORDS.0.get().cast::<Word>().add(start + k))
            }));
        }
        (piece.count / GRAIN, piece.lost / GRAIN as u32)
    }
}

/// Channel 0 fills the first half, channel 1 the second; the end of each starts the other.
fn begin_dma(dma: pac::DMA, resets: &mut pac::RESETS, fifo: *const u32, request: u8) {
    // The channels of the HAL are let go: it knows no rings.
    dma.split(resets);
    let dma = registers();
    for (half, next) in [(0, 1), (1, 0)] {
        let channel = dma.ch(half);
        let to = RING_OF_WORDS.0.get() as u32 + (half * HALF_BYTES) as u32;
        // SAFETY: reads the FIFO, writes into the ring's half and wraps at its end.
        unsafe {
            channel.ch_read_addr().write(|w| w.bits(fifo as u32));
            channel.ch_write_addr().write(|w| w.bits(to));
            channel.ch_trans_count().write(|w| w.bits(HALF as u32));
            channel.ch_al1_ctrl().write(|w| {
                match size_of::<Word>() {
                    2 => w.data_size().size_halfword(),
                    _ => w.data_size().size_word(),
                };
                w.incr_read().clear_bit();
                w.incr_write().set_bit();
                w.ring_sel().set_bit();
                w.ring_size().bits(HALF_BYTES.ilog2() as u8);
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
    // SAFETY: `Sound::begin` took DMA, and nobody else has it.
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
            let start = RING_OF_WORDS.0.get() as u32 + (half * HALF_BYTES) as u32;
            // A half that was filled and not yet counted has its address at its start again: less than before, which the reader ignores.
            return halves
                .wrapping_mul(HALF as u32)
                .wrapping_add((address - start) / size_of::<Word>() as u32);
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
