//! The 47 phones and 13 visemes of X&L table 1, in one fixed order.

/// A phone: an index into [`PHONES`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Phone(pub u8);

/// A viseme: an index into [`VISEMES`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Viseme(pub u8);

/// Names of the visemes (X&L table 1): silence, four classes of vowels by lip rounding, and the places of
/// articulation of the consonants.
pub const VISEMES: [&str; 13] = lipstream_core::frame::VISEME_NAMES;

/// What each viseme looks like, in the order of [`VISEMES`], for people who do not know the table's names.
pub const VISEME_WORDS: [&str; VISEMES.len()] = [
    "at rest",
    "wide open (ah)",
    "puckered (oo)",
    "open (eh)",
    "spread (ee)",
    "tongue raised (l, r)",
    "teeth together (s, z)",
    "tongue behind the teeth (t, d, n)",
    "funnel (sh, ch)",
    "lips closed (p, b, m)",
    "tongue between the teeth (th)",
    "teeth on the lip (f, v)",
    "back of the tongue (k, g)",
];

/// Every phone with the viseme that it looks like (X&L table 1).
pub const PHONES: [(&str, Viseme); 47] = [
    ("sil", Viseme(0)),
    ("sp", Viseme(0)),
    ("ao", Viseme(1)),
    ("aa", Viseme(1)),
    ("ah", Viseme(1)),
    ("er", Viseme(1)),
    ("oy", Viseme(1)),
    ("aw", Viseme(1)),
    ("hh", Viseme(1)),
    ("uw", Viseme(2)),
    ("uh", Viseme(2)),
    ("ow", Viseme(2)),
    ("em", Viseme(2)),
    ("ae", Viseme(3)),
    ("eh", Viseme(3)),
    ("ey", Viseme(3)),
    ("ay", Viseme(3)),
    ("ih", Viseme(4)),
    ("iy", Viseme(4)),
    ("ax", Viseme(4)),
    ("axr", Viseme(4)),
    ("ix", Viseme(4)),
    ("l", Viseme(5)),
    ("el", Viseme(5)),
    ("r", Viseme(5)),
    ("y", Viseme(5)),
    ("s", Viseme(6)),
    ("z", Viseme(6)),
    ("t", Viseme(7)),
    ("d", Viseme(7)),
    ("n", Viseme(7)),
    ("en", Viseme(7)),
    ("sh", Viseme(8)),
    ("zh", Viseme(8)),
    ("ch", Viseme(8)),
    ("jh", Viseme(8)),
    ("p", Viseme(9)),
    ("b", Viseme(9)),
    ("m", Viseme(9)),
    ("th", Viseme(10)),
    ("dh", Viseme(10)),
    ("f", Viseme(11)),
    ("v", Viseme(11)),
    ("ng", Viseme(12)),
    ("k", Viseme(12)),
    ("g", Viseme(12)),
    ("w", Viseme(12)),
];

impl Phone {
    /// Long silence, at the ends of an utterance.
    pub const SIL: Phone = Phone(0);
    /// Short pause between words.
    pub const SP: Phone = Phone(1);

    /// The phone called `name` (lower case), if table 1 has it.
    pub fn from_name(name: &str) -> Option<Phone> {
        PHONES
            .iter()
            .position(|(n, _)| *n == name)
            .map(|i| Phone(i as u8))
    }

    /// Lower-case name as in table 1.
    pub fn name(self) -> &'static str {
        PHONES[usize::from(self.0)].0
    }

    /// The viseme that the phone looks like.
    pub fn viseme(self) -> Viseme {
        PHONES[usize::from(self.0)].1
    }

    /// Whether it is no sound but a silence, [`Phone::SIL`] or [`Phone::SP`].
    pub fn is_pause(self) -> bool {
        self == Phone::SIL || self == Phone::SP
    }

    /// All phones in order.
    pub fn all() -> impl Iterator<Item = Phone> {
        (0..PHONES.len() as u8).map(Phone)
    }
}

impl Viseme {
    /// Name as in table 1.
    pub fn name(self) -> &'static str {
        VISEMES[usize::from(self.0)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_found_again() {
        for phone in Phone::all() {
            assert_eq!(Phone::from_name(phone.name()), Some(phone));
            assert!(usize::from(phone.viseme().0) < VISEMES.len());
        }
        assert_eq!(Phone::from_name("xx"), None);
    }

    #[test]
    fn every_viseme_has_a_phone() {
        for v in 0..VISEMES.len() as u8 {
            assert!(
                Phone::all().any(|p| p.viseme() == Viseme(v)),
                "{}",
                VISEMES[usize::from(v)]
            );
        }
    }
}
