//! A corpus of synthetic speech with exact phone times: several voices of `flite` say words in any order, slowly and fast.
//!
//!     cargo xtask voices FOLDER [COUNT]
//!     cargo xtask voices FOLDER TEXT
//!
//! Each of flite's built-in voices gets a folder, the training speakers of `lipstream prepare FOLDER --audio-only --all-train`; COUNT utterances (180) each, as
//! `.wav` with an HTK `.lab` beside it. Words are drawn from the sentences of `lipstream prompts`, which hold every phone of English, so that no grammar
//! can be learnt; the same COUNT gives the same words. With a TEXT file its lines are said as they are, one after another: other words for a test.
//! `flite` is Debian's package of that name.
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result, bail, ensure};
use lipstream_make::corpus::prompts::PROMPTS;
use lipstream_media::files;
use rand::seq::IndexedRandom as _;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Voices in Debian's flite, at 16 kHz: three men and a woman.
const VOICES: [&str; 4] = ["kal16", "awb", "rms", "slt"];
/// Words of an utterance.
const WORDS: std::ops::RangeInclusive<usize> = 5..=12;
/// How much slower than usual.
const STRETCH: std::ops::Range<f32> = 0.75..1.2;

pub(crate) fn run(words: &[String]) -> Result<()> {
    let (folder, said) = match words {
        [folder] => (folder, drawn(180)),
        [folder, count] if count.chars().all(|c| c.is_ascii_digit()) => (
            folder,
            drawn(count.parse().with_context(|| format!("{count} is too much"))?),
        ),
        [folder, text] => {
            let lines = std::fs::read_to_string(text).with_context(|| format!("cannot read {text}"))?;
            let lines: Vec<String> = lines.lines().map(str::to_owned).collect();
            (folder, Box::new(move |_: &mut Pcg64| lines.clone()) as Said)
        }
        _ => bail!("write FOLDER [COUNT], or FOLDER TEXT"),
    };
    let mut rng = Pcg64::seed_from_u64(1);
    for voice in VOICES {
        let to = PathBuf::from(folder).join(voice);
        std::fs::create_dir_all(&to).with_context(|| format!("cannot make {}", to.display()))?;
        let lines = said(&mut rng);
        for (n, line) in lines.iter().enumerate() {
            let stem = to.join(format!("{voice}-{n:04}"));
            say(&stem, voice, line, rng.random_range(STRETCH))?;
        }
        eprintln!("{} utterances of {voice}", lines.len());
    }
    Ok(())
}

/// What a voice is to say.
type Said = Box<dyn Fn(&mut Pcg64) -> Vec<String>>;

/// So many lines of words in any order.
fn drawn(count: usize) -> Said {
    let pool: Vec<String> = PROMPTS
        .iter()
        .flat_map(|sentence| sentence.split_whitespace())
        .map(|word| word.trim_matches(|c: char| !c.is_alphanumeric()).to_lowercase())
        .collect();
    Box::new(move |rng| {
        let line = |rng: &mut Pcg64| {
            let length = rng.random_range(WORDS);
            let words: Vec<&str> = (0..length)
                .filter_map(|_| pool.choose(rng).map(String::as_str))
                .collect();
            words.join(" ")
        };
        (0..count).map(|_| line(rng)).collect()
    })
}

/// Writes `STEM.wav` and `STEM.lab`.
fn say(stem: &Path, voice: &str, text: &str, stretch: f32) -> Result<()> {
    let wav = stem.with_extension("wav");
    let flite = Command::new("flite")
        .args([
            "-voice",
            voice,
            "--setf",
            &format!("duration_stretch={stretch:.2}"),
            "-psdur",
            "-t",
            text,
            "-o",
        ])
        .arg(&wav)
        .output()
        .context("flite cannot be run; it is in Debian's package flite")?;
    ensure!(
        flite.status.success(),
        "flite failed: {}",
        String::from_utf8_lossy(&flite.stderr).trim()
    );
    let labels = labels(&String::from_utf8_lossy(&flite.stdout))?;
    Ok(files::write_bytes(
        &stem.with_extension("lab"),
        labels.as_bytes(),
    )?)
}

/// HTK's lines of flite's `PHONE:END`, where END is in seconds.
fn labels(said: &str) -> Result<String> {
    let (mut lines, mut from) = (String::new(), 0.0f64);
    for part in said.split_whitespace() {
        let (phone, end) = part
            .rsplit_once(':')
            .with_context(|| format!("flite says {part:?}, where a phone and its end belong"))?;
        let end: f64 = end
            .parse()
            .with_context(|| format!("flite says that {phone} ends at {end:?}"))?;
        ensure!(end >= from, "flite says that {phone} ends before it begins");
        let phone = if phone == "pau" { "sil" } else { phone };
        let ticks = |seconds: f64| (seconds * 1e7).round() as u64;
        if end > from {
            lines += &format!("{} {} {phone}\n", ticks(from), ticks(end));
        }
        from = end;
    }
    ensure!(!lines.is_empty(), "flite said nothing");
    Ok(lines)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flites_ends_become_beginnings_and_ends() {
        let lines = labels("pau:0.200 b:0.250 iy:0.400 pau:0.400\n").unwrap();
        assert_eq!(lines, "0 2000000 sil\n2000000 2500000 b\n2500000 4000000 iy\n");
        assert!(labels("b:0.2 iy:0.1").is_err() && labels("nonsense").is_err() && labels("").is_err());
    }
}
