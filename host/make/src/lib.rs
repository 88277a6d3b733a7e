//! What makes models of lipstream: corpora, vision, training, alignment, evaluation.
// Not `forbid`: ndarray's `s!` brings an `allow` of its own.
#![deny(unsafe_code)]

pub mod align;
pub mod corpus;
pub mod em;
pub mod error;
pub mod evaluate;
pub mod features;
pub mod mge;
pub mod noise;
pub mod shelf;
pub mod train;
pub mod vision;

pub use error::{Error, Result};
