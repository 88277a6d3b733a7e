//! Pictures and sound into video: H.264, AAC, MP4.
pub mod aac;
pub mod colour;
pub mod h264;
pub mod mp4;
