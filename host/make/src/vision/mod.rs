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
pub(crate) mod shift;
mod tracker;

pub use affine::Affine;
pub use colour::ChannelMap;
pub use eigen::{MouthSamples, eigenmouths};
pub(crate) use face::Detector;
pub(crate) use landmarks::Walk;
pub use landmarks::{LandmarkFinder, Landmarks};
pub use tracker::{LipsSeen, MouthTrack, Tracker};
