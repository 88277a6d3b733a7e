//! Speech in, mouth parameters out: the part of lipstream that runs on the microcontroller.
//!
//! `no_std`, no allocation, no floating point from the sample to the packet. The same code runs on
//! the device, in QEMU and inside the host program, and gives the same bytes in all three.
//!
//! ```
//! use lipstream_core::model::ModelError;
//! use lipstream_core::wire::Profile;
//! use lipstream_core::{Model, Recurrent, Stream, StreamSettings};
//!
//! # fn move_mouth(_parameters: &[i16]) {}
//! /// `tables` is what `lipstream export` wrote; a device has it in its flash.
//! fn talk(tables: &[u8], microphone: impl Iterator<Item = [i16; 160]>) -> Result<(), ModelError> {
//!     // The kind of the model is a type: tables of another kind are refused in words.
//!     let model = Model::<Recurrent>::new_checked(tables)?;
//!     let mut stream = Stream::new(&model, StreamSettings::of(Profile::Standard));
//!     for piece in microphone {
//!         let mut rest = &piece[..]; // 16 kHz, cut anywhere
//!         while !rest.is_empty() {
//!             let (taken, frame) = stream.push(rest);
//!             rest = &rest[taken..];
//!             if let Some(frame) = frame {
//!                 // frame.sample says which sound it belongs to.
//!                 for group in model.head().groups().filter(|group| group.name == "mouth") {
//!                     move_mouth(group.of(&frame.values));
//!                 }
//!             }
//!         }
//!     }
//!     Ok(())
//! }
//! # assert!(talk(b"no model", std::iter::empty()).is_err());
//! ```
//!
//! A scale a parameter ([`model::Head::parameter_scales`]) makes real units of them; [`wire`] is what goes over a line. Programs that
//! learn the kind of a model when they run use [`AnyModel`] and [`AnyStream`]. Everything else in here is the inside of
//! these: open to tests and measurements, and free to change. The feature `defmt` derives `defmt::Format`; no feature changes a
//! number.
#![no_std]
#![deny(unsafe_code)]
#![warn(missing_docs)]

pub mod context;
pub mod fixed;
pub mod frame;
pub mod frontend;
pub mod hmm;
pub mod kinds;
pub mod logmath;
pub mod model;
pub mod servo;
pub mod settings;
pub mod stream;
pub mod tables;
pub mod wire;

pub use frame::ParameterFrame;
pub use kinds::{AnyModel, AnyStream, Hierarchical, Likelihood, Recurrent};
pub use model::Model;
pub use settings::StreamSettings;
pub use stream::Stream;

/// Sampling rate of all audio that enters the core.
pub const SAMPLE_RATE_HZ: u32 = 16_000;
/// Samples of one analysis window (25 ms).
pub const FRAME_SAMPLES: usize = 400;
/// Samples between the starts of two analysis windows (10 ms).
pub const HOP_SAMPLES: usize = 160;
/// Cepstra c1..c12.
pub const N_CEPSTRA: usize = 12;
/// Static coefficients of one frame: c1..c12, then the log energy E.
pub const N_STATIC: usize = N_CEPSTRA + 1;
/// Coefficients of one audio observation: statics, Δ, ΔΔ (HTK's `MFCC_E_D_A` order).
pub const N_OBSERVATION: usize = 3 * N_STATIC;
