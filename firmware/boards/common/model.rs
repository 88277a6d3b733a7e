//! The model: another one in its own region of flash (`memory.x`) where there is one, else the one that is built in.
//!
//! Nothing of another model is used before `Model::new_checked` has read all of it. One that is refused leaves the built-in one running, and
//! the application says so.
use core::ptr::addr_of;

use lipstream_core::Model;
use lipstream_core::model::ModelError;
use lipstream_core::model::container::stated_length;

/// The tables of the build, in the program's part of flash.
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

/// What bytes hold that nothing was written to: those of flash, and those of a machine in QEMU.
const UNTOUCHED: [u8; 2] = [0xff, 0];

/// The bytes of the model to run, and why the one in the region for others is not it. What is built in has not been checked yet.
pub(crate) fn chosen() -> (&'static [u8], Option<ModelError>) {
    match another() {
        None => (built_in(), None),
        Some(bytes) => match Model::<Kind>::new_checked(bytes) {
            Ok(_) => (bytes, None),
            Err(error) => (built_in(), Some(error)),
        },
    }
}

/// By its address, not by its value: the compiler must not put copies of what it knows of it into the program.
fn built_in() -> &'static [u8] {
    let start = core::hint::black_box(addr_of!(BUILT_IN).cast());
    // SAFETY: that static.
    unsafe { core::slice::from_raw_parts(start, size_of_val(&BUILT_IN)) }
}

/// The bytes in the region for others: as many as their header states, or all where there is no header. None where nothing was written.
fn another() -> Option<&'static [u8]> {
    let start = addr_of!(__model_start);
    let size = addr_of!(__model_end) as usize - start as usize;
    // SAFETY: the linker script's region of flash, which nothing writes while the program runs.
    let region = unsafe { core::slice::from_raw_parts(start, size) };
    let length = stated_length(region).unwrap_or(size);
    let is_all = |what: &u8| region.iter().take(16).all(|byte| byte == what);
    (!UNTOUCHED.iter().any(is_all)).then(|| &region[..length.min(size)])
}
