//! What can be wrong with a model's bytes.
use core::fmt;

use super::container::Section;

/// Why bytes are no model that this core, or this kind of stream, can run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ModelError {
    /// Fewer bytes than header and checksum take, or than the header says.
    TooShort {
        /// Bytes that are here.
        have: usize,
        /// Bytes that there must be.
        need: usize,
    },
    /// Does not begin with the magic bytes.
    NoModel,
    /// Layout of another version.
    Version {
        /// The tables' version.
        have: u16,
        /// The version that this build reads.
        want: u16,
    },
    /// The header's length is not the number of bytes given.
    Length {
        /// What the header says.
        stated: usize,
        /// Bytes that are here.
        have: usize,
    },
    /// The bytes have changed since they were written.
    Checksum {
        /// The checksum in the tables.
        stated: u32,
        /// The checksum of the tables.
        computed: u32,
    },
    /// Trained for another front end.
    FrontEnd {
        /// The tables' front end.
        have: u32,
        /// This build's front end.
        want: u32,
    },
    /// A kind of model that this build does not know.
    UnknownKind {
        /// Number of the kind in the header.
        kind: u16,
    },
    /// Another kind of model than was asked for.
    OtherKind {
        /// Name of the kind in the header.
        have: &'static str,
        /// Name of the kind that was asked for.
        want: &'static str,
    },
    /// An entry of the section table points outside the block, is not aligned, or does not follow the one before it.
    SectionTable {
        /// Which entry.
        entry: usize,
    },
    /// A section of this kind of model is not there.
    Missing {
        /// The section.
        section: Section,
    },
    /// Sections that this kind of model does not have.
    Foreign {
        /// Their number.
        sections: usize,
    },
    /// A section is not as long as the sizes of the model ask for.
    SectionLength {
        /// The section.
        section: Section,
        /// Its bytes.
        have: usize,
        /// Bytes that it should have.
        want: usize,
    },
    /// A section that gives a size of the model has no items, or more than the core's buffers hold.
    Size {
        /// The section.
        section: Section,
        /// Its items.
        have: usize,
        /// Most items that this build takes.
        most: usize,
    },
    /// A number in a section is out of its range.
    Value {
        /// The section.
        section: Section,
        /// Which of its numbers.
        index: usize,
    },
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
            Self::UnknownKind { kind } => {
                write!(
                    f,
                    "model is of kind {kind}, which this build does not know: a newer lipstream made it"
                )
            }
            Self::OtherKind { have, want } => {
                write!(
                    f,
                    "model is of kind {have}, this program was built for kind {want}"
                )
            }
            Self::SectionTable { entry } => write!(f, "model section table is wrong at entry {entry}"),
            Self::Missing { section } => write!(f, "model section {} is missing", section.name),
            Self::Foreign { sections } => {
                write!(f, "model has {sections} sections that are not of its kind")
            }
            Self::SectionLength { section, have, want } => {
                let name = section.name;
                write!(f, "model section {name} has {have} bytes, expected {want}")
            }
            Self::Size { section, have, most } => {
                let name = section.name;
                write!(
                    f,
                    "model section {name} has {have} items, allowed are 1 to {most}"
                )
            }
            Self::Value { section, index } => {
                let name = section.name;
                write!(f, "model section {name} is out of range at number {index}")
            }
        }
    }
}

impl core::error::Error for ModelError {}
