//! Found phones against labelled ones: errors of the sequence, frames with the right phone and the right viseme, borders.
use std::fmt::Write as _;

use serde::Serialize;

use super::score::{Errors, Summary};
use super::{Alignment, Spoken};
use crate::features::PhoneLabel;
use lipstream::phones::Phone;

/// Seconds between two moments that are compared: the hop of every model.
const HOP_S: f64 = 0.01;

/// The phone that stands for `phone` where label sets differ: reduced vowels and syllabic consonants as the full ones, pauses as silence. What
/// is left are CMU's 39 and silence.
pub fn folded(phone: Phone) -> Phone {
    let name = match phone.name() {
        "ax" => "ah",
        "axr" => "er",
        "ix" => "ih",
        "el" => "l",
        "em" => "m",
        "en" => "n",
        "sp" => "sil",
        other => other,
    };
    Phone::from_name(name).unwrap_or(phone)
}

/// Counts over clips.
#[derive(Clone, Debug, Default)]
pub struct Judgement {
    labelled: usize,
    substituted: usize,
    deleted: usize,
    inserted: usize,
    all: Frames,
    speech: Frames,
    borders: Errors,
}

#[derive(Clone, Copy, Debug, Default)]
struct Frames {
    count: usize,
    phone: usize,
    viseme: usize,
}

/// Shares of right frames, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Right {
    /// Frames (10 ms) compared.
    pub frames: usize,
    /// Those whose phone is the labelled one.
    pub phone: f64,
    /// Those whose viseme is the labelled phone's.
    pub viseme: f64,
}

/// What is said of many clips.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Judged {
    /// Labelled phones, silences not counted.
    pub phones: usize,
    /// Substitutions, deletions and insertions together over the labelled phones.
    pub error_rate: f64,
    /// Phones found as another phone, over the labelled phones.
    pub substituted: f64,
    /// Phones not found, over the labelled phones.
    pub deleted: f64,
    /// Phones found that nobody labelled, over the labelled phones.
    pub inserted: f64,
    /// All frames, silence too.
    pub all: Right,
    /// Frames that the labels call speech.
    pub speech: Right,
    /// Starts of the phones that were found right.
    pub borders: Option<Summary>,
}

impl Judgement {
    /// Compares what was found in a clip with its labels; moments that no label covers are silence.
    pub fn add(&mut self, labels: &[PhoneLabel], found: &Alignment) {
        let labelled: Vec<Span> = labels.iter().filter_map(Span::of_label).collect();
        let heard: Vec<Span> = found.phones.iter().map(Span::of_spoken).collect();
        for n in 0..(found.duration / HOP_S) as usize {
            let time = (n as f64 + 0.5) * HOP_S;
            let (is, says) = (at(&labelled, time), at(&heard, time));
            self.all.add(is, says);
            if is != Phone::SIL {
                self.speech.add(is, says);
            }
        }
        let speech = |spans: &[Span]| -> Vec<Span> {
            let spoken = spans.iter().filter(|s| s.phone != Phone::SIL);
            spoken.copied().collect()
        };
        let (labelled, heard) = (speech(&labelled), speech(&heard));
        self.labelled += labelled.len();
        for pair in matched(&labelled, &heard) {
            match pair {
                (Some(label), Some(said)) if label.phone == said.phone => {
                    self.borders.add(said.start - label.start);
                }
                (Some(_), Some(_)) => self.substituted += 1,
                (Some(_), None) => self.deleted += 1,
                (None, _) => self.inserted += 1,
            }
        }
    }

    /// Takes in the clips of `other` too.
    pub fn merge(&mut self, other: Judgement) {
        self.labelled += other.labelled;
        self.substituted += other.substituted;
        self.deleted += other.deleted;
        self.inserted += other.inserted;
        self.all.merge(other.all);
        self.speech.merge(other.speech);
        self.borders.merge(other.borders);
    }

    /// `None` where no label names a phone.
    pub fn summary(&self) -> Option<Judged> {
        if self.labelled == 0 {
            return None;
        }
        let share = |count: usize| count as f64 / self.labelled as f64;
        Some(Judged {
            phones: self.labelled,
            error_rate: share(self.substituted + self.deleted + self.inserted),
            substituted: share(self.substituted),
            deleted: share(self.deleted),
            inserted: share(self.inserted),
            all: self.all.right(),
            speech: self.speech.right(),
            borders: self.borders.summary(),
        })
    }
}

impl Frames {
    fn add(&mut self, is: Phone, says: Phone) {
        self.count += 1;
        self.phone += usize::from(is == says);
        self.viseme += usize::from(is.viseme() == says.viseme());
    }

    fn merge(&mut self, other: Frames) {
        self.count += other.count;
        self.phone += other.phone;
        self.viseme += other.viseme;
    }

    fn right(self) -> Right {
        let share = |count: usize| count as f64 / self.count.max(1) as f64;
        Right {
            frames: self.count,
            phone: share(self.phone),
            viseme: share(self.viseme),
        }
    }
}

/// A folded phone in time.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Span {
    phone: Phone,
    start: f64,
    end: f64,
}

impl Span {
    fn of_label(label: &PhoneLabel) -> Option<Self> {
        Some(Self {
            phone: folded(Phone::from_name(&label.phone)?),
            start: label.start.into(),
            end: label.end.into(),
        })
    }

    fn of_spoken(spoken: &Spoken) -> Self {
        Self {
            phone: folded(spoken.phone),
            start: spoken.start,
            end: spoken.end,
        }
    }
}

fn at(spans: &[Span], time: f64) -> Phone {
    let next = spans.partition_point(|s| s.start <= time);
    let span = next.checked_sub(1).and_then(|n| spans.get(n));
    span.filter(|s| time < s.end).map_or(Phone::SIL, |s| s.phone)
}

/// Pairs of labelled and found phones with the fewest errors, and of those the nearest in time.
fn matched(labelled: &[Span], found: &[Span]) -> Vec<(Option<Span>, Option<Span>)> {
    /// What a second of distance counts in errors: too little to cost one.
    const PER_SECOND: f64 = 1e-6;
    let (n, m) = (labelled.len(), found.len());
    let pair = |i: usize, j: usize| {
        let wrong = f64::from(u8::from(labelled[i].phone != found[j].phone));
        wrong + PER_SECOND * (labelled[i].start - found[j].start).abs()
    };
    let mut cost = vec![vec![0.0; m + 1]; n + 1];
    for i in 0..=n {
        for j in 0..=m {
            if i + j > 0 {
                let mut best = f64::INFINITY;
                if i > 0 && j > 0 {
                    best = cost[i - 1][j - 1] + pair(i - 1, j - 1);
                }
                if i > 0 {
                    best = best.min(cost[i - 1][j] + 1.0);
                }
                if j > 0 {
                    best = best.min(cost[i][j - 1] + 1.0);
                }
                cost[i][j] = best;
            }
        }
    }
    let (mut i, mut j) = (n, m);
    let mut out = Vec::new();
    while i + j > 0 {
        if i > 0 && j > 0 && cost[i][j] == cost[i - 1][j - 1] + pair(i - 1, j - 1) {
            (i, j) = (i - 1, j - 1);
            out.push((Some(labelled[i]), Some(found[j])));
        } else if i > 0 && cost[i][j] == cost[i - 1][j] + 1.0 {
            i -= 1;
            out.push((Some(labelled[i]), None));
        } else {
            j -= 1;
            out.push((None, Some(found[j])));
        }
    }
    out.reverse();
    out
}

/// A Markdown table.
pub fn table(rows: &[(&str, Judged)]) -> String {
    let mut out = String::from(
        "| phones | labelled | errors | other, missing, too many | right phone: frames | in speech | right viseme: frames | in speech \
         | borders, median | within 20 ms |\n|---|---|---|---|---|---|---|---|---|---|\n",
    );
    let percent = |share: f64| 100.0 * share;
    for (name, j) in rows {
        let (median, within) = j
            .borders
            .map_or((f64::NAN, f64::NAN), |b| (b.median_ms, b.within_20_ms));
        let _ = writeln!(
            out,
            "| {name} | {} | {:.1} % | {:.1}, {:.1}, {:.1} % | {:.1} % | {:.1} % | {:.1} % | {:.1} % | {median:.1} ms | {:.1} % |",
            j.phones,
            percent(j.error_rate),
            percent(j.substituted),
            percent(j.deleted),
            percent(j.inserted),
            percent(j.all.phone),
            percent(j.speech.phone),
            percent(j.all.viseme),
            percent(j.speech.viseme),
            percent(within)
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(phones: &[(&str, f32, f32)]) -> Vec<PhoneLabel> {
        let label = |&(phone, start, end): &(&str, f32, f32)| PhoneLabel {
            phone: phone.into(),
            start,
            end,
        };
        phones.iter().map(label).collect()
    }

    fn found(phones: &[(&str, f64, f64)]) -> Alignment {
        let spoken = |&(phone, start, end): &(&str, f64, f64)| Spoken {
            phone: Phone::from_name(phone).unwrap(),
            start,
            end,
            word: None,
            score: 0.0,
        };
        Alignment {
            duration: 1.0,
            phones: phones.iter().map(spoken).collect(),
            ..Alignment::default()
        }
    }

    #[test]
    fn errors_frames_and_borders_are_counted() {
        let labels = labels(&[
            ("sil", 0.0, 0.2),
            ("b", 0.2, 0.3),
            ("ax", 0.3, 0.5),
            ("s", 0.5, 0.7),
            ("k", 0.7, 0.8),
            ("sil", 0.8, 1.0),
        ]);
        // b is taken for p, which looks the same; ah is ax; k is lost; a t is too many.
        let heard = found(&[
            ("sil", 0.0, 0.2),
            ("p", 0.2, 0.3),
            ("ah", 0.3, 0.53),
            ("s", 0.53, 0.8),
            ("sp", 0.8, 0.9),
            ("t", 0.9, 1.0),
        ]);
        let mut judgement = Judgement::default();
        judgement.add(&labels, &heard);
        let j = judgement.summary().unwrap();
        // The t may stand for the k: one other phone more, none missing, none too many.
        assert_eq!((j.phones, j.error_rate), (4, 0.5));
        assert_eq!((j.substituted, j.deleted, j.inserted), (0.5, 0.0, 0.0));
        assert_eq!((j.all.frames, j.speech.frames), (100, 60));
        assert!((j.speech.phone - 37.0 / 60.0).abs() < 1e-9, "{j:?}");
        assert!((j.speech.viseme - 47.0 / 60.0).abs() < 1e-9, "{j:?}");
        assert!((j.all.phone - 67.0 / 100.0).abs() < 1e-9, "{j:?}");
        let borders = j.borders.unwrap();
        assert_eq!(borders.borders, 2);
        assert!((borders.late_ms - 15.0).abs() < 1e-3, "{borders:?}");
        let mut twice = judgement.clone();
        twice.merge(judgement);
        assert_eq!(twice.summary().unwrap().phones, 8);
        assert_eq!(twice.summary().unwrap().all.phone, j.all.phone);
        assert!(table(&[("recognised", j)]).contains("| recognised | 4 | 50.0 % | 50.0, 0.0, 0.0 %"));
        assert_eq!(Judgement::default().summary(), None);
    }

    #[test]
    fn missing_and_superfluous_phones_are_told_from_other_ones() {
        let labels = labels(&[("b", 0.0, 0.2), ("iy", 0.2, 0.4), ("s", 0.4, 0.6)]);
        let mut judgement = Judgement::default();
        judgement.add(&labels, &found(&[("b", 0.0, 0.2), ("s", 0.4, 0.6)]));
        judgement.add(
            &labels,
            &found(&[
                ("b", 0.0, 0.2),
                ("iy", 0.2, 0.3),
                ("n", 0.3, 0.4),
                ("s", 0.4, 0.6),
            ]),
        );
        let j = judgement.summary().unwrap();
        let sixth = 1.0 / 6.0;
        assert_eq!((j.substituted, j.deleted, j.inserted), (0.0, sixth, sixth));
    }

    #[test]
    fn every_phone_folds_to_one_that_stays() {
        let kept: std::collections::BTreeSet<Phone> = Phone::all().map(folded).collect();
        assert_eq!(kept.len(), 40);
        assert!(kept.iter().all(|p| folded(*p) == *p));
    }
}
