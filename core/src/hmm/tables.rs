//! The sections of a coupled HMM over a phone loop: its phones and their visemes, its transitions and bigrams.
use super::transition::{MAX_PHONES, N_CHOICES, N_CLASSES};
use crate::frame::N_VISEMES;
use crate::logmath::{LogProb, NEVER_I16};
use crate::model::common::text;
use crate::model::container::{Section, Sections, check};
use crate::model::{I16s, ModelError, put_i16s};

/// u8 `[P]`: viseme of each phone.
pub const PHONE_VISEMES: Section = Section::new(0x100, "PhoneVisemes");
/// `[P][4]`: names in ASCII, filled up with zeros.
pub const PHONE_NAMES: Section = Section::new(0x101, "PhoneNames");
/// i16 `[P][15][4]`, Q5.10 log2: the four choices of each transition class of a phone.
pub const TRANSITIONS: Section = Section::new(0x102, "Transitions");
/// i16 `[P][P]`, Q5.10 log2 of P(next | phone).
pub const BIGRAM: Section = Section::new(0x103, "Bigram");
/// i16 `[P][13]`, Q5.10 log2 of P(viseme of the next phone | phone): the bigram added up by viseme.
pub const VISEME_BIGRAM: Section = Section::new(0x104, "VisemeBigram");
/// i16 `[P]`, Q5.10 log2 of P(first phone).
pub const INITIAL: Section = Section::new(0x105, "Initial");

/// Bytes of a phone's name.
pub const NAME_SIZE: usize = 4;

/// What a coupled HMM knows of phones: which there are, how they look, what follows what.
#[derive(Clone, Copy, Debug)]
pub struct HmmTables<'a> {
    n_phones: usize,
    visemes: &'a [u8],
    names: &'a [u8],
    transitions: I16s<'a>,
    bigram: I16s<'a>,
    viseme_bigram: I16s<'a>,
    initial: I16s<'a>,
}

impl<'a> HmmTables<'a> {
    /// Takes the sections of a coupled HMM.
    pub(crate) fn read(sections: &mut Sections<'a>) -> Result<Self, ModelError> {
        let (visemes, p) = sections.take_items(PHONE_VISEMES, 1, MAX_PHONES)?;
        check(PHONE_VISEMES, visemes.iter().map(|v| usize::from(*v) < N_VISEMES))?;
        let names = sections.take_sized(PHONE_NAMES, NAME_SIZE * p)?;
        check(
            PHONE_NAMES,
            names
                .chunks_exact(NAME_SIZE)
                .map(|name| name[0] != 0 && name.iter().all(|b| *b == 0 || b.is_ascii_graphic())),
        )?;
        let mut logs = |section, count: usize| -> Result<I16s<'a>, ModelError> {
            let values = I16s(sections.take_sized(section, 2 * count)?);
            // Logs of probabilities: none is above 0.
            check(section, values.iter().map(|v| v <= 0))?;
            Ok(values)
        };
        let tables = Self {
            n_phones: p,
            visemes,
            names,
            transitions: logs(TRANSITIONS, p * N_CLASSES * N_CHOICES)?,
            bigram: logs(BIGRAM, p * p)?,
            viseme_bigram: logs(VISEME_BIGRAM, p * N_VISEMES)?,
            initial: logs(INITIAL, p)?,
        };
        // A stream must be able to begin.
        if tables.initial.iter().all(|v| v == NEVER_I16) {
            return Err(ModelError::Value {
                section: INITIAL,
                index: 0,
            });
        }
        Ok(tables)
    }

    /// P, the number of phones.
    #[inline]
    pub fn n_phones(&self) -> usize {
        self.n_phones
    }

    /// Viseme of a phone, below 13.
    #[inline]
    pub fn viseme(&self, phone: usize) -> usize {
        self.visemes.get(phone).map_or(0, |v| usize::from(*v))
    }

    /// Name of a phone; empty beyond the last.
    pub fn phone_name(&self, phone: usize) -> &'a str {
        let place = NAME_SIZE * phone..NAME_SIZE * (phone + 1);
        text(self.names.get(place).unwrap_or(&[]))
    }

    /// Log probabilities of the four choices of a joint state of `phone` in transition class `class`.
    #[inline]
    pub fn choices(&self, phone: usize, class: usize) -> [LogProb; N_CHOICES] {
        let row = self.transitions.row(N_CLASSES * phone + class, N_CHOICES);
        let mut out = [LogProb::NEVER; N_CHOICES];
        for (to, from) in out.iter_mut().zip(row.iter()) {
            *to = LogProb::from_table(from);
        }
        out
    }

    /// Log P(next | phone) for every next phone, Q5.10.
    #[inline]
    pub fn bigram(&self, phone: usize) -> I16s<'a> {
        self.bigram.row(phone, self.n_phones)
    }

    /// Log P(viseme of the next phone | phone) for every viseme, Q5.10.
    #[inline]
    pub fn viseme_bigram(&self, phone: usize) -> I16s<'a> {
        self.viseme_bigram.row(phone, N_VISEMES)
    }

    /// Log P(first phone) for every phone, Q5.10.
    #[inline]
    pub fn initial(&self) -> I16s<'a> {
        self.initial
    }
}

/// Writes one phone into [`PHONE_NAMES`] (1 to 4 bytes of ASCII) and [`PHONE_VISEMES`].
pub fn put_phone<E: Extend<u8>>(names: &mut E, visemes: &mut E, name: &str, viseme: u8) {
    names.extend(name.bytes().chain(core::iter::repeat(0)).take(NAME_SIZE));
    visemes.extend([viseme]);
}

/// Writes logs of probabilities (Q5.10 log2, [`NEVER_I16`] for 0) into [`TRANSITIONS`], [`BIGRAM`], [`VISEME_BIGRAM`] or
/// [`INITIAL`], row by row.
pub fn put_logs(to: &mut impl Extend<u8>, logs: impl IntoIterator<Item = i16>) {
    put_i16s(to, logs);
}
