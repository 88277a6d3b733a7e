//! How often the mouth's class changes in speech: the likeliest viseme of each frame, and the cues that an animator gets.
use ndarray::{ArrayView1, ArrayView2};

use crate::error::{Error, Result};
use crate::features::Clip;
use crate::train::data;
use lipstream::cues;

/// Changes counted over some seconds of speech.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Changes {
    visemes: usize,
    cues: usize,
    seconds: f64,
}

/// From the first to the last labelled phone that is no silence, in seconds; the whole clip without labels.
fn speech(clip: &Clip, seconds: f64) -> (f64, f64) {
    let labels = match (clip.phones.is_empty(), clip.words.is_empty()) {
        (true, true) => return (0.0, seconds),
        _ => data::timed_phones(clip),
    };
    let spoken = || labels.iter().filter(|l| l.phone != "sil" && l.phone != "sp");
    match (spoken().next(), spoken().next_back()) {
        (Some(first), Some(last)) => (f64::from(first.start), f64::from(last.end).min(seconds)),
        _ => (0.0, seconds),
    }
}

fn likeliest(row: ArrayView1<f32>) -> usize {
    (0..row.len())
        .max_by(|&a, &b| row[a].total_cmp(&row[b]))
        .unwrap_or(0)
}

impl Changes {
    /// Of one clip's viseme weights, `[frames, 13]`.
    pub fn of(weights: ArrayView2<f32>, clip: &Clip, seconds: f64) -> Result<Self> {
        let (from, to) = speech(clip, seconds);
        let inside = |time: f64| from < time && time < to;
        let path: Vec<usize> = weights.outer_iter().map(likeliest).collect();
        let visemes = (1..path.len())
            .filter(|&t| path[t] != path[t - 1] && inside(f64::from(data::frame_time(t)) - 0.005))
            .count();
        let cues = cues::cues(weights, seconds).map_err(Error::other)?;
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
    use crate::features::{PhonesFrom, Split, Word};
    use lipstream::phones::VISEMES;
    use ndarray::Array2;

    /// The viseme changes every 20 frames for 3 s; speech is labelled from 0.5 to 2.5 s.
    #[test]
    fn only_speech_is_counted() {
        let weights = Array2::from_shape_fn((296, VISEMES.len()), |(t, v)| {
            if v == [1, 9, 3][t / 20 % 3] { 1.0 } else { 0.0 }
        });
        let mut clip = Clip {
            id: "a".into(),
            speaker: "s".into(),
            split: Split::Test,
            audio_frames: 296,
            video_frames: 75,
            phones_from: PhonesFrom::Labels,
            video_hz: 25.0,
            words: vec![Word {
                text: "bin".into(),
                pronunciations: vec![vec!["b".into(), "ih".into(), "n".into()]],
                time: Some((0.5, 2.5)),
            }],
            phones: Vec::new(),
        };
        // Borders between 0.5 and 2.5 s: those at frames 60, 80, … 240.
        let found = Changes::of(weights.view(), &clip, 2.975).unwrap();
        assert_eq!((found.visemes, found.cues), (10, 10));
        assert!((found.visemes_per_second() - 5.0).abs() < 1e-6);
        clip.words.clear();
        let found = Changes::of(weights.view(), &clip, 2.975).unwrap();
        assert_eq!(found.visemes, 14);
        let mut twice = found;
        twice.add(found);
        assert!((twice.cues_per_second() - found.cues_per_second()).abs() < 1e-9);
    }
}
