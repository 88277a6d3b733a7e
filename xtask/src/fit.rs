//! Whether texts are found to be what is said, and by what margin: `fit FOLDER [SPLIT]`, a feature folder whose clips have words.
//!
//! Every clip is judged with its own text and with that of the clip behind it (`host/make/src/align/fit.rs`); printed are quantiles of how much worse than
//! what is heard the worst word and all words explain the sound, in nats a frame of 5 ms.
use std::path::PathBuf;

use anyhow::{Result, bail};
use lipstream_make::align::Aligner;
use lipstream_make::align::audio_hmm::AudioHmm;
use lipstream_make::align::fit::Fit;
use lipstream_make::align::recognise::Recogniser;
use lipstream_make::features::{FeatureFolder, Split};
use lipstream_media::sound;

pub(crate) fn run(words: &[String]) -> Result<()> {
    let (folder, split) = match words {
        [folder] => (folder, Split::Val),
        [folder, split] => (folder, Split::named(split)?),
        _ => bail!("write FOLDER [SPLIT]"),
    };
    let folder = FeatureFolder::open(&PathBuf::from(folder))?;
    let (aligner, recogniser) = (Aligner::new(AudioHmm::shipped()?), Recogniser::shipped()?);
    let clips: Vec<_> = folder
        .manifest
        .clips
        .iter()
        .filter(|clip| clip.split == split && !clip.words.is_empty())
        .collect();
    println!(
        "| text | found to be what is said | worst word: median, 90 %, most | all words: median, 90 %, most |"
    );
    println!("|---|---|---|---|");
    let mut of_texts = Vec::new();
    for (name, step) in [("right", 0), ("another clip's", 1)] {
        let mut fits = Vec::new();
        for (n, clip) in clips.iter().enumerate() {
            let samples = sound::read(&folder.wav_path(&clip.id))?.samples;
            let text = &clips[(n + step) % clips.len()].words;
            let heard = recogniser.recognise(&samples)?;
            // A text that no path goes through fits less than any other.
            if let Ok(aligned) = aligner.words(&samples, text) {
                fits.extend(Fit::of(&aligned, &heard));
            }
        }
        let said = fits.iter().filter(|fit| fit.says()).count();
        let row = |of: fn(&Fit) -> f64| {
            let mut values: Vec<f64> = fits.iter().map(of).collect();
            values.sort_by(f64::total_cmp);
            let at = |share: f64| {
                values
                    .get(((values.len() - 1) as f64 * share) as usize)
                    .copied()
                    .unwrap_or(f64::NAN)
            };
            format!("{:.2}, {:.2}, {:.2}", at(0.5), at(0.9), at(1.0))
        };
        if fits.is_empty() {
            bail!("no clip of this split has words that can be aligned");
        }
        println!(
            "| {name} | {said} of {} | {} | {} |",
            clips.len(),
            row(|fit| fit.worst),
            row(|fit| fit.all)
        );
        of_texts.push(fits);
    }
    println!("\n| worst word at most | all words at most | right texts taken | others' |\n|---|---|---|---|");
    for worst in [6.0, 8.0, 10.0, 12.0, 14.0, 16.0] {
        for all in [2.5, 3.5, 4.5, 5.5, 6.5] {
            let taken = |fits: &[Fit]| {
                let under = |fit: &&Fit| fit.worst <= worst && fit.all <= all;
                fits.iter().filter(under).count()
            };
            println!(
                "| {worst} | {all} | {} | {} |",
                taken(&of_texts[0]),
                taken(&of_texts[1])
            );
        }
    }
    Ok(())
}
