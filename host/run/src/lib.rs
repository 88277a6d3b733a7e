//! Sound in, a talking mouth out: what runs models of lipstream on a host.
// Not `forbid`: ndarray's `s!` brings an `allow` of its own.
#![deny(unsafe_code)]

pub mod cues;
pub mod engine;
pub mod export;
pub mod frontend;
pub mod hmm;
pub mod htk;
pub mod kinds;
pub mod link;
pub mod mouth;
pub mod npy;
pub mod parameters;
pub mod phones;
pub mod progress;
pub mod random;
pub mod reference;
pub mod render;
pub mod shipped;
pub mod synthetic;
pub mod tensors;
