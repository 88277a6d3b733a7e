//! A model's sections in RAM: the flash's cache is small, and what it misses takes fifty cycles.
//!
//! The gates of audio states are the largest section, and the one that a frame reads least of: six states' at most, and mostly those of the frame
//! before. On a Pico they stay in flash, and the code that runs every frame has their room in RAM (`hot.x`), which is worth more.
use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicUsize, Ordering};

use lipstream_core::kinds::recurrent::tables::AUDIO_GATES;
use lipstream_core::model::Section;
use lipstream_core::model::container::ALIGNMENT;

/// Room for sections; what it has no room for is read from flash, more slowly.
#[cfg(feature = "pico")]
const SPACE: usize = 116 * 1024;
#[cfg(feature = "pico2")]
const SPACE: usize = 352 * 1024;

/// Whether even [`AUDIO_GATES`] are copied.
const COPIES_GATES: bool = cfg!(feature = "pico2");

/// Sections begin at multiples of four.
#[repr(align(4))]
struct Room(UnsafeCell<[u8; SPACE]>);

// SAFETY: written by `place` alone, each byte once and before anybody has it.
unsafe impl Sync for Room {}

static ROOM: Room = Room(UnsafeCell::new([0; SPACE]));
/// Bytes of it that are taken.
static TAKEN: AtomicUsize = AtomicUsize::new(0);

/// A copy of the section, where there is room for one. For the main program, which reads one model.
pub(crate) fn place(section: Section, bytes: &'static [u8]) -> &'static [u8] {
    let start = TAKEN.load(Ordering::Relaxed);
    let end = start + bytes.len().next_multiple_of(ALIGNMENT);
    if end > SPACE || section == AUDIO_GATES && !COPIES_GATES {
        return bytes;
    }
    TAKEN.store(end, Ordering::Relaxed);
    // SAFETY: inside the room, and from here on nobody else's: `TAKEN` never falls.
    unsafe {
        let to = ROOM.0.get().cast::<u8>().add(start);
        core::ptr::copy_nonoverlapping(bytes.as_ptr(), to, bytes.len());
        core::slice::from_raw_parts(to, bytes.len())
    }
}
