//! Speech in, mouth parameters out: the part of lipstream that runs on the microcontroller.
//!
//! `no_std`, no allocation, no floating point from the sample to the packet. The same code runs on
//! the device, in QEMU and inside the host program, and gives the same bytes in all three.
//!
//! ```
//! use lipstream_core::model::Model;
//! use lipstream_core::stream::{MEMORY_FRAMES, MEMORY_TOKENS, Settings, Stream};
//! use lipstream_core::wire::Profile;
//!
//! # fn move_mouth(_parameters: &[i16]) {}
//! # let microphone = [[0i16; 160]; 50];
//! // What `lipstream export` wrote; `models/` has one.
//! static TABLES: &[u8] = include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/../models/grid-s1.tables"));
//!
//! let model = Model::new_checked(TABLES)?;
//! let settings = Settings::of(Profile::Standard);
//! let mut stream = Stream::<MEMORY_TOKENS, MEMORY_FRAMES>::sized(&model, settings);
//! for piece in microphone {
//!     let mut rest = &piece[..]; // 16 kHz, cut anywhere
//!     while !rest.is_empty() {
//!         let (taken, frame) = stream.push(rest);
//!         rest = &rest[taken..];
//!         if let Some(frame) = frame {
//!             move_mouth(&frame.values); // frame.sample: what it belongs to
//!         }
//!     }
//! }
//! # Ok::<(), lipstream_core::model::ModelError>(())
//! ```
//!
//! A scale a parameter ([`model::Model::parameter_scales`]) makes real units of them; [`wire`] is what goes over a line. The feature
//! `defmt` derives `defmt::Format`; no feature changes a number.
#![no_std]
#![deny(unsafe_code)]

pub mod fixed;
pub mod frontend;
pub mod hmm;
pub mod logmath;
pub mod mge;
pub mod model;
pub mod parameters;
pub mod projection;
pub mod stream;
pub mod tables;
pub mod wire;

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
