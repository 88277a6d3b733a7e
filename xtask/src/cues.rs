//! How the shipped model's mouth shapes are timed, against phones whose times are known.
//!
//!     cargo xtask cues FOLDER
//!
//! FOLDER is one that `cargo xtask voices FOLDER TEXT` made, or any other with a folder for each voice and a label file beside each `.wav`. Printed for each
//! voice: p, b and m within 50 ms of which lips are shown closed; closed lips (A) that are not within 50 ms of one; changes a second; shapes shorter than
//! 70 ms, the last of a sound left out.
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use lipstream::cues::{self, Cue, Shape};
use lipstream::engine::{Engine, RunSettings};
use lipstream::time;
use lipstream_make::corpus::labels;
use lipstream_media::sound;

/// How far a shape may be from a phone that it is shown for, seconds.
const NEAR_S: f64 = 0.05;
/// Shapes shorter than this are counted, seconds; a hundred thousandth less, for borders are sums of floats.
const SHORT_S: f64 = 0.07 - 1e-5;

/// What was counted in one voice.
#[derive(Default)]
struct Counted {
    bilabials: usize,
    closed: usize,
    lips: usize,
    wrong: usize,
    changes: usize,
    short: usize,
    seconds: f64,
}

pub(crate) fn run(words: &[String]) -> Result<()> {
    let [folder] = words else { bail!("write FOLDER") };
    let engine = Engine::shipped();
    println!("| voice | p, b, m shown closed | closed elsewhere | changes a second | shapes under 70 ms |");
    println!("|---|---|---|---|---|");
    let mut voices: Vec<PathBuf> = files(Path::new(folder))?;
    voices.retain(|path| path.is_dir());
    for voice in voices {
        let mut counted = Counted::default();
        for wav in files(&voice)? {
            if wav.extension().is_some_and(|ending| ending == "wav") {
                let said = say(&engine, &wav, &mut counted);
                said.with_context(|| format!("cannot judge {}", wav.display()))?;
            }
        }
        if counted.bilabials == 0 || counted.lips == 0 {
            bail!("{}: nothing that closes lips", voice.display());
        }
        let share = |part: usize, of: usize| format!("{:.0} % of {of}", 100.0 * part as f64 / of as f64);
        println!(
            "| {} | {} | {} | {:.1} | {} |",
            voice.file_name().unwrap_or_default().to_string_lossy(),
            share(counted.closed, counted.bilabials),
            share(counted.wrong, counted.lips),
            counted.changes as f64 / counted.seconds,
            counted.short
        );
    }
    Ok(())
}

/// What lies in a folder, sorted.
fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let mut paths: Vec<PathBuf> = entries.map(|entry| Ok(entry?.path())).collect::<Result<_>>()?;
    paths.sort();
    Ok(paths)
}

fn say(engine: &Engine, wav: &Path, counted: &mut Counted) -> Result<()> {
    let samples = sound::read(wav)?.samples;
    let seconds = time::seconds(samples.len());
    let labels = labels::read(&[wav.with_extension("lab")], seconds)?;
    let heard = engine.convert(&samples, &RunSettings::default())?;
    let cues = cues::cues(heard.visemes.view(), seconds)?;
    let bilabials = labels
        .phones
        .iter()
        .filter(|p| ["p", "b", "m"].contains(&p.2.name()));
    let bilabials: Vec<(f64, f64)> = bilabials.map(|p| (p.0, p.1)).collect();
    count(&cues, &bilabials, counted);
    counted.seconds += seconds;
    Ok(())
}

fn count(cues: &[Cue], bilabials: &[(f64, f64)], counted: &mut Counted) {
    let near = |cue: &Cue, phone: &(f64, f64)| cue.start_s < phone.1 + NEAR_S && cue.end_s > phone.0 - NEAR_S;
    let is_closed = |cue: &&Cue| matches!(cue.shape, Shape::A | Shape::X);
    counted.bilabials += bilabials.len();
    counted.closed += bilabials
        .iter()
        .filter(|phone| cues.iter().filter(is_closed).any(|cue| near(cue, phone)))
        .count();
    let lips: Vec<&Cue> = cues.iter().filter(|cue| cue.shape == Shape::A).collect();
    counted.lips += lips.len();
    counted.wrong += lips
        .iter()
        .filter(|cue| !bilabials.iter().any(|phone| near(cue, phone)))
        .count();
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
        count(&cues, &[(0.26, 0.3), (0.4, 0.5)], &mut counted);
        assert_eq!((counted.closed, counted.bilabials), (1, 2));
        assert_eq!((counted.wrong, counted.lips), (1, 2));
        assert_eq!((counted.changes, counted.short), (4, 1));
    }
}
