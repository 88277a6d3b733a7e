//! What the tests of the firmware share.
mod given;
pub(crate) mod qemu;

pub(crate) use given::*;
