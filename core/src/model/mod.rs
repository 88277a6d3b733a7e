//! The model's tables: one little-endian block of bytes, read in place.
//!
//! [`field`] holds the layout and nothing else does; [`Model`] is the checked view of it. The format is
//! described for people in `docs/model-blob.md`.
mod check;
mod error;
pub mod field;
mod part;
mod view;

pub use error::{ModelError, Size};
pub use part::{Blocks, Density, Gate, I16s, Rows, Scaling, StateRow, SumRow, U16s};
pub use view::Model;
