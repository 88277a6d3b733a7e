//! Sound and video files, in and out; knows nothing of models.
//!
//! ```no_run
//! // WAV, FLAC, MP3, Ogg, MP4 and others, any rate and number of channels: 16 kHz mono comes out.
//! let sound = lipstream_media::sound::read("speech.flac".as_ref())?;
//! println!("{:.2} s", sound.seconds());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![deny(unsafe_code)]
#![warn(missing_docs)]

pub mod encode;
pub mod files;
pub mod sink;
pub mod sound;
pub mod video;

/// Why something failed, in the words of whatever library it failed in. Errors here have it as their source; what they display is
/// only their own part.
pub type Cause = Box<dyn std::error::Error + Send + Sync>;
