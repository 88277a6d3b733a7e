//! What the device costs a model, step by step.
//!
//!     cargo xtask fidelity FOLDER MODEL.safetensors [train|val|test]
//!
//! Trained by minimum generation error: sums of probabilities by the core's table (in floats), tables of few bits (weights only, in
//! floats), integers, beam, bounds on the work of a frame, settling; and what a cold start in mid-clip costs. Likelihood-trained: lag,
//! integers, beam, room for joint states.
use std::path::PathBuf;

use anyhow::{Result, bail};
use lipstream::engine::{Converted, converted, stream};
use lipstream::export::{ExportSettings, MgeSettings, export, export_mge};
use lipstream::kinds::likelihood::Model;
use lipstream::kinds::likelihood::convert::{Lag, convert};
use lipstream::kinds::recurrent::live;
use lipstream::kinds::recurrent::log_sums::Sums;
use lipstream::kinds::recurrent::model::RecurrentModel;
use lipstream::tensors::Tensors;
use lipstream_core::hmm::search::MAX_BEAM;
use lipstream_core::hmm::transition::MAX_JOINT_STATES;
use lipstream_core::kinds::{Convert, Kind, likelihood, recurrent};
use lipstream_core::logmath::{FRACTION_BITS, LogProb};
use lipstream_core::{AnyModel, Likelihood, Model as Tables, Recurrent, Stream, StreamSettings};
use lipstream_make::evaluate::metrics::Score;
use lipstream_make::evaluate::{Truth, truths};
use lipstream_make::features::{FeatureFolder, Split};
use lipstream_make::mge::rounding::rounded;
use lipstream_media::sound;
use ndarray::{Array2, s};
use rayon::prelude::*;

pub(crate) fn run(words: &[String]) -> Result<()> {
    let [folder, model, rest @ ..] = words else {
        bail!("give a feature folder and a model")
    };
    let split = Split::named(rest.first().map_or("test", String::as_str))?;
    let folder = FeatureFolder::open(&PathBuf::from(folder))?;
    let path = PathBuf::from(model);
    let clips = truths(&folder, split)?;
    let sounds = clips.iter().map(|clip| {
        let sound = sound::read(&folder.wav_path(&clip.clip.id))?;
        Ok(sound.samples)
    });
    let sounds: Vec<Vec<i16>> = sounds.collect::<Result<_>>()?;
    if RecurrentModel::is_kind(&Tensors::read(&path)?) {
        of_mge(&RecurrentModel::read(&path)?, &clips, &sounds)
    } else {
        of_likelihood(&Model::read(&path)?, &clips, &sounds)
    }
}

fn show(name: &str, score: Score) {
    println!("{name}: AMSE {:.1}, ACC {:.4}", score.amse(), score.acc());
}

/// The score of what was said of each clip.
fn judged<'a>(clips: &[Truth], said: impl IntoIterator<Item = &'a Array2<f32>>) -> Score {
    let mut score = Score::new(clips.first().map_or(0, |clip| clip.visual.ncols()));
    for (clip, parameters) in clips.iter().zip(said) {
        score.add(&clip.visual, parameters);
    }
    score
}

fn bits(bits: i32) -> Option<LogProb> {
    Some(LogProb::from_q12(bits << FRACTION_BITS))
}

/// A whole sound through a stream of another size than a device's.
fn sized<'m, K: Kind<'m>, C: Convert<'m, K>>(
    tables: &AnyModel,
    model: &'m Tables<'m, K>,
    mut sound: &[i16],
    settings: StreamSettings,
) -> lipstream::Result<Converted> {
    let mut stream = Stream::<K, C>::sized(model, settings);
    let mut frames = Vec::new();
    while !sound.is_empty() {
        let (taken, frame) = stream.push(sound);
        sound = &sound[taken..];
        frames.extend(frame);
    }
    frames.extend(std::iter::from_fn(|| stream.finish()));
    converted(tables, frames)
}

/// Room for every joint state that there can be.
const ALL: usize = MAX_JOINT_STATES;

fn of_likelihood(model: &Model, clips: &[Truth], sounds: &[Vec<i16>]) -> Result<()> {
    let lag = model.following.lag;
    for (name, lag) in [
        ("floats, the whole utterance", Lag::Whole),
        ("floats, the model's lag", Lag::Frames(lag)),
    ] {
        let said = clips.par_iter().map(|clip| convert(model, &clip.audio, lag));
        let said: Vec<_> = said.collect::<Result<_, _>>()?;
        show(name, judged(clips, said.iter().map(|(parameters, _)| parameters)));
    }
    let bytes = export(model, &ExportSettings::of(model))?.bytes;
    let tables = AnyModel::new_checked(&bytes)?;
    let roomy = Tables::<Likelihood>::new_checked(&bytes)?;
    let none = LogProb::from_q12(MAX_BEAM);
    let device = |room: usize, beam: Option<LogProb>| -> Result<Score> {
        let settings = StreamSettings {
            beam,
            ..StreamSettings::default()
        };
        let said = sounds.par_iter().map(|sound| match room {
            ALL => sized::<_, likelihood::Converter<ALL, { likelihood::FRAMES }>>(
                &tables, &roomy, sound, settings,
            ),
            _ => stream(&tables, sound, settings),
        });
        let said: Vec<_> = said.collect::<Result<_, _>>()?;
        Ok(judged(clips, said.iter().map(|said| &said.parameters)))
    };
    show("integers, no beam", device(ALL, Some(none))?);
    for width in [32, 24, 20, 16] {
        show(&format!("… {width} bits"), device(ALL, bits(width))?);
    }
    show(
        "as exported, and its room: the device",
        device(likelihood::TOKENS, None)?,
    );
    Ok(())
}

fn of_mge(model: &RecurrentModel, clips: &[Truth], sounds: &[Vec<i16>]) -> Result<()> {
    // Frames from `from` on, of a stream that began there or at the clip's beginning.
    let score = |model: &RecurrentModel, from: usize, cold: bool| -> Score {
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
    show("floats", score(model, 0, false));
    for sums in [Sums::Exact, Sums::Table] {
        let said = clips
            .iter()
            .map(|clip| live::convert_with_sums(model, clip.audio.view(), sums).parameters);
        let said: Vec<_> = said.collect();
        show(&format!("logs of 12 bits, {sums:?} sums"), judged(clips, &said));
    }
    for bits in [8, 7, 6, 5, 4] {
        show(&format!("{bits} bits"), score(&rounded(model, bits), 0, false));
    }
    let bytes = export_mge(model, &MgeSettings::default())?.bytes;
    let tables = AnyModel::new_checked(&bytes)?;
    let roomy = Tables::<Recurrent>::new_checked(&bytes)?;
    let all = StreamSettings {
        most: Some(u16::MAX),
        phones: Some(u16::MAX),
        settle: Some(false),
        ..StreamSettings::default()
    };
    let steps = [
        (
            "integers, beam of 40 bits",
            StreamSettings {
                beam: bits(40),
                ..all
            },
        ),
        (
            "… of 20 bits",
            StreamSettings {
                beam: bits(20),
                ..all
            },
        ),
        (
            "… of 14 bits",
            StreamSettings {
                beam: bits(14),
                ..all
            },
        ),
        ("… as exported", all),
        ("… and its bound on states", StreamSettings { most: None, ..all }),
        (
            "… and on phones",
            StreamSettings {
                most: None,
                phones: None,
                ..all
            },
        ),
        ("… and settled: the device", StreamSettings::default()),
    ];
    for (name, settings) in steps {
        // Room for as many joint states as a likelihood-trained model's stream has; the bound is the settings'.
        let said = sounds.iter().map(|sound| {
            let said =
                sized::<_, recurrent::Converter<{ likelihood::TOKENS }>>(&tables, &roomy, sound, settings)?;
            Ok(said.parameters)
        });
        let said: Vec<_> = said.collect::<Result<_>>()?;
        show(name, judged(clips, &said));
    }
    for from in [50, 100, 150] {
        show(
            &format!("from frame {from}, whole clip heard"),
            score(model, from, false),
        );
        show(
            &format!("from frame {from}, started there"),
            score(model, from, true),
        );
    }
    Ok(())
}
