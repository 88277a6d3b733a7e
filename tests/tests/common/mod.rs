//! What the tests of the firmware share.
pub(crate) mod build;
mod given;
pub(crate) mod qemu;

pub(crate) use given::*;
