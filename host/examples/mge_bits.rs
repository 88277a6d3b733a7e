//! What tables of few bits cost a model trained by minimum generation error, weights only, in floats; and what a cold
//! start in mid-clip costs.
//!
//!     cargo run --release -p lipstream --example mge_bits -- FOLDER MGE.safetensors [train|val|test]
use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::ValueEnum;
use lipstream::evaluate::metrics::Score;
use lipstream::evaluate::truths;
use lipstream::features::{FeatureFolder, Split};
use lipstream::mge::live;
use lipstream::mge::model::MgeModel;
use lipstream::mge::rounding::rounded;
use ndarray::s;

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, model, rest @ ..] = arguments.as_slice() else {
        bail!("give a feature folder and a model trained with --train mge")
    };
    let name = rest.first().map_or("test", String::as_str);
    let Ok(split) = Split::from_str(name, false) else {
        bail!("no split is called {name:?}: train, val, test")
    };
    let folder = FeatureFolder::open(&PathBuf::from(folder))?;
    let model = MgeModel::read(&PathBuf::from(model))?;
    let clips = truths(&folder, split)?;
    // Frames from `from` on, of a stream that began there or at the clip's beginning.
    let score = |model: &MgeModel, from: usize, cold: bool| -> Score {
        let mut score = Score::new(model.deviation.len());
        for clip in clips.iter().filter(|c| c.audio.nrows() > from) {
            let begin = if cold { from } else { 0 };
            let said = live::convert(model, clip.audio.slice(s![begin.., ..])).parameters;
            score.add(
                &clip.visual.slice(s![from.., ..]).to_owned(),
                &said.slice(s![from - begin.., ..]).to_owned(),
            );
        }
        score
    };
    let show = |name: &str, score: Score| {
        println!("{name}: AMSE {:.1}, ACC {:.4}", score.amse(), score.acc());
    };
    show("floats", score(&model, 0, false));
    for bits in [8, 7, 6, 5, 4] {
        show(&format!("{bits} bits"), score(&rounded(&model, bits), 0, false));
    }
    for from in [50, 100, 150] {
        show(
            &format!("from frame {from}, whole clip heard"),
            score(&model, from, false),
        );
        show(
            &format!("from frame {from}, started there"),
            score(&model, from, true),
        );
    }
    Ok(())
}
