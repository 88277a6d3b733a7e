//! Sessions: whatever the cut, the frames of a session are those of the whole sound, for every engine and kind.
use lipstream::engine::{Engine, FloatModel, RunSettings};
use lipstream::kinds::likelihood::convert::{Lag, convert};
use lipstream::kinds::recurrent::live;
use lipstream::kinds::recurrent::settle::settle;
use lipstream::reference::{self, Normalisation};
use lipstream::session::Frame;
use lipstream::shipped;
use lipstream::synthetic::{self, Sizes};
use lipstream::tensors::Tensors;
use lipstream::time::frame_count;
use lipstream_core::N_STATIC;
use lipstream_media::sound;
use ndarray::{Array2, ArrayView1};
use rand::SeedableRng;

fn hello() -> Vec<i16> {
    sound::decode(shipped::SOUND).unwrap().samples
}

/// Parameters and viseme weights of all frames, pushed `piece` samples at a time.
fn said(engine: &Engine, with: &RunSettings, samples: &[i16], piece: usize) -> Vec<(Vec<f32>, Vec<f32>)> {
    let mut session = engine.session(with).unwrap();
    let mut frames = Vec::new();
    let mut take = |frame: Frame| {
        assert_eq!(frame.index, frames.len());
        frames.push((frame.parameters.to_vec(), frame.visemes.to_vec()));
    };
    for samples in samples.chunks(piece) {
        session.push(samples, &mut take).unwrap();
    }
    session.finish(&mut take).unwrap();
    frames
}

fn any_cut_gives_the_same(engine: &Engine, with: &RunSettings, samples: &[i16]) {
    let whole = said(engine, with, samples, samples.len());
    assert_eq!(whole.len(), frame_count(samples.len()));
    for piece in [1_601, 160, 37] {
        assert!(said(engine, with, samples, piece) == whole, "pieces of {piece}");
    }
    let converted = engine.convert(samples, with).unwrap();
    assert_eq!(converted.parameters.dim(), (whole.len(), engine.n_parameters()));
    assert_eq!(converted.visemes.dim(), (whole.len(), 13));
}

fn close(frames: &[(Vec<f32>, Vec<f32>)], parameters: &Array2<f32>, visemes: &Array2<f32>, tolerance: f32) {
    assert_eq!(frames.len(), parameters.nrows());
    let differ = |row: ArrayView1<f32>, own: &[f32]| {
        row.iter()
            .zip(own)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f32::max)
    };
    for (t, (own, weights)) in frames.iter().enumerate() {
        let (parameters, visemes) = (parameters.row(t), visemes.row(t));
        assert!(
            differ(parameters, own) <= tolerance,
            "frame {t}: {}",
            differ(parameters, own)
        );
        assert!(
            differ(visemes, weights) <= 1e-4,
            "frame {t}: {}",
            differ(visemes, weights)
        );
    }
}

fn causal(mean: &[f32]) -> Normalisation {
    let start_mean: [f32; N_STATIC] = mean.try_into().unwrap();
    Normalisation::Causal { start_mean }
}

#[test]
fn the_fixed_engine() {
    any_cut_gives_the_same(&Engine::shipped(), &RunSettings::default(), &hello()[..30_000]);
}

#[test]
fn a_recurrent_model_in_floats() {
    let tensors = Tensors::parse(shipped::MODEL, "the shipped model").unwrap();
    let model = FloatModel::of_tensors(&tensors).unwrap();
    let samples = &hello()[..30_000];
    let FloatModel::Recurrent(recurrent) = &model else {
        panic!("the shipped model is recurrent")
    };
    let mean = &recurrent.parent.start_mean.to_vec();
    let observations = reference::observations(samples, causal(mean));
    let mut want = live::convert(recurrent, observations.view());
    settle(&mut want.parameters, &recurrent.deviation);
    let engine = Engine::from(model);
    any_cut_gives_the_same(&engine, &RunSettings::default(), samples);
    let frames = said(&engine, &RunSettings::default(), samples, 500);
    close(&frames, &want.parameters, &want.visemes, 0.0);
}

#[test]
fn a_likelihood_trained_model_in_floats() {
    let mut rng = rand_pcg::Pcg64::seed_from_u64(3);
    let model = synthetic::model(&Sizes::small(), 1.0, &mut rng);
    // Longer than two blocks of the session, and not a whole number of them.
    let samples = &hello()[..30_000];
    let observations = reference::observations(samples, causal(&model.start_mean.to_vec()));
    let lag = model.following.lag;
    let (parameters, visemes) = convert(&model, &observations, Lag::Frames(lag)).unwrap();
    let scale = parameters.iter().fold(0f32, |most, v| most.max(v.abs()));
    let engine = Engine::from(FloatModel::Likelihood(Box::new(model)));
    any_cut_gives_the_same(&engine, &RunSettings::default(), samples);
    let frames = said(&engine, &RunSettings::default(), samples, 500);
    close(&frames, &parameters, &visemes, 1e-4 * scale);
}

#[test]
fn sounds_shorter_than_a_window_give_nothing() {
    for length in [0, 1, 399] {
        assert!(said(&Engine::shipped(), &RunSettings::default(), &vec![7; length], 100).is_empty());
    }
}
