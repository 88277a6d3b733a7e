//! A PDM microphone at exactly 16 kHz: 1.28 MHz through a decimation of 80, block by block into a ring.
use core::cell::{RefCell, UnsafeCell};
use core::ptr;
use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::NVIC;
use critical_section::Mutex;
use lipstream_firmware::pdm::{Blocks, Registers};
use lipstream_firmware::ring::RingReader;
use nrf52840_hal::gpio::{Floating, Input, Output, Pin, PushPull};
use nrf52840_hal::pac;
use pac::interrupt;

/// Samples of a block: 4 ms, by which sound is late, and within which the interrupt must be served.
const BLOCK: usize = 64;
const BLOCKS: usize = 16;
const RING: usize = BLOCK * BLOCKS;

/// The ring, written by the peripheral.
struct Ring(UnsafeCell<[i16; RING]>);

// SAFETY: written by the peripheral alone, read by `Microphone` alone, sample by sample and volatile.
unsafe impl Sync for Ring {}

static RING_OF_SAMPLES: Ring = Ring(UnsafeCell::new([0; RING]));

/// Samples in the ring since the start, modulo 2³². Written by the interrupt alone.
static WRITTEN: AtomicU32 = AtomicU32::new(0);

struct Pdm(pac::PDM);

impl Registers for Pdm {
    fn take_started(&mut self) -> bool {
        let stood = self.0.events_started.read().bits() != 0;
        self.0.events_started.reset();
        stood
    }

    fn take_ended(&mut self) -> bool {
        let stood = self.0.events_end.read().bits() != 0;
        self.0.events_end.reset();
        stood
    }

    fn point_at(&mut self, block: usize) {
        let to = RING_OF_SAMPLES.0.get() as u32 + (block * BLOCK * size_of::<i16>()) as u32;
        // SAFETY: a block of the ring.
        self.0.sample.ptr.write(|w| unsafe { w.bits(to) });
    }
}

type Running = (Pdm, Blocks<BLOCKS>);
static RUNNING: Mutex<RefCell<Option<Running>>> = Mutex::new(RefCell::new(None));

/// Sound from the microphone.
pub(crate) struct Microphone {
    reader: RingReader<RING>,
}

impl Microphone {
    /// Sets everything going. The crystal must run: the clock is divided from it.
    pub(crate) fn begin(pdm: pac::PDM, clock: &Pin<Output<PushPull>>, data: &Pin<Input<Floating>>) -> Self {
        // SAFETY: numbers of pins that are configured for it, and the length of a block.
        unsafe {
            pdm.psel.clk.write(|w| w.bits(clock.psel_bits()));
            pdm.psel.din.write(|w| w.bits(data.psel_bits()));
            pdm.sample.maxcnt.write(|w| w.bits(BLOCK as u32));
        }
        pdm.pdmclkctrl.write(|w| w.freq()._1280k());
        pdm.ratio.write(|w| w.ratio().ratio80());
        pdm.mode.write(|w| w.operation().mono().edge().left_falling());
        pdm.gainl.write(|w| w.gainl().default_gain());
        pdm.gainr.write(|w| w.gainr().default_gain());
        pdm.intenset.write(|w| w.started().set().end().set());
        pdm.enable.write(|w| w.enable().enabled());
        let mut pdm = Pdm(pdm);
        let blocks = Blocks::begin(&mut pdm);
        // SAFETY: starts it; the handler is below.
        unsafe {
            pdm.0.tasks_start.write(|w| w.bits(1));
            critical_section::with(|cs| *RUNNING.borrow_ref_mut(cs) = Some((pdm, blocks)));
            NVIC::unmask(pac::Interrupt::PDM);
        }
        Self {
            reader: RingReader::new(),
        }
    }
}

impl lipstream_firmware::turn::Microphone for Microphone {
    fn read(&mut self, samples: &mut [i16]) -> (usize, u32) {
        let piece = self.reader.next(WRITTEN.load(Ordering::Acquire), samples.len());
        for (i, sample) in samples.iter_mut().take(piece.count).enumerate() {
            // SAFETY: inside the ring, see `RingReader`; volatile as the peripheral writes there.
            *sample =
                unsafe { ptr::read_volatile(RING_OF_SAMPLES.0.get().cast::<i16>().add(piece.start + i)) };
        }
        (piece.count, piece.lost)
    }
}

#[interrupt]
fn PDM() {
    critical_section::with(|cs| {
        if let Some((pdm, blocks)) = RUNNING.borrow_ref_mut(cs).as_mut() {
            let filled = blocks.serve(pdm);
            WRITTEN.store(filled.wrapping_mul(BLOCK as u32), Ordering::Release);
        }
    });
}
