//! Corpora: finding clips, reading their labels, pronouncing their words, and `prepare`, which turns them into a
//! feature folder.
pub mod discover;
mod heard;
pub mod labels;
pub(crate) mod lips;
mod mend;
mod overlay;
pub mod phoneset;
pub mod prepare;
pub mod prompts;
pub mod pronounce;
mod sheet;
mod spread;
mod stamp;
pub mod summary;
pub(crate) mod take;
mod verdict;
mod visual;

pub use heard::Hearing;
pub use prepare::{PrepareSettings, prepare};
pub use summary::Summary;
