//! Phone recognition under several settings, against labels: which acoustic scale and language weight to take, and what a phone brings.
//!
//!     cargo xtask recognition FOLDER [train|val|test] [LABELS.tsv] [MODEL.safetensors]
//!
//! FOLDER is a feature folder; the labels are its own, or those of a table (`lipstream align --against`). Without a model the shipped one listens.
use std::path::Path;

use anyhow::{Context as _, Result, bail};
use lipstream_make::align::judge::Judgement;
use lipstream_make::align::recognise::RecognitionSettings;
use lipstream_make::align::{AudioHmm, Recogniser};
use lipstream_make::corpus::labels;
use lipstream_make::features::{Clip, FeatureFolder, Split};
use lipstream_media::sound;
use rayon::prelude::*;

const SCALES: [f64; 4] = [0.1, 0.2, 0.4, 0.6];
const WEIGHTS: [f32; 3] = [0.5, 1.0, 2.0];
const INSERTIONS: [f32; 4] = [-2.0, 0.0, 2.0, 4.0];

pub(crate) fn run(words: &[String]) -> Result<()> {
    let Some((folder, rest)) = words.split_first() else {
        bail!("give a feature folder");
    };
    let folder = FeatureFolder::open(Path::new(folder))?;
    let split = Split::named(rest.first().map_or("val", String::as_str))?;
    let ending = |ending: &str| rest.iter().find(|w| w.ends_with(ending)).map(Path::new);
    let table = ending(".tsv").map(labels::read_table).transpose()?;
    let hmm = match ending(".safetensors") {
        Some(path) => AudioHmm::read(path)?,
        None => AudioHmm::shipped()?,
    };
    let of = |clip: &Clip| match &table {
        Some(table) => table.get(&clip.id).cloned().unwrap_or_default(),
        None => clip.phones.clone(),
    };
    let clips: Vec<_> = folder
        .split(split)
        .map(|clip| (clip, of(clip)))
        .filter(|(_, labels)| !labels.is_empty())
        .collect();
    let sounds: Vec<Vec<i16>> = clips
        .iter()
        .map(|(clip, _)| Ok(sound::read(&folder.wav_path(&clip.id))?.samples))
        .collect::<Result<_>>()?;
    println!(
        "| scale | language | insertion | errors | missing | too many | frames in speech: phone | viseme |\n|---|---|---|---|---|---|---|---|"
    );
    for acoustic_scale in SCALES {
        for language_weight in WEIGHTS {
            for insertion in INSERTIONS {
                let settings = RecognitionSettings {
                    acoustic_scale,
                    language_weight,
                    insertion,
                };
                let recogniser = Recogniser::new(hmm.clone(), settings);
                let heard = sounds.par_iter().map(|samples| recogniser.recognise(samples));
                let heard: Vec<_> = heard.collect::<Result<_, _>>()?;
                let mut judgement = Judgement::default();
                for ((_, labels), found) in clips.iter().zip(&heard) {
                    judgement.add(labels, found);
                }
                let j = judgement.summary().context("no clip of this split has labels")?;
                println!(
                    "| {acoustic_scale} | {language_weight} | {insertion} | {:.1} % | {:.1} % | {:.1} % | {:.1} % | {:.1} % |",
                    100.0 * j.error_rate,
                    100.0 * j.deleted,
                    100.0 * j.inserted,
                    100.0 * j.speech.phone,
                    100.0 * j.speech.viseme
                );
            }
        }
    }
    Ok(())
}
