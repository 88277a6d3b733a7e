//! Minimum generation error training: a coupled HMM trained on the error of its own mouth.
//!
//! What is trained is [`lipstream::kinds::recurrent`]; here are the pass with a tape, its gradient (`reverse`), the loss (M10 of
//! `docs/models.md`, [`train`]) and the data, disturbed in many ways.
pub mod adapt;
mod batch;
pub mod checkpoint;
mod clatter;
pub mod data;
pub mod disturb;
#[cfg(test)]
mod gradient_tests;
pub mod judge;
pub mod lips;
mod losses;
pub mod optimise;
pub mod pass;
mod reverse;
pub mod rounding;
pub mod second;
pub mod settings;
pub mod start;
pub mod store;
pub mod teach;
pub mod train;
