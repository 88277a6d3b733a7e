//! What the tests of the program share.
#![allow(dead_code)] // each test program uses its part

#[path = "../../../run/tests/common/mod.rs"]
mod arithmetic;
pub(crate) mod hcopy;

pub(crate) use arithmetic::{quieter, snr_db};
