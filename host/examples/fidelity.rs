//! What the device costs a model trained by minimum generation error, step by step: sums of probabilities by its table (in floats),
//! tables of few bits (weights only, in floats), integers, beam, bounds on the work of a frame; and what a cold start in mid-clip costs.
//!
//!     cargo run --release -p lipstream --example fidelity -- FOLDER MGE.safetensors [train|val|test]
use std::path::PathBuf;

use anyhow::{Result, bail};
use lipstream::audio;
use lipstream::engine::stream;
use lipstream::evaluate::metrics::Score;
use lipstream::evaluate::truths;
use lipstream::export::{MgeSettings, export_mge};
use lipstream::features::{FeatureFolder, Split};
use lipstream::mge::live;
use lipstream::mge::log_sums::Sums;
use lipstream::mge::model::MgeModel;
use lipstream::mge::rounding::rounded;
use lipstream_core::logmath::{FRACTION_BITS, LogProb};
use lipstream_core::model::Model as Tables;
use lipstream_core::stream::Settings;
use ndarray::s;

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, model, rest @ ..] = arguments.as_slice() else {
        bail!("give a feature folder and a model trained with --train mge")
    };
    let split = Split::named(rest.first().map_or("test", String::as_str))?;
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
    for sums in [Sums::Exact, Sums::Table] {
        let mut score = Score::new(model.deviation.len());
        for clip in &clips {
            let said = live::convert_with_sums(&model, clip.audio.view(), sums).parameters;
            score.add(&clip.visual, &said);
        }
        show(&format!("logs of 12 bits, {sums:?} sums"), score);
    }
    for bits in [8, 7, 6, 5, 4] {
        show(&format!("{bits} bits"), score(&rounded(&model, bits), 0, false));
    }
    let tables = export_mge(&model, &MgeSettings::default())?.bytes;
    let tables = Tables::new_checked(&tables)?;
    let bits = |bits: i32| Some(LogProb::from_q12(bits << FRACTION_BITS));
    let all = Settings {
        most: Some(u16::MAX),
        phones: Some(u16::MAX),
        settle: Some(false),
        ..Settings::default()
    };
    let steps = [
        (
            "integers, beam of 40 bits",
            Settings {
                beam: bits(40),
                ..all
            },
        ),
        (
            "… of 20 bits",
            Settings {
                beam: bits(20),
                ..all
            },
        ),
        (
            "… of 14 bits",
            Settings {
                beam: bits(14),
                ..all
            },
        ),
        ("… as exported", all),
        ("… and its bound on states", Settings { most: None, ..all }),
        (
            "… and on phones",
            Settings {
                most: None,
                phones: None,
                ..all
            },
        ),
        ("… and settled: the device", Settings::default()),
    ];
    let sounds = clips
        .iter()
        .map(|clip| audio::read(&folder.wav_path(&clip.clip.id)));
    let sounds: Vec<_> = sounds.collect::<Result<_>>()?;
    for (name, settings) in steps {
        let mut score = Score::new(model.deviation.len());
        for (clip, sound) in clips.iter().zip(&sounds) {
            score.add(
                &clip.visual,
                &stream(&tables, &sound.samples, settings)?.parameters,
            );
        }
        show(name, score);
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
