//! The container of the model's tables, format version 5: who may read them, and where each section lies.
//!
//! ```text
//! header             32 bytes, names the kind of model
//! section table      12 bytes a section: tag u16, zero u16, offset u32, length u32; tags increase
//! sections           those of the kind and no others, each starting at a multiple of 4
//! CRC-32 (ISO-HDLC)  4 bytes, over everything before it
//! ```
//!
//! What a section holds is said where it is read and written: `model/common.rs`, `hmm/tables.rs`, `context/tables.rs`, and
//! `tables.rs` of each kind. Everything is little-endian.
use super::error::ModelError;
use super::parts::{u16_at, u32_at};

/// First bytes of every model.
pub const MAGIC: [u8; 8] = *b"lipstrm\0";
/// Version of this layout; any other is refused.
pub const FORMAT_VERSION: u16 = 5;
/// The front end that the tables were trained for. Raised whenever its numbers change.
pub const FRONT_END_FINGERPRINT: u32 = 0x4850_0002;

/// Offsets in the header.
pub mod header {
    /// The eight bytes of [`MAGIC`](super::MAGIC).
    pub const MAGIC: usize = 0;
    /// u16, [`FORMAT_VERSION`](super::FORMAT_VERSION).
    pub const VERSION: usize = 8;
    /// u16, entries of the section table.
    pub const N_SECTIONS: usize = 10;
    /// u32, length of the whole block with its CRC.
    pub const LENGTH: usize = 12;
    /// u32, [`FRONT_END_FINGERPRINT`](super::FRONT_END_FINGERPRINT).
    pub const FRONT_END: usize = 16;
    /// u32, the number that tells models apart: CRC-32 of the sections' CRC-32s in the order of the table.
    pub const MODEL_ID: usize = 20;
    /// u16, which kind of model this is: [`Kind::TAG`](crate::kinds::Kind::TAG).
    pub const KIND: usize = 24;
    /// Six bytes, zero.
    pub const RESERVED: usize = 26;
    /// Bytes of the header.
    pub const SIZE: usize = 32;
}

/// Offsets in one entry of the section table.
pub mod entry {
    /// u16
    pub const TAG: usize = 0;
    /// u16, zero
    pub const RESERVED: usize = 2;
    /// u32, from the start of the block
    pub const OFFSET: usize = 4;
    /// u32
    pub const LENGTH: usize = 8;
    /// Bytes of an entry.
    pub const SIZE: usize = 12;
}

/// Bytes of the CRC at the end.
pub const CRC_SIZE: usize = 4;
/// Sections start at multiples of this.
pub const ALIGNMENT: usize = 4;

/// A section: the number by which the table names it, and the name by which messages do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Section {
    /// Number in the section table. Each kind has a range of its own; those below 0x1000 are shared.
    pub tag: u16,
    /// Name in messages.
    pub name: &'static str,
}

impl Section {
    /// A section of this tag and name.
    pub const fn new(tag: u16, name: &'static str) -> Self {
        Self { tag, name }
    }
}

static CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);

/// The checksum of models, and of what else lies in flash: the CRC-32 of zip and PNG.
pub fn checksum(bytes: &[u8]) -> u32 {
    CRC.checksum(bytes)
}

/// How long the model says it is that these bytes begin with; none where they begin with no model. For one that lies in a larger
/// region of memory: everything else about it is still to be checked.
pub fn stated_length(bytes: &[u8]) -> Option<usize> {
    let header = bytes.get(..header::SIZE)?;
    header
        .starts_with(&MAGIC)
        .then(|| u32_at(header, header::LENGTH) as usize)
}

/// The sections of a block of bytes whose header, checksum and section table are right.
///
/// Readers take the sections that they know with [`Sections::take`]; [`Sections::finish`] then refuses what nobody took, so that
/// a block holds its kind's sections and no others.
#[derive(Debug)]
pub struct Sections<'a> {
    bytes: &'a [u8],
    count: usize,
    taken: usize,
    place: Place<'a>,
}

/// Where a section's bytes are read from: those that it is given, or a copy of them where reading is faster.
pub type Place<'a> = fn(Section, &'a [u8]) -> &'a [u8];

impl<'a> Sections<'a> {
    /// Checks everything but the sections' contents.
    pub fn open(bytes: &'a [u8]) -> Result<Self, ModelError> {
        Self::open_placed(bytes, |_, section| section)
    }

    /// The same; every section that is taken is read from where `place` says.
    pub fn open_placed(bytes: &'a [u8], place: Place<'a>) -> Result<Self, ModelError> {
        let have = bytes.len();
        if bytes.get(..MAGIC.len()).is_some_and(|b| b != MAGIC) {
            return Err(ModelError::NoModel);
        }
        let need = header::SIZE + CRC_SIZE;
        if have < need {
            return Err(ModelError::TooShort { have, need });
        }
        let version = u16_at(bytes, header::VERSION);
        if version != FORMAT_VERSION {
            return Err(ModelError::Version {
                have: version,
                want: FORMAT_VERSION,
            });
        }
        let stated = u32_at(bytes, header::LENGTH) as usize;
        if stated > have {
            return Err(ModelError::TooShort { have, need: stated });
        }
        if stated != have {
            return Err(ModelError::Length { stated, have });
        }
        let (body, _) = bytes.split_at(have - CRC_SIZE);
        let stated = u32_at(bytes, have - CRC_SIZE);
        let computed = checksum(body);
        if stated != computed {
            return Err(ModelError::Checksum { stated, computed });
        }
        let front_end = u32_at(bytes, header::FRONT_END);
        if front_end != FRONT_END_FINGERPRINT {
            return Err(ModelError::FrontEnd {
                have: front_end,
                want: FRONT_END_FINGERPRINT,
            });
        }
        let count = usize::from(u16_at(bytes, header::N_SECTIONS));
        let sections = Self {
            bytes,
            count,
            taken: 0,
            place,
        };
        sections.check_table(body.len())?;
        Ok(sections)
    }

    /// Every entry of the table lies inside the block, aligned; tags increase, so that none is there twice.
    fn check_table(&self, end: usize) -> Result<(), ModelError> {
        let start = header::SIZE + self.count * entry::SIZE;
        let mut last = None;
        for at in 0..self.count {
            let (tag, offset, length) = self.entry(at);
            let inside = offset >= start && offset.checked_add(length).is_some_and(|e| e <= end);
            let increases = last.is_none_or(|last| tag > last);
            if start > end || !inside || !offset.is_multiple_of(ALIGNMENT) || !increases {
                return Err(ModelError::SectionTable { entry: at });
            }
            last = Some(tag);
        }
        Ok(())
    }

    fn entry(&self, at: usize) -> (u16, usize, usize) {
        let base = header::SIZE + at * entry::SIZE;
        (
            u16_at(self.bytes, base + entry::TAG),
            u32_at(self.bytes, base + entry::OFFSET) as usize,
            u32_at(self.bytes, base + entry::LENGTH) as usize,
        )
    }

    /// The whole block.
    pub fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// Number of the kind that the header names.
    pub fn kind(&self) -> u16 {
        u16_at(self.bytes, header::KIND)
    }

    /// The bytes of a section if it is there, whatever their number. To be asked for each section once.
    pub fn take_if_there(&mut self, section: Section) -> Option<&'a [u8]> {
        let (_, offset, length) = (0..self.count)
            .map(|at| self.entry(at))
            .find(|(tag, ..)| *tag == section.tag)?;
        self.taken += 1;
        let bytes = self.bytes.get(offset..offset.saturating_add(length))?;
        Some((self.place)(section, bytes))
    }

    /// The bytes of a section, whatever their number.
    pub fn take(&mut self, section: Section) -> Result<&'a [u8], ModelError> {
        self.take_if_there(section).ok_or(ModelError::Missing { section })
    }

    /// The bytes of a section, which must be so many.
    pub fn take_sized(&mut self, section: Section, want: usize) -> Result<&'a [u8], ModelError> {
        let bytes = self.take(section)?;
        match bytes.len() {
            have if have == want => Ok(bytes),
            have => Err(ModelError::SectionLength { section, have, want }),
        }
    }

    /// The bytes of a section that gives a size of the model: 1 to `most` items of `item` bytes. Gives their number too.
    pub fn take_items(
        &mut self,
        section: Section,
        item: usize,
        most: usize,
    ) -> Result<(&'a [u8], usize), ModelError> {
        let bytes = self.take(section)?;
        let have = bytes.len() / item.max(1);
        if !bytes.len().is_multiple_of(item) {
            let want = item * have;
            return Err(ModelError::SectionLength {
                section,
                have: bytes.len(),
                want,
            });
        }
        if have == 0 || have > most {
            return Err(ModelError::Size { section, have, most });
        }
        Ok((bytes, have))
    }

    /// Refuses sections that nobody took.
    pub fn finish(self) -> Result<(), ModelError> {
        match self.taken == self.count {
            true => Ok(()),
            false => Err(ModelError::Foreign {
                sections: self.count.saturating_sub(self.taken),
            }),
        }
    }
}

/// Refuses the first number of a section that is not good.
pub(crate) fn check(section: Section, good: impl IntoIterator<Item = bool>) -> Result<(), ModelError> {
    match good.into_iter().position(|good| !good) {
        Some(index) => Err(ModelError::Value { section, index }),
        None => Ok(()),
    }
}

/// Writes a whole block: header, section table, `sections` by increasing tag, checksum. What [`Sections::open`] reads.
///
/// Blocks longer than 4 GiB and more than 65,535 sections cannot be written.
pub fn write(kind: u16, sections: &[(Section, &[u8])], to: &mut impl Extend<u8>) {
    let mut out = Checked {
        to,
        crc: CRC.digest(),
    };
    let start = header::SIZE + sections.len() * entry::SIZE;
    let padded = |bytes: &[u8]| bytes.len().next_multiple_of(ALIGNMENT);
    let length: usize = sections.iter().map(|(_, bytes)| padded(bytes)).sum();
    let mut id = CRC.digest();
    for (_, bytes) in sections {
        id.update(&checksum(bytes).to_le_bytes());
    }
    out.put(&MAGIC);
    out.put(&FORMAT_VERSION.to_le_bytes());
    out.put(&(sections.len() as u16).to_le_bytes());
    out.put(&((start + length + CRC_SIZE) as u32).to_le_bytes());
    out.put(&FRONT_END_FINGERPRINT.to_le_bytes());
    out.put(&id.finalize().to_le_bytes());
    out.put(&kind.to_le_bytes());
    out.put(&[0; header::SIZE - header::RESERVED]);
    let mut offset = start;
    for (section, bytes) in sections {
        out.put(&section.tag.to_le_bytes());
        out.put(&[0; 2]);
        out.put(&(offset as u32).to_le_bytes());
        out.put(&(bytes.len() as u32).to_le_bytes());
        offset += padded(bytes);
    }
    for (_, bytes) in sections {
        out.put(bytes);
        out.put(&[0; ALIGNMENT][..padded(bytes) - bytes.len()]);
    }
    out.finish();
}

/// Passes bytes on and checksums them.
struct Checked<'t, E> {
    to: &'t mut E,
    crc: crc::Digest<'static, u32>,
}

impl<E: Extend<u8>> Checked<'_, E> {
    fn put(&mut self, bytes: &[u8]) {
        self.crc.update(bytes);
        self.to.extend(bytes.iter().copied());
    }

    fn finish(self) {
        self.to.extend(self.crc.finalize().to_le_bytes());
    }
}
