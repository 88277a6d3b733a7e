//! Speech in, a talking mouth out: what runs lipstream's models on a host.
//!
//! ```
//! use lipstream::engine::{Engine, RunSettings};
//!
//! // The shipped model, as a device computes it; `Engine::open` reads another one.
//! let engine = Engine::shipped();
//! let mut session = engine.session(&RunSettings::default())?;
//! let (mut frames, mut widest) = (0, 0.0f32);
//! for piece in vec![0i16; 16_000].chunks(480) {
//!     // 16 kHz mono, cut anywhere.
//!     session.push(piece, |frame| {
//!         frames += 1;
//!         widest = widest.max(frame.parameters[0].abs());
//!     })?;
//! }
//! session.finish(|_| frames += 1)?;
//! assert_eq!(frames, lipstream::time::frame_count(16_000));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! | layer | crate | what it does |
//! |---|---|---|
//! | core | [`lipstream_core`] | fixed point, `no_std`: what runs on the device |
//! | media | [`lipstream_media`] | sound and video files, in and out |
//! | **run** | this one | model files, [`engine`]s, [`session`]s, numbers ([`out`]), [`cues`], the device's [`link`], [`render`]ing |
//! | make | `lipstream-make` | corpora, vision, training, alignment, evaluation |
//! | cli | `lipstream-cli` | the program `lipstream` |
//!
//! Imports point down only.
// Not `forbid`: ndarray's `s!` brings an `allow` of its own.
#![deny(unsafe_code)]
#![warn(missing_docs)]

pub mod affine;
pub mod cues;
pub mod engine;
pub mod error;
pub mod export;
pub mod frontend;
pub mod hmm;
pub mod htk;
pub mod kinds;
pub mod link;
pub mod linkage;
pub mod lips;
pub mod mouth;
pub mod npy;
pub mod opening;
pub mod out;
pub mod parameters;
pub mod phones;
pub mod progress;
pub mod random;
pub mod reference;
pub mod render;
pub mod session;
pub mod shipped;
pub mod synthetic;
pub mod tensors;
pub mod time;

pub use error::{Error, Result};
