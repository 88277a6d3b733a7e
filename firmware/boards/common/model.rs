//! The model in its own region of flash (`memory.x`), and the one that is built in there.
//!
//! What lies there when the program starts decides: another model is put there without the program being built again. Nothing of it is
//! used before `Model::new_checked` has read all of it.
use core::ptr::addr_of;

use lipstream_core::model::container::stated_length;

/// The tables of the build, at the region's start.
#[unsafe(link_section = ".model")]
#[used]
static BUILT_IN: [u8; include_bytes!(env!("LIPSTREAM_TABLES_FILE")).len()] =
    *include_bytes!(env!("LIPSTREAM_TABLES_FILE"));

// `Kind`, as `firmware/build.rs` found it in the tables.
include!(concat!(env!("OUT_DIR"), "/kind.rs"));

unsafe extern "C" {
    static __model_start: u8;
    static __model_end: u8;
}

/// The bytes in the region that say to be a model: as many as its header states, or all where there is no header.
pub(crate) fn in_flash() -> &'static [u8] {
    let start = addr_of!(__model_start);
    let size = addr_of!(__model_end) as usize - start as usize;
    // SAFETY: the linker script's region of flash, which nothing writes while the program runs. By its address, not by its name: the
    // compiler must not know what the build put there.
    let region = unsafe { core::slice::from_raw_parts(start, size) };
    let length = stated_length(region).unwrap_or(size);
    &region[..length.min(size)]
}
