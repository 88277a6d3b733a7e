//! Video to steady, colour-normalised mouth images and eigenmouths, without manual work (`docs/design.md` section 7).
mod colour;
mod eigen;
mod face;
mod footage;
mod image;
mod landmarks;
mod network;
mod reference;
mod register;
pub(crate) mod shift;
mod tracker;

pub use colour::ChannelMap;
pub use eigen::{MouthSamples, eigenmouths, eigenmouths_by_channel};
pub(crate) use face::{Detector, FaceBox, median};
pub use footage::{LONGEST_S, footage};
pub(crate) use image::{Plane, Pyramid, colour_planes, luminance};
pub(crate) use landmarks::{CHIN, EYES, Walk};
pub use landmarks::{LandmarkFinder, Landmarks, Outline};
pub use tracker::{LipsSeen, MouthTrack, Tracker};
