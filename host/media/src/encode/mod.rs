//! Pictures and sound into video: H.264, AAC, MP4; single pictures as JPEG.
use crate::Cause;

pub mod aac;
pub mod colour;
pub mod h264;
mod jpeg;
pub mod mp4;

pub use jpeg::jpeg;

/// Why a film was not encoded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EncodeError {
    /// The video encoder does not take pictures of this size or rate.
    #[error("the video encoder refuses {0}")]
    Video(String),
    /// The sides of a picture are larger than the file's header can say.
    #[error("pictures of {width}×{height} do not fit in an MP4 file")]
    Size {
        /// Width in pixels.
        width: usize,
        /// Height in pixels.
        height: usize,
    },
    /// A picture, counted from 0, could not be encoded.
    #[error("cannot encode picture {picture}: {said}")]
    Picture {
        /// Its number, counted from 1.
        picture: usize,
        /// Its last line.
        said: String,
    },
    /// Of a picture, counted from 0, the encoder made nothing.
    #[error("picture {0} was not encoded")]
    NothingOf(usize),
    /// A film without pictures is none.
    #[error("there is no picture to encode")]
    NoPicture,
    /// The sound encoder does not take this rate.
    #[error("the sound encoder refuses")]
    SoundRate(#[source] Cause),
    /// The sound could not be encoded.
    #[error("cannot encode the sound")]
    Sound(#[source] Cause),
    /// The places of the pictures in the file are 32-bit numbers.
    #[error("the video would be larger than 4 GB: render it in parts")]
    TooLarge,
    /// A single picture could not be encoded.
    #[error("cannot write a picture as JPEG")]
    Jpeg(#[source] Cause),
    /// What was encoded before has been cut short since.
    #[error("the encoded film is shorter than its samples")]
    CutShort,
    /// Where the encoded film is kept cannot be read or written.
    #[error(transparent)]
    Io(#[from] std::io::Error),
}
