//! The paper's EM feedback, live: one sweep over the lag window with every incoming frame, at several exponents of the mouth.
//!
//!     cargo run --release -p lipstream --example feedback -- FOLDER MODEL.safetensors [train|val|test] [LAG]
//!
//! MODEL speaks by means (`lipstream train --system ph-vi-chmm`, …). An exponent of 0 is no feedback.
use std::path::PathBuf;

use anyhow::{Result, bail};
use lipstream::evaluate::metrics::Score;
use lipstream::evaluate::truths;
use lipstream::features::{FeatureFolder, Split};
use lipstream::hmm::Hmm;
use lipstream::hmm::convert::smooth;
use lipstream::hmm::inversion::Inverter;
use lipstream::model::{EmSettings, Model};
use rayon::prelude::*;

fn main() -> Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [folder, model, rest @ ..] = words.as_slice() else {
        bail!("write FOLDER MODEL.safetensors [SPLIT] [LAG]")
    };
    let split = Split::named(rest.first().map_or("val", String::as_str))?;
    let lag: usize = rest.get(1).map_or(Ok(4), |word| word.parse())?;
    let folder = FeatureFolder::open(&PathBuf::from(folder))?;
    let model = Model::read(&PathBuf::from(model))?;
    let clips = truths(&folder, split)?;
    let inverter = Inverter::new(Hmm::of_model(&model));
    println!("| exponent of the mouth | AMSE | ACC |\n|---|---|---|");
    for visual_exponent in [0.0, 0.01, 0.03, 0.1, 0.3, 1.0] {
        let settings = EmSettings {
            visual_exponent,
            ..model.conversion
        };
        let parts: Vec<Score> = clips
            .par_iter()
            .map(|clip| {
                let said = inverter.convert_live(&clip.audio, &settings, lag)?;
                Ok(Score::of(&clip.visual, &smooth(&said)))
            })
            .collect::<Result<_>>()?;
        let mut score = Score::new(folder.manifest.visual_size);
        parts.iter().for_each(|part| score.merge(part));
        println!("| {visual_exponent} | {:.1} | {:.4} |", score.amse(), score.acc());
    }
    Ok(())
}
