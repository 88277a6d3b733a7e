//! The region of flash where the servos' calibration lies (`memory.x`).
use core::ptr::addr_of;

unsafe extern "C" {
    static __servos_start: u8;
    static __servos_end: u8;
}

/// All of it, whatever it holds.
pub(crate) fn calibration() -> &'static [u8] {
    let start = addr_of!(__servos_start);
    let size = addr_of!(__servos_end) as usize - start as usize;
    // SAFETY: the linker script's region of flash, which nothing writes while the program runs. By its address, not by its name: the
    // compiler must not think that it knows what is there.
    unsafe { core::slice::from_raw_parts(start, size) }
}
