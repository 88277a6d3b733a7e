//! How the shipped model's mouth shapes are timed, against phones whose times are known.
//!
//!     cargo xtask cues FOLDER [--texts]
//!
//! FOLDER is one that `cargo xtask voices FOLDER TEXT` made, TIMIT, or any other with a folder for each speaker and a `.lab` or `.phn` beside each `.wav`. With --texts
//! the words of the `.txt` beside each sound decide the times, as with `lipstream cues -d`. Printed for each speaker and for all:
//!
//! - p, b and m within 50 ms of which lips are shown closed (shapes A and X);
//! - median distance of the middle of their label from the middle of the nearest closed lips, of those within 50 ms of which there are any;
//! - closed lips (A) that are not within 50 ms of one, and how many a second they are;
//! - frames of speech that show the shape of their label's viseme;
//! - changes a second, shapes in between with them; shapes shorter than 70 ms, the last of a sound left out;
//! - with --texts, sounds whose text was not found to be said.
use std::ops::AddAssign;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use lipstream::cues::{self, Cue, Shape};
use lipstream::engine::{Engine, RunSettings};
use lipstream::opening::OpeningReader;
use lipstream::phones::Phone;
use lipstream::time;
use lipstream_make::align::dialog::Dialog;
use lipstream_make::corpus::labels;
use lipstream_media::sound;
use ndarray::Array2;

/// How far a shape may be from a phone that it is shown for, seconds.
const NEAR_S: f64 = 0.05;
/// Shapes shorter than this are counted, seconds; a hundred thousandth less, for borders are sums of floats.
const SHORT_S: f64 = 0.07 - 1e-5;

/// What was counted of one speaker.
#[derive(Default)]
struct Counted {
    bilabials: usize,
    closed: usize,
    /// Seconds between the middles of bilabials and of the lips that are closed for them.
    distances: Vec<f64>,
    lips: usize,
    wrong: usize,
    frames: usize,
    right: usize,
    changes: usize,
    short: usize,
    passed_over: usize,
    seconds: f64,
}

impl AddAssign<&Counted> for Counted {
    fn add_assign(&mut self, other: &Counted) {
        self.bilabials += other.bilabials;
        self.closed += other.closed;
        self.distances.extend(&other.distances);
        self.lips += other.lips;
        self.wrong += other.wrong;
        self.frames += other.frames;
        self.right += other.right;
        self.changes += other.changes;
        self.short += other.short;
        self.passed_over += other.passed_over;
        self.seconds += other.seconds;
    }
}

impl Counted {
    /// A row of the table.
    fn row(&self, name: &str) -> String {
        let share =
            |part: usize, of: usize| format!("{:.0} % of {of}", 100.0 * part as f64 / of.max(1) as f64);
        let mut distances = self.distances.clone();
        distances.sort_by(f64::total_cmp);
        let median = distances.get(distances.len() / 2);
        format!(
            "| {name} | {} | {} | {}, {:.2} | {:.0} % | {:.1} | {} | {} |",
            share(self.closed, self.bilabials),
            median.map_or("none".to_owned(), |s| format!("{:.0} ms", 1000.0 * s)),
            share(self.wrong, self.lips),
            self.wrong as f64 / self.seconds,
            100.0 * self.right as f64 / self.frames.max(1) as f64,
            self.changes as f64 / self.seconds,
            self.short,
            self.passed_over
        )
    }
}

/// What the shapes of a sound are made with.
struct Tools {
    engine: Engine,
    reader: OpeningReader,
    texts: bool,
}

pub(crate) fn run(words: &[String]) -> Result<()> {
    let (folder, texts) = match words {
        [folder] => (folder, false),
        [folder, texts] if texts == "--texts" => (folder, true),
        _ => bail!("write FOLDER, or FOLDER --texts"),
    };
    let tools = Tools {
        engine: Engine::shipped(),
        reader: OpeningReader::shipped()?.context("the shipped mouth cannot be measured")?,
        texts,
    };
    println!(
        "| speaker | p, b, m shown closed | median distance | closed elsewhere, a second | frames as labelled | changes a second | shapes under 70 ms | texts passed over |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let mut speakers: Vec<PathBuf> = files(Path::new(folder))?;
    speakers.retain(|path| path.is_dir());
    let mut all = Counted::default();
    for speaker in &speakers {
        let mut counted = Counted::default();
        for wav in files(speaker)? {
            if wav.extension().is_some_and(|ending| ending == "wav") {
                let said = tools.say(&wav, &mut counted);
                said.with_context(|| format!("cannot judge {}", wav.display()))?;
            }
        }
        if counted.bilabials == 0 {
            bail!("{}: nothing that closes lips", speaker.display());
        }
        println!(
            "{}",
            counted.row(&speaker.file_name().unwrap_or_default().to_string_lossy())
        );
        all += &counted;
    }
    if all.bilabials == 0 {
        bail!("{folder} has no folder of a speaker");
    }
    println!("{}", all.row(&format!("all of {}", speakers.len())));
    Ok(())
}

/// What lies in a folder, sorted.
fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let mut paths: Vec<PathBuf> = entries.map(|entry| Ok(entry?.path())).collect::<Result<_>>()?;
    paths.sort();
    Ok(paths)
}

impl Tools {
    fn say(&self, wav: &Path, counted: &mut Counted) -> Result<()> {
        let samples = sound::read(wav)?.samples;
        let seconds = time::seconds(samples.len());
        let beside = ["lab", "phn"].map(|ending| wav.with_extension(ending));
        let beside = beside.iter().find(|path| path.exists());
        let labelled = labels::read(&[beside.context("no .lab or .phn lies beside it")?], seconds)?;
        let told = match self.texts {
            true => said(wav, &samples, seconds)?,
            false => None,
        };
        let cues = match &told {
            Some(visemes) => cues::cues(visemes.view(), None, seconds)?,
            None => {
                let heard = self.engine.convert(&samples, &RunSettings::default())?;
                cues::cues(heard.visemes.view(), Some(&heard.gaps(&self.reader)), seconds)?
            }
        };
        counted.passed_over += usize::from(self.texts && told.is_none());
        count(&cues, &labelled.phones, counted);
        counted.seconds += seconds;
        Ok(())
    }
}

/// Viseme weights by the text beside a sound; none where it does not fit.
fn said(wav: &Path, samples: &[i16], seconds: f64) -> Result<Option<Array2<f32>>> {
    let text = wav.with_extension("txt");
    let words = labels::read(std::slice::from_ref(&text), seconds)?.words;
    let dialog = Dialog::of(&words, &text.display().to_string())?;
    let rows = match dialog.visemes(samples)? {
        Ok(rows) => rows,
        Err(_) => return Ok(None),
    };
    Ok(Some(Array2::from_shape_fn(
        (rows.len(), rows[0].len()),
        |(t, v)| rows[t][v],
    )))
}

fn count(cues: &[Cue], phones: &[(f64, f64, Phone)], counted: &mut Counted) {
    let bilabials = phones.iter().filter(|p| ["p", "b", "m"].contains(&p.2.name()));
    let bilabials: Vec<(f64, f64)> = bilabials.map(|p| (p.0, p.1)).collect();
    let near = |cue: &Cue, phone: &(f64, f64)| cue.start_s < phone.1 + NEAR_S && cue.end_s > phone.0 - NEAR_S;
    let is_closed = |cue: &&Cue| matches!(cue.shape, Shape::A | Shape::X);
    counted.bilabials += bilabials.len();
    counted.closed += bilabials
        .iter()
        .filter(|phone| cues.iter().filter(is_closed).any(|cue| near(cue, phone)))
        .count();
    let lips: Vec<&Cue> = cues.iter().filter(|cue| cue.shape == Shape::A).collect();
    for phone in &bilabials {
        let closed = lips.iter().filter(|cue| near(cue, phone));
        let apart = |cue: &&Cue| 0.5 * (cue.start_s + cue.end_s - phone.0 - phone.1).abs();
        counted.distances.extend(closed.map(apart).min_by(f64::total_cmp));
    }
    counted.lips += lips.len();
    counted.wrong += lips
        .iter()
        .filter(|cue| !bilabials.iter().any(|phone| near(cue, phone)))
        .count();
    for (start, end, phone) in phones.iter().filter(|p| !p.2.is_pause()) {
        for cue in cues {
            // Frames are a hundredth of a second; a border's share of one is rounded.
            let both = cue.end_s.min(*end) - cue.start_s.max(*start);
            let frames = (100.0 * both.max(0.0)).round() as usize;
            counted.frames += frames;
            counted.right += if cue.shape == Shape::of(phone.viseme()) {
                frames
            } else {
                0
            };
        }
    }
    counted.changes += cues.len().saturating_sub(1);
    let all_but_the_last = &cues[..cues.len().saturating_sub(1)];
    counted.short += all_but_the_last
        .iter()
        .filter(|cue| cue.end_s - cue.start_s < SHORT_S)
        .count();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn closures_are_told_from_other_shapes() {
        let cue = |start_s, end_s, shape| Cue {
            start_s,
            end_s,
            shape,
        };
        let cues = [
            cue(0.0, 0.2, Shape::X),
            cue(0.2, 0.25, Shape::A),
            cue(0.25, 0.6, Shape::D),
            cue(0.6, 0.7, Shape::A),
            cue(0.7, 0.71, Shape::D),
        ];
        let mut counted = Counted::default();
        let phone = |from, to, name| (from, to, Phone::from_name(name).unwrap());
        let phones = [phone(0.26, 0.3, "p"), phone(0.3, 0.4, "aa"), phone(0.4, 0.5, "m")];
        count(&cues, &phones, &mut counted);
        assert_eq!((counted.closed, counted.bilabials), (1, 2));
        assert_eq!((counted.wrong, counted.lips), (1, 2));
        assert_eq!((counted.changes, counted.short), (4, 1));
        assert_eq!((counted.right, counted.frames), (10, 24));
        assert_eq!(counted.distances.len(), 1);
        assert!((counted.distances[0] - 0.055).abs() < 1e-9);
    }
}
