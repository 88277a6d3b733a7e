//! The model's tables: one little-endian block of bytes, read in place.
//!
//! [`field`] holds the layout and nothing else does; [`Model`] is the checked view of it. The format is
//! described for people in `docs/model-blob.md`.
mod check;
mod error;
pub mod field;
mod view;

pub use error::{ModelError, Size};
pub use view::{Blocks, Gate, I16s, Model, Rows, Scaling, SumRow, U16s};
