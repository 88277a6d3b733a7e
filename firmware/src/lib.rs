//! Board-independent firmware of lipstream: sound or messages in, messages out (`docs/wire.md`).
//!
//! A board brings a [`Line`], a [`Clock`] and its sound; see `firmware/boards/`.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod app;
pub mod decimate;
pub mod pace;
pub mod pdm;
pub mod port;
pub mod ring;
pub mod servo;
pub mod turn;

pub use app::{App, Clock, Line};
