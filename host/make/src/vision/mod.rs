//! Video to steady, colour-normalised mouth images and eigenmouths, without manual work (`docs/design.md` section 7).
mod affine;
mod colour;
mod eigen;
mod face;
mod image;
mod landmarks;
mod network;
mod reference;
mod register;
mod tracker;

pub use affine::Affine;
pub use colour::ChannelMap;
pub use eigen::{MouthSamples, eigenmouths};
pub use landmarks::{LandmarkFinder, Landmarks, Outline};
pub use tracker::{LipsSeen, MouthTrack, Tracker};
