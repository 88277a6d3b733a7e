//! What can be wrong with a model's bytes.
use core::fmt;

use super::field::Section;

/// A size of the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Size {
    Phones,
    Densities,
    Taps,
    Inputs,
    Parameters,
    Memory,
    Means,
    /// Bits of [`super::field::owns`].
    Owns,
    VisualDensities,
}

/// Why bytes are no model that this core can run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ModelError {
    /// Fewer bytes than header and checksum take, or than the header says.
    TooShort { have: usize, need: usize },
    /// Does not begin with the magic bytes.
    NoModel,
    /// Layout of another version.
    Version { have: u16, want: u16 },
    /// The header's length is not the number of bytes given.
    Length { stated: usize, have: usize },
    /// The bytes have changed since they were written.
    Checksum { stated: u32, computed: u32 },
    /// Trained for another front end.
    FrontEnd { have: u32, want: u32 },
    /// A section is missing, there twice, outside the block or not aligned.
    Place { section: Section },
    /// The section table holds another number of sections or a tag that this version does not have.
    SectionTable { entry: usize },
    /// A section is not as long as the model's sizes say.
    SectionLength {
        section: Section,
        have: usize,
        want: usize,
    },
    /// A size is too small or larger than the core's buffers.
    Shape { size: Size, have: usize, limit: usize },
    /// A number in a section is out of its range.
    Value { section: Section, index: usize },
}

impl fmt::Display for ModelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooShort { have, need } => {
                write!(f, "model cut short: {have} bytes, at least {need} needed")
            }
            Self::NoModel => write!(f, "no lipstream model: it does not begin with the magic bytes"),
            Self::Version { have, want } => {
                write!(
                    f,
                    "model format version {have}, this build reads {want}: export the model again"
                )
            }
            Self::Length { stated, have } => {
                write!(f, "model says it has {stated} bytes but {have} are here")
            }
            Self::Checksum { stated, computed } => {
                write!(
                    f,
                    "model is damaged: checksum {computed:08x}, expected {stated:08x}"
                )
            }
            Self::FrontEnd { have, want } => {
                write!(
                    f,
                    "model is for front end {have:08x}, this build has {want:08x}: train and export it again"
                )
            }
            Self::Place { section } => write!(f, "model section {section:?} is missing or misplaced"),
            Self::SectionTable { entry } => write!(f, "model section table is wrong at entry {entry}"),
            Self::SectionLength { section, have, want } => {
                write!(f, "model section {section:?} has {have} bytes, expected {want}")
            }
            Self::Shape { size, have, limit } => {
                write!(f, "model size {size:?} is {have}, allowed are at most {limit}")
            }
            Self::Value { section, index } => {
                write!(f, "model section {section:?} is out of range at number {index}")
            }
        }
    }
}

impl core::error::Error for ModelError {}
