//! The paper's EM feedback, live: one sweep over the lag window with every incoming frame, at several exponents of the mouth, in
//! floats and as the device does it, beside the model's own maps.
//!
//!     cargo xtask feedback FOLDER MODEL.safetensors [train|val|test] [LAG]
//!
//! MODEL is likelihood-trained (`lipstream train`). An exponent of 0 is EM without feedback.
use std::path::PathBuf;

use anyhow::{Result, bail};
use lipstream::engine::{Engine, FloatModel, RunSettings};
use lipstream::export::{ExportSettings, export};
use lipstream::kinds::likelihood::Model;
use lipstream_make::evaluate::metrics::Score;
use lipstream_make::evaluate::truths;
use lipstream_make::features::{FeatureFolder, Split};
use lipstream_media::sound;
use rayon::prelude::*;

pub(crate) fn run(words: &[String]) -> Result<()> {
    let [folder, model, rest @ ..] = words else {
        bail!("write FOLDER MODEL.safetensors [SPLIT] [LAG]")
    };
    let split = Split::named(rest.first().map_or("val", String::as_str))?;
    let lag: u16 = rest.get(1).map_or(Ok(4), |word| word.parse())?;
    let folder = FeatureFolder::open(&PathBuf::from(folder))?;
    let model = Model::read(&PathBuf::from(model))?;
    let clips = truths(&folder, split)?;
    let with = ExportSettings {
        visual_densities: true,
        ..ExportSettings::of(&model)
    };
    let device = Engine::fixed(export(&model, &with)?.bytes)?;
    let floats = Engine::from(FloatModel::Likelihood(Box::new(model)));
    let score = |engine: &Engine, feedback: Option<f64>| -> Result<Score> {
        let run = RunSettings {
            lag: Some(lag),
            feedback,
            ..RunSettings::default()
        };
        let parts: Vec<Score> = clips
            .par_iter()
            .map(|clip| {
                let sound = sound::read(&folder.wav_path(&clip.clip.id))?;
                let said = engine.convert(&sound.samples, &run)?;
                Ok(Score::of(&clip.visual, &said.parameters))
            })
            .collect::<Result<_>>()?;
        let mut score = Score::new(folder.manifest.visual_size);
        parts.iter().for_each(|part| score.merge(part));
        Ok(score)
    };
    println!("| mouth by | AMSE, ACC in floats | on the device |\n|---|---|---|");
    let exponents = [0.0, 0.01, 0.03, 0.1, 0.3, 1.0].map(Some);
    for feedback in [None].into_iter().chain(exponents) {
        let said = |score: Score| format!("{:.1} / {:.4}", score.amse(), score.acc());
        let name = feedback.map_or("maps".to_owned(), |e| format!("EM, exponent {e}"));
        let (float, fixed) = (score(&floats, feedback)?, score(&device, feedback)?);
        println!("| {name} | {} | {} |", said(float), said(fixed));
    }
    Ok(())
}
