//! Code and constants that run from RAM (`hot.x`).
use core::ptr::{addr_of, addr_of_mut, read_volatile, write_volatile};

unsafe extern "C" {
    static mut __hot_start: u32;
    static mut __hot_end: u32;
    static __hot_load: u32;
}

/// Copies them from flash. Before anything else of the core is called; word by word and volatile, since the compiler's own copying is
/// among what is copied.
#[inline(never)]
pub(crate) fn load() {
    let mut from = addr_of!(__hot_load);
    let mut to = addr_of_mut!(__hot_start);
    while to < addr_of_mut!(__hot_end) {
        // SAFETY: words of the section where it is loaded and where it runs; nobody uses either before.
        unsafe { write_volatile(to, read_volatile(from)) };
        from = from.wrapping_add(1);
        to = to.wrapping_add(1);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}
