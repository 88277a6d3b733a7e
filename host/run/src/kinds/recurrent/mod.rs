//! Models with a memory: a coupled HMM whose occupancies gate low-rank linear maps with a memory.
//!
//! The coupled HMM of X&L follows the sound over the loop of all phones and, through its visual chain, its own last
//! output. [`context`] has what a frame hears (M1-M2 of `docs/models.md`), [`chain`] the step of the HMM (M3), [`step`] the
//! rest (M4-M9), [`live`] runs them frame by frame, [`settle`] keeps a mouth at rest still (M11).
pub mod chain;
pub mod context;
pub mod gated;
pub mod live;
pub mod log_sums;
pub mod model;
pub mod parameters;
pub mod settle;
pub mod step;
