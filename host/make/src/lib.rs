//! What makes lipstream's models: corpora, vision, training, alignment, evaluation.
//!
//! ```no_run
//! use lipstream_make::corpus::{self, PrepareSettings};
//! use lipstream_make::features::FeatureFolder;
//! use lipstream_make::train::{self, TrainSettings};
//!
//! // Clips of one speaker with labels or transcripts → a folder of features → a model.
//! let prepare = PrepareSettings {
//!     corpus: "clips".into(),
//!     out: "features".into(),
//!     ..PrepareSettings::default()
//! };
//! corpus::prepare(&prepare, &())?;
//! let folder = FeatureFolder::open(&prepare.out)?;
//! let model = train::train(&folder, &[], &TrainSettings::default(), &|line: &str| println!("{line}"))?;
//! model.write("model.safetensors".as_ref())?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! What runs the models is [`lipstream`], one layer below; the program `lipstream` is one above.
// Not `forbid`: ndarray's `s!` brings an `allow` of its own.
#![deny(unsafe_code)]
#![warn(missing_docs)]

pub mod align;
pub mod check;
pub mod corpus;
pub mod details;
pub mod em;
pub mod error;
pub mod evaluate;
pub mod features;
pub mod folds;
mod hash;
pub mod hierarchical;
pub mod landmarks;
pub mod mge;
pub mod mos;
pub mod noise;
pub mod shelf;
pub mod train;
pub mod vision;

pub use error::{Error, Result};
