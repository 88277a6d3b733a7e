//! Corpora: finding clips, reading their labels, pronouncing their words, and `prepare`, which turns them into a
//! feature folder.
pub mod discover;
pub mod labels;
mod mend;
pub mod phoneset;
pub mod prepare;
pub mod prompts;
pub mod pronounce;
mod sheet;
mod stamp;
pub mod summary;
pub(crate) mod take;
mod verdict;
mod visual;

pub use prepare::{PrepareSettings, prepare};
pub use summary::Summary;
