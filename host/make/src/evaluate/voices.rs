//! How well a model's mouth follows each speaker's sound where nobody was filmed: whether the lips close at p, b, m and nowhere else, and
//! whether the viseme is the label's, against labelled phones.
//!
//! Speech that was recorded or synthesised without a picture (TIMIT, `flite`) says this much of a mouth: what everybody sees first is a mouth that
//! stays open at a p. Closed is a lip gap of 0 as [`OpeningReader`] reads it off the model's mouth: 5 % of its width ([`lipstream::lips`]). A mouth that
//! is always closed closes at every p, so that a table shows beside that how often lips are closed elsewhere in speech.
use std::collections::BTreeMap;
use std::ops::AddAssign;

use lipstream::engine::{Engine, RunSettings};
use lipstream::opening::OpeningReader;
use lipstream::phones::Phone;
use lipstream::progress::{Progress, Steps};
use lipstream_media::sound;
use rayon::prelude::*;
use serde::Serialize;

use super::changes::likeliest;
use super::closure::bilabials;
use crate::error::{Error, Result, bail};
use crate::features::{Clip, FeatureFolder, PhonesFrom, Split};
use crate::train::data::frame_time;

/// Lips that meet so near the label do so for it: what a listener who watches forgives.
const MARGIN_S: f32 = 0.05;

/// What was counted of one speaker, or of several.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Counts {
    /// Clips.
    pub clips: usize,
    /// Labelled p, b, m.
    pub bilabials: usize,
    /// Those at which the lips are shown closed within 50 ms of the label.
    pub closed: usize,
    /// Frames inside the labels of p, b, m, and those of them in which the lips are shown closed.
    pub inside: usize,
    /// See `inside`.
    pub inside_closed: usize,
    /// Frames of speech further than 50 ms from every p, b, m, and those of them in which the lips are shown closed.
    pub elsewhere: usize,
    /// See `elsewhere`.
    pub elsewhere_closed: usize,
    /// Frames of speech, and those of them whose likeliest viseme is the label's.
    pub speech: usize,
    /// See `speech`.
    pub right: usize,
}

/// One speaker.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Voice {
    /// What the folder calls the speaker.
    pub speaker: String,
    /// What was counted.
    pub counts: Counts,
}

/// How well all are followed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Voices {
    /// Every speaker, by name.
    pub voices: Vec<Voice>,
    /// Clips without phones that somebody labelled or a transcript told: they are not counted.
    pub left_out: usize,
}

/// Measures `engine`, whose mouth `reader` reads, on the clips of `folder` that are of `split`, or on all of them.
///
/// # Errors
///
/// That no clip has phones, or that a sound cannot be read.
pub fn voices(
    folder: &FeatureFolder,
    split: Option<Split>,
    engine: &Engine,
    reader: &OpeningReader,
    progress: &dyn Progress,
) -> Result<Voices> {
    let asked = |clip: &&Clip| split.is_none_or(|split| clip.split == split);
    let (told, untold): (Vec<&Clip>, Vec<&Clip>) = folder
        .manifest
        .clips
        .iter()
        .filter(asked)
        .partition(|clip| clip.phones_from != PhonesFrom::Recognised && !clip.phones.is_empty());
    if told.is_empty() {
        bail!(
            Data,
            "no clip of {}{} has phones that a label or a transcript tells",
            folder.name(),
            split.map_or(String::new(), |split| format!("'s split {}", split.name()))
        );
    }
    let steps = Steps::begin(progress, "clips", told.len());
    let counted: Vec<(String, Counts)> = told
        .into_par_iter()
        .map(|clip| {
            let counts = hear(folder, clip, engine, reader)?;
            steps.made();
            Ok((clip.speaker.clone(), counts))
        })
        .collect::<Result<_>>()?;
    let mut of = BTreeMap::<String, Counts>::new();
    for (speaker, counts) in counted {
        *of.entry(speaker).or_default() += counts;
    }
    Ok(Voices {
        voices: of
            .into_iter()
            .map(|(speaker, counts)| Voice { speaker, counts })
            .collect(),
        left_out: untold.len(),
    })
}

fn hear(folder: &FeatureFolder, clip: &Clip, engine: &Engine, reader: &OpeningReader) -> Result<Counts> {
    let heard = sound::read(&folder.wav_path(&clip.id)).map_err(Error::other)?;
    let said = engine
        .convert(&heard.samples, &RunSettings::default())
        .map_err(Error::other)?;
    let closed: Vec<bool> = said
        .parameters
        .outer_iter()
        .map(|row| reader.read(&row.to_vec()).gap <= 0.0)
        .collect();
    let visemes: Vec<usize> = said.visemes.outer_iter().map(likeliest).collect();
    Ok(count(clip, &closed, &visemes))
}

/// Counts one clip of which is said in every frame whether the lips are closed, and which viseme is the likeliest.
fn count(clip: &Clip, closed: &[bool], visemes: &[usize]) -> Counts {
    let frames = closed.len().min(visemes.len());
    let bilabial = Phone::from_name("p").map(Phone::viseme);
    let mut near = vec![false; frames];
    let mut counts = Counts {
        clips: 1,
        ..Counts::default()
    };
    for span in bilabials(&clip.phones, clip.audio_frames, MARGIN_S) {
        let span = span.start.min(frames)..span.end.min(frames);
        near[span.clone()].fill(true);
        counts.bilabials += 1;
        counts.closed += usize::from(closed[span].contains(&true));
    }
    let mut labels = clip.phones.iter().peekable();
    for t in 0..frames {
        let time = frame_time(t);
        while labels.next_if(|label| label.end <= time).is_some() {}
        let Some(phone) = labels
            .peek()
            .filter(|label| label.start <= time)
            .and_then(|label| Phone::from_name(&label.phone))
            .filter(|phone| !phone.is_pause())
        else {
            continue;
        };
        counts.speech += 1;
        counts.right += usize::from(visemes[t] == usize::from(phone.viseme().0));
        if Some(phone.viseme()) == bilabial {
            counts.inside += 1;
            counts.inside_closed += usize::from(closed[t]);
        }
        if !near[t] {
            counts.elsewhere += 1;
            counts.elsewhere_closed += usize::from(closed[t]);
        }
    }
    counts
}

impl AddAssign for Counts {
    fn add_assign(&mut self, other: Self) {
        self.clips += other.clips;
        self.bilabials += other.bilabials;
        self.closed += other.closed;
        self.inside += other.inside;
        self.inside_closed += other.inside_closed;
        self.elsewhere += other.elsewhere;
        self.elsewhere_closed += other.elsewhere_closed;
        self.speech += other.speech;
        self.right += other.right;
    }
}

fn share(part: usize, whole: usize) -> f64 {
    part as f64 / whole.max(1) as f64
}

impl Counts {
    /// Share of p, b, m at which the lips are shown closed.
    pub fn closed_share(&self) -> f64 {
        share(self.closed, self.bilabials)
    }

    /// Share of the frames inside p, b, m in which they are.
    pub fn inside_share(&self) -> f64 {
        share(self.inside_closed, self.inside)
    }

    /// Share of the other frames of speech in which they are.
    pub fn elsewhere_share(&self) -> f64 {
        share(self.elsewhere_closed, self.elsewhere)
    }

    /// Share of the frames of speech with the right viseme.
    pub fn right_share(&self) -> f64 {
        share(self.right, self.speech)
    }
}

impl Voices {
    /// All speakers' counts together.
    pub fn all(&self) -> Counts {
        let mut all = Counts::default();
        self.voices.iter().for_each(|voice| all += voice.counts);
        all
    }

    /// The table, in Markdown.
    pub fn markdown(&self) -> String {
        let mut out = String::from(
            "| speaker | clips | p b m | shown closed | of their frames | elsewhere in speech | visemes right |\n|---|---|---|---|---|---|---|\n",
        );
        let mut row = |name: &str, of: &Counts, bold: &str| {
            out += &format!(
                "| {name} | {} | {} | {bold}{:.1} %{bold} | {:.1} % | {:.1} % | {:.1} % |\n",
                of.clips,
                of.bilabials,
                100.0 * of.closed_share(),
                100.0 * of.inside_share(),
                100.0 * of.elsewhere_share(),
                100.0 * of.right_share(),
            );
        };
        for voice in &self.voices {
            row(&voice.speaker, &voice.counts, "");
        }
        row(&format!("all of {}", self.voices.len()), &self.all(), "**");
        if self.left_out > 0 {
            out += &format!(
                "\n{} clips are not counted: no label or transcript tells their phones.\n",
                self.left_out
            );
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::PhoneLabel;

    fn clip(phones: &[(&str, f32, f32)]) -> Clip {
        let phones = phones.iter().map(|&(phone, start, end)| PhoneLabel {
            phone: phone.into(),
            start,
            end,
        });
        Clip {
            id: "c".into(),
            speaker: "s".into(),
            split: Split::Test,
            audio_frames: 60,
            video_frames: 0,
            video_hz: 0.0,
            words: Vec::new(),
            phones: phones.collect(),
            phones_from: PhonesFrom::Labels,
        }
    }

    #[test]
    fn counted_by_hand() {
        // Frame t is centred on 0.0125 + t/100 s: p has frames 9 to 18, its span 4 to 23; aa has 19 to 38; b has 39 to 48.
        let clip = clip(&[
            ("sil", 0.0, 0.1),
            ("p", 0.1, 0.2),
            ("aa", 0.2, 0.4),
            ("b", 0.4, 0.5),
            ("sil", 0.5, 0.6),
        ]);
        let mut closed = vec![false; 60];
        closed[..3].fill(true); // in silence: counts nowhere
        closed[5] = true; // near p
        closed[28..30].fill(true); // elsewhere
        let aa = usize::from(Phone::from_name("aa").unwrap().viseme().0);
        let counts = count(&clip, &closed, &[aa; 60]);
        assert_eq!((counts.bilabials, counts.closed), (2, 1));
        assert_eq!((counts.inside, counts.inside_closed), (20, 0));
        assert_eq!((counts.elsewhere, counts.elsewhere_closed), (10, 2));
        assert_eq!((counts.speech, counts.right), (40, 20));
        // What is said may end early.
        let short = count(&clip, &closed[..10], &[aa; 10]);
        assert_eq!((short.bilabials, short.closed, short.speech), (2, 1, 1));
    }

    #[test]
    fn a_table_has_every_speaker_and_all() {
        let counts = Counts {
            clips: 2,
            bilabials: 4,
            closed: 3,
            speech: 10,
            right: 5,
            ..Counts::default()
        };
        let voice = |speaker: &str| Voice {
            speaker: speaker.into(),
            counts,
        };
        let report = Voices {
            voices: vec![voice("a"), voice("b")],
            left_out: 1,
        };
        let table = report.markdown();
        assert!(
            table.contains("| a | 2 | 4 | 75.0 % | 0.0 % | 0.0 % | 50.0 % |"),
            "{table}"
        );
        assert!(
            table.contains("| all of 2 | 4 | 8 | **75.0 %**") && table.contains("1 clips are not"),
            "{table}"
        );
    }
}
