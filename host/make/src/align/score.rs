//! How far found borders are from labelled ones.
use std::fmt::Write as _;

use serde::Serialize;

use super::Alignment;
use crate::features::Clip;

/// Differences of borders, found minus labelled, in seconds.
#[derive(Clone, Debug, Default)]
pub struct Errors(Vec<f64>);

/// What is said of many borders.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Number of borders compared.
    pub borders: usize,
    /// Median of the absolute differences, in ms.
    pub median_ms: f64,
    /// Mean of the absolute differences, in ms.
    pub mean_ms: f64,
    /// Mean of the signed differences: positive where borders are found late.
    pub late_ms: f64,
    /// Share of borders that are off by 10 ms or less, 0 to 1.
    pub within_10_ms: f64,
    /// Share of borders that are off by 20 ms or less, 0 to 1.
    pub within_20_ms: f64,
    /// Share of borders that are off by 50 ms or less, 0 to 1.
    pub within_50_ms: f64,
    /// Share of borders that are off by 100 ms or less, 0 to 1.
    pub within_100_ms: f64,
}

impl Errors {
    /// Starts and ends of words, in the order of the text.
    pub fn add_words(&mut self, clip: &Clip, found: &Alignment) {
        let labelled = clip.words.iter().filter_map(|w| w.time);
        for ((start, end), word) in labelled.zip(&found.words) {
            self.0.push(word.start - f64::from(start));
            self.0.push(word.end - f64::from(end));
        }
    }

    /// Borders between phones; the two sequences are the same.
    pub fn add_phones(&mut self, clip: &Clip, found: &Alignment) {
        for (label, phone) in clip.phones.iter().zip(&found.phones).skip(1) {
            self.0.push(phone.start - f64::from(label.start));
        }
    }

    /// One border, found minus labelled, in seconds.
    pub fn add(&mut self, difference: f64) {
        self.0.push(difference);
    }

    /// Takes in the borders of `other` too.
    pub fn merge(&mut self, other: Errors) {
        self.0.extend(other.0);
    }

    /// `None` without borders.
    pub fn summary(&self) -> Option<Summary> {
        if self.0.is_empty() {
            return None;
        }
        let n = self.0.len() as f64;
        let mut absolute: Vec<f64> = self.0.iter().map(|e| e.abs()).collect();
        absolute.sort_by(f64::total_cmp);
        let half = absolute.len() / 2;
        let median = if absolute.len() % 2 == 1 {
            absolute[half]
        } else {
            0.5 * (absolute[half - 1] + absolute[half])
        };
        // Times are on a grid: a border exactly at the limit is within it, whatever the rounding.
        let within = |s: f64| absolute.partition_point(|e| *e <= s + 1e-6) as f64 / n;
        Some(Summary {
            borders: self.0.len(),
            median_ms: 1e3 * median,
            mean_ms: 1e3 * absolute.iter().sum::<f64>() / n,
            late_ms: 1e3 * self.0.iter().sum::<f64>() / n,
            within_10_ms: within(0.01),
            within_20_ms: within(0.02),
            within_50_ms: within(0.05),
            within_100_ms: within(0.1),
        })
    }
}

/// A Markdown table.
pub fn table(rows: &[(&str, Summary)]) -> String {
    let mut out = String::from(
        "| borders | number | median | mean | bias | within 10 ms | 20 ms | 50 ms | 100 ms |\n\
         |---|---|---|---|---|---|---|---|---|\n",
    );
    for (name, s) in rows {
        let _ = writeln!(
            out,
            "| {name} | {} | {:.1} ms | {:.1} ms | {:+.1} ms | {:.1} % | {:.1} % | {:.1} % | {:.1} % |",
            s.borders,
            s.median_ms,
            s.mean_ms,
            s.late_ms,
            100.0 * s.within_10_ms,
            100.0 * s.within_20_ms,
            100.0 * s.within_50_ms,
            100.0 * s.within_100_ms
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_and_medians() {
        let errors = Errors(vec![0.01, -0.02, 0.03, -0.2]);
        let s = errors.summary().unwrap();
        assert_eq!(s.borders, 4);
        assert!((s.median_ms - 25.0).abs() < 1e-9 && (s.mean_ms - 65.0).abs() < 1e-9);
        assert!((s.late_ms + 45.0).abs() < 1e-9);
        assert_eq!(
            (s.within_10_ms, s.within_20_ms, s.within_50_ms, s.within_100_ms),
            (0.25, 0.5, 0.75, 0.75)
        );
        assert_eq!(Errors::default().summary(), None);
        assert!(table(&[("words", s)]).contains("| words | 4 | 25.0 ms |"));
    }
}
