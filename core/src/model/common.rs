//! The sections that every model has: the groups of its parameters, their scales, and where the front end's causal mean starts.
use core::ops::Range;

use super::container::{Section, Sections, check, header};
use super::error::ModelError;
use super::parts::{I16s, i32s, u16_at, u32_at};
use crate::N_STATIC;
use crate::frame::{MAX_GROUPS, MAX_PARAMETERS};

/// `[G]` of (name `[8]` in ASCII, filled up with zeros; size u16): the named parts of a frame, one after another.
pub const GROUPS: Section = Section::new(0, "Groups");
/// i16 `[13]`, Q7.8: the mean of the raw statics that the causal mean starts from.
pub const START_MEAN: Section = Section::new(1, "StartMean");
/// f32 `[D]`: real units of one parameter LSB. Carried for the host, never computed with here.
pub const PARAMETER_SCALE: Section = Section::new(2, "ParameterScale");

/// Most bytes of a group's name.
pub const GROUP_NAME_SIZE: usize = 8;
const GROUP_SIZE: usize = GROUP_NAME_SIZE + 2;

/// What every model has, whatever its kind.
#[derive(Clone, Copy, Debug)]
pub struct Head<'a> {
    bytes: &'a [u8],
    groups: &'a [u8],
    start_mean: &'a [u8],
    parameter_scale: &'a [u8],
}

/// A named part of a frame's parameters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Group<'a> {
    /// Its name: short, lower-case ASCII, such as `mouth`.
    pub name: &'a str,
    /// Its place among a frame's values.
    pub place: Range<usize>,
}

impl Group<'_> {
    /// This group's part of a frame's values.
    pub fn of<'v, T>(&self, values: &'v [T]) -> &'v [T] {
        values.get(self.place.clone()).unwrap_or(&[])
    }
}

impl<'a> Head<'a> {
    pub(super) fn read(sections: &mut Sections<'a>) -> Result<Self, ModelError> {
        let (groups, n_groups) = sections.take_items(GROUPS, GROUP_SIZE, MAX_GROUPS)?;
        let items = groups.as_chunks::<GROUP_SIZE>().0;
        check(
            GROUPS,
            items.iter().enumerate().map(|(i, item)| {
                let name = &item[..GROUP_NAME_SIZE];
                let is_new = items[..i].iter().all(|before| &before[..GROUP_NAME_SIZE] != name);
                has_group_name(item) && is_new && u16_at(item, GROUP_NAME_SIZE) > 0
            }),
        )?;
        let sizes = items
            .iter()
            .map(|item| usize::from(u16_at(item, GROUP_NAME_SIZE)));
        let n_parameters: usize = sizes.sum();
        if n_parameters > MAX_PARAMETERS {
            return Err(ModelError::Value {
                section: GROUPS,
                index: n_groups - 1,
            });
        }
        let head = Self {
            bytes: sections.bytes(),
            groups,
            start_mean: sections.take_sized(START_MEAN, 2 * N_STATIC)?,
            parameter_scale: sections.take_sized(PARAMETER_SCALE, 4 * n_parameters)?,
        };
        check(PARAMETER_SCALE, i32s(head.parameter_scale).map(is_positive_f32))?;
        Ok(head)
    }

    /// The bytes that this is a view of.
    pub fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// Number that tells models apart: a checksum of the tables.
    pub fn id(&self) -> u32 {
        u32_at(self.bytes, header::MODEL_ID)
    }

    /// D, the parameters of a frame: all groups together.
    #[inline]
    pub fn n_parameters(&self) -> usize {
        self.parameter_scale.len() / 4
    }

    /// The named parts of a frame, in the order in which their parameters stand there.
    pub fn groups(&self) -> impl Iterator<Item = Group<'a>> + use<'a> {
        let mut first = 0;
        self.groups.as_chunks::<GROUP_SIZE>().0.iter().map(move |item| {
            let start = first;
            first += usize::from(u16_at(item, GROUP_NAME_SIZE));
            Group {
                name: text(&item[..GROUP_NAME_SIZE]),
                place: start..first,
            }
        })
    }

    /// Real units of one LSB of each parameter, for the host: never computed with here.
    pub fn parameter_scales(&self) -> impl ExactSizeIterator<Item = f32> + use<'a> {
        self.parameter_scale
            .as_chunks()
            .0
            .iter()
            .map(|b| f32::from_bits(u32::from_le_bytes(*b)))
    }

    /// Mean of the raw statics that a stream starts from, Q7.8.
    pub fn start_mean(&self) -> [i16; N_STATIC] {
        let mut mean = [0; N_STATIC];
        for (to, from) in mean.iter_mut().zip(I16s(self.start_mean).iter()) {
            *to = from;
        }
        mean
    }
}

/// Writes one group into [`GROUPS`]: a name of 1 to 8 bytes of lower-case ASCII letters, and how many parameters it has.
pub fn put_group(to: &mut impl Extend<u8>, name: &str, size: u16) {
    let name = name.bytes().chain(core::iter::repeat(0)).take(GROUP_NAME_SIZE);
    to.extend(name);
    to.extend(size.to_le_bytes());
}

/// The text of a name that is filled up with zeros.
pub(crate) fn text(name: &[u8]) -> &str {
    let end = name.iter().position(|b| *b == 0).unwrap_or(name.len());
    core::str::from_utf8(&name[..end]).unwrap_or("")
}

fn has_group_name(item: &[u8; GROUP_SIZE]) -> bool {
    let name = &item[..GROUP_NAME_SIZE];
    let letters = text(name);
    let filled = name.iter().skip(letters.len()).all(|b| *b == 0);
    !letters.is_empty() && filled && letters.bytes().all(|b| b.is_ascii_lowercase())
}

/// Whether these are the bits of a normal, positive f32.
fn is_positive_f32(bits: i32) -> bool {
    (0x0080_0000..0x7f80_0000).contains(&bits)
}
