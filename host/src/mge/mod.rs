//! Minimum generation error training: a coupled HMM trained on the error of its own mouth.
//!
//! The coupled HMM of X&L follows the sound over the loop of all phones and, through its visual chain, its own last
//! output; its occupancies gate low-rank linear maps with a memory. [`context`] has what a frame hears (M1-M2),
//! [`chain`] the step of the HMM (M3), [`step`] the rest (M4-M9), `reverse` its gradient, [`train`] the loss (M10), [`settle`] what
//! keeps a mouth at rest still (M11).
mod batch;
pub mod chain;
pub mod checkpoint;
pub mod context;
pub mod data;
pub mod disturb;
#[cfg(test)]
mod gradient_tests;
pub mod judge;
pub mod live;
pub mod log_sums;
pub mod model;
pub mod optimise;
pub mod parameters;
pub mod pass;
mod reverse;
pub mod rounding;
pub mod settings;
pub mod settle;
pub mod start;
pub mod step;
pub mod store;
pub mod train;
