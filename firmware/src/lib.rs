//! Board-independent firmware of lipstream: sound or messages in, messages out (`docs/wire.md`).
//!
//! A board brings a [`Line`], a [`Clock`] and its sound; see `firmware/boards/`.
#![no_std]
#![forbid(unsafe_code)]

pub mod app;
pub mod pace;

pub use app::{App, Clock, Line};
