//! How much of the stack is used, told by the paint that it lost: cortex-m-rt paints it before `main`.
use core::ptr::{addr_of, read_volatile, write_volatile};

unsafe extern "C" {
    /// First and one past the last word of the stack (the linker's script).
    static _stack_end: u32;
    static _stack_start: u32;
}

/// Most bytes in use since the start or the last [`repaint`].
pub(crate) fn used() -> usize {
    let mut lowest = addr_of!(_stack_end);
    let top = addr_of!(_stack_start);
    // SAFETY: reads words between the stack's ends, which the linker script places in RAM.
    while lowest < top && unsafe { read_volatile(lowest) } == cortex_m_rt::STACK_PAINT_VALUE {
        lowest = lowest.wrapping_add(1);
    }
    top as usize - lowest as usize
}

/// Paints the unused part of the stack again.
#[inline(never)]
pub(crate) fn repaint() {
    let here = 0_u32;
    // This function's own frame stays well within the margin.
    let end = addr_of!(here).wrapping_sub(64);
    let mut word = addr_of!(_stack_end).cast_mut();
    while word.cast_const() < end {
        // SAFETY: the words from the stack's end to below this frame are in RAM and nobody's.
        unsafe { write_volatile(word, cortex_m_rt::STACK_PAINT_VALUE) };
        word = word.wrapping_add(1);
    }
}
