//! What a frame knows of the sound around it: a few numbers projected from the statics at sparse taps.
//!
//! [`history`] keeps the last statics, [`projection`] makes the few numbers of them, [`tables`] holds where the taps are and the
//! matrix. Kinds of model that need more of the past add it to the context themselves.
pub mod history;
pub mod projection;
pub mod tables;

pub use history::History;
pub use tables::{ContextTables, SumRow};
