//! Where people put a border, against where the best path changes state: a mean difference for each kind of border.
use ndarray::Array2;

use super::Spoken;
use lipstream::phones::Phone;

/// Broad classes of sounds.
pub(super) const CLASSES: [&str; 6] = ["silence", "vowel", "glide", "nasal", "fricative", "stop"];

/// Differences (s) by the classes of the phones before and after a border, `[6, 6]`; zero where nothing is known.
#[derive(Clone, Debug, PartialEq)]
pub struct Shifts(pub Array2<f32>);

impl Default for Shifts {
    fn default() -> Self {
        Self(Array2::zeros((CLASSES.len(), CLASSES.len())))
    }
}

/// Borders of one kind count as if there were so many more that need no shift.
const SHRINK: f64 = 5.0;

/// No phone becomes shorter than this by shifting (s).
const LEAST: f64 = 0.005;

/// Broad class of a phone.
pub(super) fn class(phone: Phone) -> usize {
    match phone.name() {
        "sil" | "sp" => 0,
        "l" | "r" | "y" | "w" | "el" => 2,
        "m" | "n" | "ng" | "em" | "en" => 3,
        "s" | "z" | "sh" | "zh" | "f" | "v" | "th" | "dh" | "hh" => 4,
        "p" | "b" | "t" | "d" | "k" | "g" | "ch" | "jh" => 5,
        _ => 1,
    }
}

impl Shifts {
    /// From borders: classes before and after, and where the label's border is, seen from the path's (s).
    ///
    /// The median of each kind, drawn towards zero where there are few.
    pub fn learn(borders: &[(usize, usize, f64)]) -> Self {
        let mut out = Self::default();
        for before in 0..CLASSES.len() {
            for after in 0..CLASSES.len() {
                let mut off: Vec<f64> = borders
                    .iter()
                    .filter(|b| (b.0, b.1) == (before, after))
                    .map(|b| b.2)
                    .collect();
                if off.is_empty() {
                    continue;
                }
                off.sort_by(f64::total_cmp);
                let n = off.len() as f64;
                out.0[[before, after]] = (off[off.len() / 2] * n / (n + SHRINK)) as f32;
            }
        }
        out
    }

    /// Shifts the starts of all phones but the first; their order stays.
    pub(super) fn apply(&self, phones: &mut [Spoken]) {
        for i in 1..phones.len() {
            let shift = self.0[[class(phones[i - 1].phone), class(phones[i].phone)]];
            let least = phones[i - 1].start + LEAST;
            // The next border has not moved yet: it may not be passed.
            let most = phones.get(i + 1).map_or(phones[i].end, |next| next.start) - LEAST;
            phones[i].start = (phones[i].start + f64::from(shift)).min(most).max(least);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn borders_move_and_keep_their_order() {
        let phone = |name: &str, start: f64| Spoken {
            phone: Phone::from_name(name).unwrap(),
            start,
            end: 1.0,
            word: None,
            score: 0.0,
        };
        let mut phones = vec![
            phone("sil", 0.0),
            phone("b", 0.3),
            phone("iy", 0.35),
            phone("n", 0.99),
        ];
        let borders: Vec<_> = (0..20).map(|_| (0, 5, 0.1)).chain([(1, 3, 9.0)]).collect();
        let shifts = Shifts::learn(&borders);
        assert!((shifts.0[[0, 5]] - 0.08).abs() < 1e-6);
        assert_eq!(shifts.0[[5, 1]], 0.0);
        shifts.apply(&mut phones);
        let starts: Vec<f64> = phones.iter().map(|p| p.start).collect();
        assert!((starts[1] - 0.345).abs() < 1e-9, "{starts:?}");
        assert!(starts.windows(2).all(|w| w[1] >= w[0] + 0.004), "{starts:?}");
        assert!(starts[3] < 1.0);
    }

    #[test]
    fn every_class_has_a_phone() {
        for c in 0..CLASSES.len() {
            assert!(Phone::all().any(|p| class(p) == c), "{}", CLASSES[c]);
        }
    }
}
