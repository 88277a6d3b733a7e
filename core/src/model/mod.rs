//! The model's tables: one little-endian block of bytes, read in place.
//!
//! A [`Model`] is what all kinds of model share (its [`Head`]) and the tables of one kind. [`Model::new_checked`] verifies every
//! byte; after it no accessor can fail or panic (an index beyond the model's sizes gives zeros or nothing). Each section has its
//! reader and its writer side by side in one file: [`common`] has those of every model, the kinds have theirs. The format is
//! described for people in `docs/model-blob.md`.
pub mod common;
pub mod container;
mod error;
mod parts;

use core::fmt;

pub use common::Head;
pub use container::Section;
pub use error::ModelError;
pub use parts::{I16s, U16s, put_f32s, put_i16s, put_i32s, put_u16s, put_u32s};
pub(crate) use parts::{i32s, u16_at, u32_at};

use crate::kinds::Kind;
use container::{Place, Sections};

/// A model of kind `K` whose bytes have been checked. It borrows the bytes and copies none of the tables.
#[derive(Clone, Copy, Debug)]
pub struct Model<'a, K> {
    head: Head<'a>,
    own: K,
}

impl<'a, K: Kind<'a>> Model<'a, K> {
    /// Checks `bytes` from the first to the last.
    ///
    /// # Errors
    ///
    /// [`ModelError`] says what is wrong; [`ModelError::OtherKind`] if they are a model, but of another kind.
    pub fn new_checked(bytes: &'a [u8]) -> Result<Self, ModelError> {
        Self::of(Sections::open(bytes)?)
    }

    /// The same, its sections in several kinds of memory: each is read from where `place` says, the very bytes or a copy of them. A device has a
    /// fast memory that does not hold all of a model, and a slow one that does.
    ///
    /// # Errors
    ///
    /// As [`Model::new_checked`]. What is checked is what will be read.
    pub fn new_placed(bytes: &'a [u8], place: Place<'a>) -> Result<Self, ModelError> {
        Self::of(Sections::open_placed(bytes, place)?)
    }

    fn of(mut sections: Sections<'a>) -> Result<Self, ModelError> {
        let kind = sections.kind();
        if kind != K::TAG {
            return Err(match crate::kinds::name_of(kind) {
                Some(have) => ModelError::OtherKind { have, want: K::NAME },
                None => ModelError::UnknownKind { kind },
            });
        }
        let head = Head::read(&mut sections)?;
        let own = K::read(&mut sections, &head)?;
        sections.finish()?;
        Ok(Self { head, own })
    }
}

impl<'a, K> Model<'a, K> {
    /// What every model has, whatever its kind.
    #[inline]
    pub fn head(&self) -> &Head<'a> {
        &self.head
    }

    /// The tables of the model's kind.
    #[inline]
    pub fn own(&self) -> &K {
        &self.own
    }
}

impl<K> fmt::Display for Model<'_, K> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "model {:08x}", self.head.id())
    }
}
