//! What can go wrong when models are read, run, exported and drawn, by what a caller can do about it.
//!
//! The messages are for people and say what is wrong; programs look at the variant. Areas whose errors a caller may want to look into
//! have types of their own, which become an [`enum@Error`] through `?`. `Display` gives one part of an error and
//! [`source`](StdError::source) its cause; [`chain`] joins them.
use std::error::Error as StdError;
use std::path::PathBuf;

use lipstream_core::model::ModelError;
use lipstream_media::Cause;
use lipstream_media::files::FileError;
use lipstream_media::sink::SinkError;

use crate::cues::CueError;
use crate::engine::SettingError;
use crate::export::ExportError;
use crate::kinds::likelihood::NotFinite;
use crate::link::LinkError;
use crate::parameters::ParameterError;

/// What everything here that can fail returns, but for areas with an error of their own.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Why a model could not be read, run, exported or drawn.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// What was asked for is out of its range or contradicts itself: ask for something else.
    #[error("{0}")]
    Choice(String),
    /// Numbers that were handed over are not of the size they must have: hand over others.
    #[error("{0}")]
    Data(String),
    /// A file that this program writes is damaged, of another kind or of another version: make it again.
    #[error("{0}")]
    File(String),
    /// A file holds a model that was trained in another way than is needed here: take one of the right kind.
    #[error("{file} holds a model of the kind {kind:?}; this needs {wanted:?}")]
    Kind {
        /// What messages call the file.
        file: String,
        /// The kind that the file names.
        kind: String,
        /// The kind that is needed.
        wanted: &'static str,
    },
    /// The file holds the device's tables, which cannot be computed with in floats: take the model that they were exported from.
    #[error("{} holds the device's tables; the float engine needs the model they were exported from", .0.display())]
    NoFloats(PathBuf),
    /// The engine or the model does not have a setting: leave it out, or take another value.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// A sound that the model cannot explain: the model is damaged.
    #[error(transparent)]
    NotFinite(#[from] NotFinite),
    /// Viseme weights cannot be shown as mouth shapes.
    #[error(transparent)]
    Cue(#[from] CueError),
    /// Mouth parameters cannot be drawn.
    #[error(transparent)]
    Parameters(#[from] ParameterError),
    /// The device cannot run the model: train another one, or ask for other settings.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// These are no tables that the device could run: export them again.
    #[error(transparent)]
    Tables(#[from] ModelError),
    /// The device at the other end of the line is of no use.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// A file cannot be read or written at all: look at its path and the disk.
    #[error(transparent)]
    Disk(#[from] FileError),
    /// Pictures do not get where they were to go.
    #[error(transparent)]
    Sink(#[from] SinkError),
    /// What was being done, or what it was done to, when `source` happened.
    #[error("{what}")]
    Context {
        /// What was being done.
        what: String,
        /// What happened meanwhile.
        source: Cause,
    },
    /// An error of a library below, or of a caller's own [`Scene`](crate::render::Scene), in its own words.
    #[error(transparent)]
    Other(Cause),
}

impl Error {
    /// An error of a library below, or of a caller's own making.
    pub fn other(error: impl Into<Cause>) -> Self {
        Self::Other(error.into())
    }
}

/// Errors that need no words of ours when they pass through `?`.
macro_rules! from {
    ($($type:ty),*) => {$(
        impl From<$type> for Error {
            fn from(error: $type) -> Self {
                Self::other(error)
            }
        }
    )*};
}

from!(
    std::io::Error,
    ndarray::ShapeError,
    ndarray_npy::WriteNpyError,
    safetensors::SafeTensorError,
    serde_json::Error
);

/// Says what was being done when an error happened.
pub(crate) trait Context<T> {
    fn context(self, what: impl Into<String>) -> Result<T>;
    fn with_context<S: Into<String>>(self, what: impl FnOnce() -> S) -> Result<T>;
}

impl<T, E: Into<Cause>> Context<T> for Result<T, E> {
    fn context(self, what: impl Into<String>) -> Result<T> {
        self.with_context(|| what)
    }

    fn with_context<S: Into<String>>(self, what: impl FnOnce() -> S) -> Result<T> {
        self.map_err(|error| Error::Context {
            what: what().into(),
            source: error.into(),
        })
    }
}

/// An error with its causes, "what was done: why it failed", as programs print it.
pub fn chain(error: &(dyn StdError + 'static)) -> String {
    let mut out = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        out += &format!(": {error}");
        cause = error.source();
    }
    out
}

/// Returns an error of a variant that holds a message: of [`enum@Error`], or of the type that is named.
macro_rules! bail {
    ($type:ident::$variant:ident, $($message:tt)+) => {
        return Err($type::$variant(format!($($message)+)))
    };
    ($variant:ident, $($message:tt)+) => {
        return Err($crate::error::Error::$variant(format!($($message)+)))
    };
}

/// Returns an error of a variant that holds a message unless a condition holds.
macro_rules! ensure {
    ($holds:expr, $type:ident::$variant:ident, $($message:tt)+) => {
        match $holds {
            true => {}
            false => $crate::error::bail!($type::$variant, $($message)+),
        }
    };
}

pub(crate) use {bail, ensure};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_is_said_once() {
        let cause = FileError::Read {
            path: "x".into(),
            source: std::io::Error::other("the disk is gone"),
        };
        let error = Err::<(), _>(Error::from(cause))
            .context("no usable model")
            .unwrap_err();
        assert_eq!(error.to_string(), "no usable model");
        assert_eq!(chain(&error), "no usable model: cannot read x: the disk is gone");
        let error = Error::from(ExportError::Tables(ModelError::NoModel));
        assert_eq!(chain(&error), ModelError::NoModel.to_string());
    }
}
