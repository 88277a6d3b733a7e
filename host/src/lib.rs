//! lipstream's host side: corpora, training, export, conversion, rendering, evaluation.
//!
//! Floats live here; `lipstream-core` is fixed-point from sample to packet and runs unchanged on the
//! device, in QEMU and inside this library.
// Not `forbid`: ndarray's `s!` brings an `allow` of its own.
#![deny(unsafe_code)]

pub mod align;
pub mod audio;
pub mod cli;
pub mod corpus;
pub mod cues;
pub mod engine;
pub mod evaluate;
pub mod export;
pub mod features;
pub mod files;
pub mod frontend;
pub mod hmm;
pub mod htk;
pub mod link;
pub mod local_linear;
pub mod mge;
pub mod model;
pub mod mouth;
pub mod phones;
pub mod reference;
pub mod render;
pub mod shelf;
pub mod shipped;
pub mod synthetic;
pub mod tensors;
pub mod train;
pub mod video;
