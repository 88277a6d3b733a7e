//! Sound and video files, in and out; knows nothing of models.
#![deny(unsafe_code)]

pub mod encode;
pub mod files;
pub mod sound;
pub mod video;
