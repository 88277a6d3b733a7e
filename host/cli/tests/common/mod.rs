//! What the tests of the program share.
#![allow(dead_code, unused_imports)] // each test program uses its part

#[path = "../../../run/tests/common/mod.rs"]
mod arithmetic;
#[path = "../../../../tests/tests/common/given.rs"]
mod given;
pub(crate) mod hcopy;
pub(crate) mod heads;
pub(crate) mod program;
pub(crate) mod talker;

pub(crate) use arithmetic::{quieter, snr_db};
pub(crate) use given::*;
