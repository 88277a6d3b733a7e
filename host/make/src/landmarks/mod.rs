//! Landmarks of faces in videos: an active shape model, grown from a few labelled pictures (`docs/hierarchical.md`).
//!
//! COS section 6.1 labels its training video so: some pictures by hand, the next by a model of these, which is corrected where it errs and made anew. Here [`ShapeModel`] says
//! which shapes there are, [`profile`] what a picture looks like across each point's contour, and [`ActiveShape`] finds a face's points by both (Cootes, Taylor, Cooper and
//! Graham 1995). Nothing is known beforehand about how many points there are or what they mean.
pub(crate) mod archive;
pub mod growth;
pub mod import;
pub mod label;
pub mod labeller;
pub mod profile;
pub mod search;
pub mod shape;
pub(crate) mod table;

#[cfg(test)]
mod tests;

pub use growth::Growth;
pub use label::Labels;
pub use labeller::Labeller;
pub use search::{ActiveShape, Example, Fit, Look};
pub use shape::{Pose, ShapeModel};
