//! What makes a hierarchical model (COS, `docs/hierarchical.md`): landmarks and videos in, a model out.
pub mod appearance;
pub mod clustering;
pub mod guide;
pub mod landmarks;
pub mod maps;
pub mod pictures;
pub mod principal;
pub mod procrustes;
pub mod train;
pub mod truth;

pub use landmarks::Landmarks;
pub use train::{Settings, Trained, train};
