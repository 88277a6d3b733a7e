//! How often the mouth's class changes in speech: the likeliest viseme of each frame, and the cues that an animator gets.
use ndarray::{ArrayView1, ArrayView2};

use super::spoken;
use crate::error::{Error, Result};
use crate::features::PhoneLabel;
use crate::train::data;
use lipstream::cues;

/// Changes counted over some seconds of speech.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Changes {
    visemes: usize,
    cues: usize,
    seconds: f64,
}

pub(super) fn likeliest(row: ArrayView1<f32>) -> usize {
    (0..row.len())
        .max_by(|&a, &b| row[a].total_cmp(&row[b]))
        .unwrap_or(0)
}

impl Changes {
    /// Of one clip's viseme weights, `[frames, 13]`, from the first to the last of its phones.
    pub fn of(weights: ArrayView2<f32>, phones: &[PhoneLabel], seconds: f64) -> Result<Self> {
        let (from, to) = spoken::span(phones, seconds);
        let inside = |time: f64| from < time && time < to;
        let path: Vec<usize> = weights.outer_iter().map(likeliest).collect();
        let visemes = (1..path.len())
            .filter(|&t| path[t] != path[t - 1] && inside(f64::from(data::frame_time(t)) - 0.005))
            .count();
        let cues = cues::cues(weights, None, seconds).map_err(Error::other)?;
        Ok(Self {
            visemes,
            cues: cues.iter().skip(1).filter(|cue| inside(cue.start_s)).count(),
            seconds: (to - from).max(0.0),
        })
    }

    /// Takes in the changes and seconds of other clips.
    pub fn add(&mut self, other: Self) {
        self.visemes += other.visemes;
        self.cues += other.cues;
        self.seconds += other.seconds;
    }

    /// How often in a second of speech the likeliest viseme changes.
    pub fn visemes_per_second(&self) -> f64 {
        self.visemes as f64 / self.seconds.max(1e-9)
    }

    /// How often in a second of speech a new cue begins.
    pub fn cues_per_second(&self) -> f64 {
        self.cues as f64 / self.seconds.max(1e-9)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lipstream::phones::VISEMES;
    use ndarray::Array2;

    /// The viseme changes every 20 frames for 3 s; speech is labelled from 0.5 to 2.5 s.
    #[test]
    fn only_speech_is_counted() {
        let weights = Array2::from_shape_fn((296, VISEMES.len()), |(t, v)| {
            if v == [1, 9, 3][t / 20 % 3] { 1.0 } else { 0.0 }
        });
        let label = |phone: &str, start, end| PhoneLabel {
            phone: phone.into(),
            start,
            end,
        };
        let phones = [
            label("sil", 0.0, 0.5),
            label("b", 0.5, 1.5),
            label("ih", 1.5, 2.5),
            label("sil", 2.5, 2.9),
        ];
        // Borders between 0.5 and 2.5 s: those at frames 60, 80, … 240.
        let found = Changes::of(weights.view(), &phones, 2.975).unwrap();
        // Three times a wide mouth closes, with a shape in between.
        assert_eq!((found.visemes, found.cues), (10, 13));
        assert!((found.visemes_per_second() - 5.0).abs() < 1e-6);
        let found = Changes::of(weights.view(), &[], 2.975).unwrap();
        assert_eq!(found.visemes, 14);
        let mut twice = found;
        twice.add(found);
        assert!((twice.cues_per_second() - found.cues_per_second()).abs() < 1e-9);
    }
}
