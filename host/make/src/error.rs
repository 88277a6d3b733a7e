//! What can go wrong when models are made, by what a caller can do about it.
//!
//! The messages are for people and say what to do; programs look at the variant. `Display` gives one part of an error and
//! [`source`](std::error::Error::source) its cause; [`chain`] joins them.
use lipstream_media::Cause;

pub use lipstream::error::chain;

/// What everything here that can fail returns.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Why a model, or what a model is made from, could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// What was asked for contradicts itself, the data or the model: ask for something else.
    #[error("{0}")]
    Choice(String),
    /// A corpus, a clip, its labels, sound or pictures are not what can be worked with: look at the data.
    #[error("{0}")]
    Data(String),
    /// A file that this program writes is damaged, of another kind or of another version: make it again.
    #[error("{0}")]
    File(String),
    /// A word has no letter and is in no dictionary: add it to one.
    #[error("nothing tells how {word:?} is pronounced: add it to a dictionary of your own")]
    Unspoken {
        /// The word.
        word: String,
    },
    /// The numbers did not work out: a matrix is singular, training diverged.
    #[error("{0}")]
    Numbers(String),
    /// What was being done, or what it was done to, when `source` happened.
    #[error("{what}")]
    Context {
        /// What was being done.
        what: String,
        /// What happened.
        source: Cause,
    },
    /// An error of a library below, in its own words.
    #[error(transparent)]
    Other(Cause),
}

impl Error {
    /// An error of a library below.
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
    serde_json::Error,
    lipstream_media::video::VideoError
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

/// Returns an error of a variant that holds a message.
macro_rules! bail {
    ($variant:ident, $($message:tt)+) => {
        return Err($crate::error::Error::$variant(format!($($message)+)))
    };
}

/// Returns an error of a variant that holds a message unless a condition holds.
macro_rules! ensure {
    ($holds:expr, $variant:ident, $($message:tt)+) => {
        if !$holds {
            $crate::error::bail!($variant, $($message)+);
        }
    };
}

pub(crate) use {bail, ensure};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_follow_what_they_caused() {
        let cause = std::io::Error::other("the disk is full");
        let error = Err::<(), _>(Error::other(cause)).context("cannot write x");
        let error = error.with_context(|| format!("clip {}", 7)).unwrap_err();
        assert_eq!(error.to_string(), "clip 7");
        assert_eq!(chain(&error), "clip 7: cannot write x: the disk is full");
    }
}
