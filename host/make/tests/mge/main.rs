//! Minimum generation error training end to end on a made-up talker: learnt, the same bytes again, interrupted and
//! gone on with, streamed as in batches, refused in words.
mod second;

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use lipstream::export::{MgeSettings, export_mge};
use lipstream::hmm::joint::N_EMITTING;
use lipstream::kinds::likelihood::Model;
use lipstream::kinds::recurrent::chain::VISUAL;
use lipstream::kinds::recurrent::live;
use lipstream::kinds::recurrent::model::RecurrentModel;
use lipstream::kinds::recurrent::parameters::{Feedback, GROUPS, Gate, Group};
use lipstream::kinds::recurrent::settle::settle;
use lipstream::kinds::recurrent::step::Net;
use lipstream::phones::Phone;
use lipstream::progress::Progress;
use lipstream::synthetic::{self, Sizes};
use lipstream_core::kinds::Convert;
use lipstream_core::kinds::recurrent::Converter;
use lipstream_core::logmath::LogProb;
use lipstream_core::{Model as Tables, ParameterFrame, StreamSettings};
use lipstream_make::evaluate::metrics::Score;
use lipstream_make::mge::adapt;
use lipstream_make::mge::data::{Clip, Data};
use lipstream_make::mge::judge::{centred, judge};
use lipstream_make::mge::lips::Gap;
use lipstream_make::mge::pass::{Masks, Tape};
use lipstream_make::mge::settings::MgeTrainSettings;
use lipstream_make::mge::store::Store;
use lipstream_make::mge::train::train_on;
use ndarray::{Array2, ArrayView1, Axis};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const OUTPUTS: usize = 5;

fn parent() -> Model {
    synthetic::model(&Sizes::small(), 2.0, &mut Pcg64::seed_from_u64(8))
}

/// Phones in random order, five states each; sound and mouth are functions of phone and viseme with noise, and the mouth
/// glides, so that a memory helps.
fn clips(parent: &Model, n: usize, video: bool, rng: &mut Pcg64) -> Vec<Clip> {
    let mut fixed = Pcg64::seed_from_u64(21);
    let sounds = Array2::from_shape_fn((parent.phones.len(), 13), |_| fixed.random_range(-1.5f32..1.5));
    let looks = Array2::from_shape_fn((13, OUTPUTS), |_| fixed.random_range(-1.5f32..1.5));
    (0..n)
        .map(|index| {
            let (mut x, mut states) = (Vec::new(), Vec::new());
            let mut mouth = Vec::new();
            let mut now = [0.0f32; OUTPUTS];
            for _ in 0..8 {
                let phone = rng.random_range(0..parent.phones.len());
                let viseme = usize::from(parent.phones[phone].viseme().0);
                for state in 0..N_EMITTING {
                    for _ in 0..rng.random_range(1..4) {
                        states.push((N_EMITTING * phone + state, N_EMITTING * viseme + state));
                        x.extend((0..13).map(|d| sounds[[phone, d]] + rng.random_range(-0.5f32..0.5)));
                        for (d, value) in now.iter_mut().enumerate() {
                            *value += 0.4 * (looks[[viseme, d]] - *value);
                            mouth.push(*value + rng.random_range(-0.05f32..0.05));
                        }
                    }
                }
            }
            let frames = states.len();
            Clip {
                id: format!("clip{index}"),
                x: Array2::from_shape_vec((frames, 13), x).unwrap(),
                mouth: video.then(|| Array2::from_shape_vec((frames, OUTPUTS), mouth).unwrap()),
                states,
                variants: Vec::new(),
            }
        })
        .collect()
}

fn data(parent: &Model) -> Data {
    let mut rng = Pcg64::seed_from_u64(4);
    Data {
        train: stored(clips(parent, 24, true, &mut rng)),
        heard: stored(clips(parent, 6, false, &mut rng)),
        watched: stored(Vec::new()),
        gap: None,
        validation: stored(clips(parent, 6, true, &mut rng)),
        scale: vec![0.5; 13],
        deviation: (0..OUTPUTS).map(|d| 10.0 / (d + 1) as f32).collect(),
    }
}

fn stored(clips: Vec<Clip>) -> Store {
    let mut store = Store::new(None).unwrap();
    clips.iter().for_each(|clip| store.push(clip).unwrap());
    store
}

fn every(clips: &Store) -> impl Iterator<Item = Clip> {
    (0..clips.len()).map(|n| clips.get(n).unwrap())
}

fn small() -> MgeTrainSettings {
    let mut settings = MgeTrainSettings {
        inputs: 16,
        memory: 12,
        passes: 8,
        batch: 6,
        crop: 40,
        ..MgeTrainSettings::default()
    };
    settings.rule.rate = 0.02;
    settings
}

fn quietly(
    data: &Data,
    parent: &Model,
    settings: &MgeTrainSettings,
    checkpoint: Option<&Path>,
) -> RecurrentModel {
    train_on(data, parent, settings, checkpoint, &()).unwrap()
}

#[test]
fn a_made_up_talker_is_learnt() {
    let parent = parent();
    let data = data(&parent);
    for feedback in [Feedback::Output, Feedback::None] {
        let settings = MgeTrainSettings { feedback, ..small() };
        let model = quietly(&data, &parent, &settings, None);
        let seen = judge(
            &model.parameters,
            &model.chain(),
            &model.context_mean,
            &model.deviation,
            &data.validation,
            8,
            model.least,
        )
        .unwrap();
        let acc = seen.score.acc();
        assert!(
            acc > 0.8,
            "{feedback:?}: ACC {acc} on clips that were not trained on"
        );
        assert!(
            seen.share(seen.visemes) > 0.7,
            "{feedback:?}: visemes {}",
            seen.share(seen.visemes)
        );
    }
}

/// Another person says as much with a mouth of its own: what hears stays as it is, bit for bit, and the mouth is learnt from a few clips without
/// their states.
#[test]
fn a_new_mouth_is_learnt_for_the_old_ears() {
    let parent = parent();
    let old = data(&parent);
    let model = quietly(&old, &parent, &small(), None);
    // Every parameter of the new mouth is a mixture of the old one's.
    let mut rng = Pcg64::seed_from_u64(31);
    let mixture = Array2::from_shape_fn((OUTPUTS, OUTPUTS), |_| rng.random_range(-1.0f32..1.0));
    let others = |store: &Store| {
        let other = |mut clip: Clip| {
            clip.mouth = clip.mouth.map(|mouth| mouth.dot(&mixture));
            clip.states = vec![(0, 0); clip.x.nrows()];
            clip
        };
        every(store).map(other).collect::<Vec<_>>()
    };
    let new = Data {
        train: stored(others(&old.train)[..10].to_vec()),
        heard: Store::new(None).unwrap(),
        watched: Store::new(None).unwrap(),
        gap: None,
        validation: stored(others(&old.validation)),
        scale: old.scale.clone(),
        deviation: old.deviation.clone(),
    };
    let mut settings = adapt::settings(
        &model,
        &MgeTrainSettings {
            batch: 2,
            passes: 20,
            ..small()
        },
    );
    settings.rule.rate = 0.02;
    let adapted = adapt::adapt_on(&new, &model, &parent, &settings, None, &()).unwrap();
    let acc = |model: &RecurrentModel, data: &Data| {
        let chain = model.chain();
        let parameters = &model.parameters;
        let seen = judge(
            parameters,
            &chain,
            &model.context_mean,
            &model.deviation,
            &data.validation,
            8,
            model.least,
        );
        seen.unwrap().score.acc()
    };
    let (own, before, after) = (acc(&model, &old), acc(&model, &new), acc(&adapted, &new));
    println!(
        "ACC of the old mouth {own:.3}; of the new one by the old model {before:.3}, adapted {after:.3}"
    );
    assert!(after > before + 0.3 && after > own - 0.15);
    for group in GROUPS {
        let stays = !matches!(
            group,
            Group::Visual
                | Group::Global
                | Group::GlobalBias
                | Group::AudioOffset
                | Group::VisualOffset
                | Group::Output
        );
        let same = adapted.parameters.of(group) == model.parameters.of(group);
        assert!(same || !stays, "{} has changed", group.name());
    }
    assert_eq!(
        (&adapted.scale, &adapted.context_mean),
        (&model.scale, &model.context_mean)
    );
}

/// Somebody else says it, whose vowels lie elsewhere: cepstra are mixed with their neighbours.
fn sound_otherwise(clip: &mut Clip) {
    let x = clip.x.clone();
    clip.x = Array2::from_shape_fn(x.dim(), |(t, d)| 0.5 * x[[t, d]] - 0.8 * x[[t, (d + 1) % 13]]);
}

/// Others sound otherwise; of their mouths the gap alone is known, each on a scale of its own. Learning from them must not cost the person's own mouth.
#[test]
fn the_lips_of_others_are_learnt_from() {
    let parent = parent();
    let own = data(&parent);
    let gap = [0.6, -0.4, 0.2, 0.0, 0.1];
    let gap_of = |mouth: &Array2<f32>| mouth.dot(&ArrayView1::from(&gap));
    let others = |seed: u64| -> Vec<Clip> {
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut all = clips(&parent, 12, true, &mut rng);
        for (n, clip) in all.iter_mut().enumerate() {
            sound_otherwise(clip);
            let truth = gap_of(clip.mouth.as_ref().unwrap()) * (1.0 + n as f32 / 6.0);
            let (mean, deviation) = (truth.mean().unwrap(), truth.std(0.0));
            clip.mouth = Some(((truth - mean) / deviation).insert_axis(Axis(1)));
            clip.states = vec![(0, 0); clip.x.nrows()];
        }
        all
    };
    let with = Data {
        watched: stored(others(51)),
        gap: Some(Gap::new(gap.to_vec(), 0.0, &parent.phones)),
        ..data(&parent)
    };
    let settings = MgeTrainSettings {
        passes: 20,
        lip_error: 1.0,
        ..small()
    };
    let follows = |model: &RecurrentModel| {
        let mut score = Score::new(1);
        for clip in others(52) {
            // The scale is taken off again.
            let said = live::convert(model, (&clip.x / 0.5).view()).parameters;
            let said = gap_of(&(said / ArrayView1::from(&model.deviation))).insert_axis(Axis(1));
            score.add(&clip.mouth.unwrap(), &said);
        }
        score.acc()
    };
    let own_acc = |model: &RecurrentModel| {
        let seen = judge(
            &model.parameters,
            &model.chain(),
            &model.context_mean,
            &model.deviation,
            &own.validation,
            8,
            model.least,
        );
        seen.unwrap().score.acc()
    };
    let alone = quietly(&own, &parent, &settings, None);
    let watching = quietly(&with, &parent, &settings, None);
    let (before, after) = (follows(&alone), follows(&watching));
    println!(
        "gap of others: {before:.3} alone, {after:.3} watching; own ACC {:.3}, {:.3}",
        own_acc(&alone),
        own_acc(&watching)
    );
    assert!(after > 0.8 && after > before + 0.05, "{before} {after}");
    assert!(own_acc(&watching) > own_acc(&alone) - 0.1);
}

/// One phone asks for lips that are closer than the person's ever are: they are where others are heard.
#[test]
fn lips_meet_where_they_are_asked_to() {
    let parent = parent();
    // By their places in the model, whatever it calls them.
    let named = |n: usize| Phone::from_name(if n == 2 { "p" } else { "sil" }).unwrap();
    let phones: Vec<Phone> = (0..parent.phones.len()).map(named).collect();
    let slopes = vec![0.6, -0.4, 0.2, 0.0, 0.1];
    let heard = |seed: u64| -> Vec<Clip> {
        let mut all = clips(&parent, 12, false, &mut Pcg64::seed_from_u64(seed));
        all.iter_mut().for_each(sound_otherwise);
        all
    };
    let wrong = |gap: &Gap, model: &RecurrentModel| -> f32 {
        let (mut sum, mut count) = (0.0, 0.0f32);
        for clip in heard(52) {
            let said = live::convert(model, (&clip.x / 0.5).view()).parameters;
            let said = said / ArrayView1::from(&model.deviation);
            for wrong in gap.wrong(said.view(), None, &clip.states) {
                sum += wrong;
                count += f32::from(u8::from(wrong != 0.0));
            }
        }
        sum / count.max(1.0)
    };
    let settings = |closure_error| MgeTrainSettings {
        passes: 20,
        closure_error,
        ..small()
    };
    // Closed is where the phone's mouths lie, less a deviation.
    let open = Gap::new(slopes.clone(), 0.0, &phones);
    let with = |gap| Data {
        heard: stored(heard(51)),
        gap,
        ..data(&parent)
    };
    let alone = quietly(&with(None), &parent, &settings(0.0), None);
    let gap = Gap::new(slopes, wrong(&open, &alone) - 1.0, &phones);
    let asked = with(Some(gap.clone()));
    let asked = quietly(&asked, &parent, &settings(3.0), None);
    let (before, after) = (wrong(&gap, &alone), wrong(&gap, &asked));
    println!("too far apart: {before:.3} before, {after:.3} after");
    assert!(before > 0.5 && after < 0.5 * before, "{before} {after}");
}

#[test]
fn threads_do_not_change_a_byte() {
    let scratch = tempfile::tempdir().unwrap();
    let parent = parent();
    let data = data(&parent);
    let settings = MgeTrainSettings { passes: 2, ..small() };
    let bytes = |threads: usize| {
        let path = scratch.path().join(format!("{threads}.safetensors"));
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| quietly(&data, &parent, &settings, None))
            .write(&path)
            .unwrap();
        std::fs::read(path).unwrap()
    };
    let one = bytes(1);
    assert!(one == bytes(3));
    assert!(one == bytes(1));
}

/// Trains twice with this checkpoint, the second time from where a run that is killed when it says `killed` has left off: it says so, and gives the same model.
fn goes_on_to_the_same(
    checkpoint: &Path,
    [killed, going_on]: [&str; 2],
    train: impl Fn(&dyn Progress) -> RecurrentModel,
) {
    let early = checkpoint.with_extension("early");
    let whole = train(&|line: &str| {
        if line.starts_with(killed) {
            std::fs::copy(checkpoint, &early).unwrap();
        }
    });
    std::fs::copy(&early, checkpoint).unwrap();
    let went_on = AtomicBool::new(false);
    let again = train(&|line: &str| {
        if line.starts_with(going_on) {
            went_on.store(true, Ordering::Relaxed);
        }
    });
    assert!(went_on.into_inner());
    assert!(whole == again);
}

#[test]
fn an_interrupted_run_goes_on_to_the_same_model() {
    let scratch = tempfile::tempdir().unwrap();
    let checkpoint = scratch.path().join("m.checkpoint");
    let parent = parent();
    let data = data(&parent);
    let settings = MgeTrainSettings { passes: 4, ..small() };
    goes_on_to_the_same(&checkpoint, ["pass 3/", "going on after step 8"], |progress| {
        train_on(&data, &parent, &settings, Some(&checkpoint), progress).unwrap()
    });

    let other = MgeTrainSettings { seed: 2, ..settings };
    let error = train_on(&data, &parent, &other, Some(&checkpoint), &()).unwrap_err();
    assert!(error.to_string().contains("other settings"), "{error:#}");
}

#[test]
fn an_extreme_rate_is_one_clear_error() {
    let parent = parent();
    let data = data(&parent);
    for rate in [1e4, 1e30] {
        let mut settings = small();
        settings.rule.rate = rate;
        let error = train_on(&data, &parent, &settings, None, &()).unwrap_err();
        let text = error.to_string();
        assert!(
            text.contains("diverged") && text.contains("learning rate"),
            "{text}"
        );
    }
}

#[test]
fn streamed_frame_by_frame_as_in_batches() {
    let parent = parent();
    let data = data(&parent);
    for (feedback, maps, rates) in [
        (Feedback::Output, Gate::Both, Gate::Visual),
        (Feedback::Memory, Gate::Audio, Gate::Audio),
        (Feedback::None, Gate::Visual, Gate::Visual),
    ] {
        let settings = MgeTrainSettings {
            feedback,
            maps,
            rates,
            passes: 2,
            ..small()
        };
        let model = quietly(&data, &parent, &settings, None);
        let net = Net::new(&model.parameters, &model.chain(), model.least);
        for (clip, ahead) in every(&data.validation).flat_map(|c| [8, 3, 0].map(|ahead| (c.clone(), ahead))) {
            let frames = clip.x.nrows();
            let context = model
                .parameters
                .shape
                .context
                .stack_within(&clip.x, frames, ahead);
            let tape = Tape::forward(&net, centred(&context, &model.context_mean), Masks::default());
            let raw = &clip.x / &ndarray::ArrayView1::from(&model.scale);
            let said = live::convert_within(&model, raw.view(), ahead);
            assert_eq!(said.parameters.dim(), (frames, OUTPUTS));
            for t in 0..frames {
                for (d, deviation) in model.deviation.iter().enumerate() {
                    let batch = tape.output[[t, d]] * deviation;
                    assert!((said.parameters[[t, d]] - batch).abs() < 2e-3 * deviation.max(1.0));
                }
                for v in 0..VISUAL {
                    assert!((said.visual[[t, v]] - tape.visual[[t, v]]).abs() < 1e-3);
                }
                assert!((said.visemes.row(t).sum() - 1.0).abs() < 1e-4);
            }
        }
    }
}

#[test]
fn a_file_gives_the_model_back() {
    let scratch = tempfile::tempdir().unwrap();
    let path = scratch.path().join("m.safetensors");
    let parent = parent();
    let data = data(&parent);
    let model = quietly(&data, &parent, &MgeTrainSettings { passes: 1, ..small() }, None);
    model.write(&path).unwrap();
    let back = RecurrentModel::read(&path).unwrap();
    assert!(back.parent == model.parent);
    for group in GROUPS {
        if !matches!(
            group,
            lipstream::kinds::recurrent::parameters::Group::Transition
                | lipstream::kinds::recurrent::parameters::Group::Initial
        ) {
            assert!(
                back.parameters.of(group) == model.parameters.of(group),
                "{}",
                group.name()
            );
        }
    }
    let clip = data.validation.get(0).unwrap();
    let x = clip.x.view();
    let (a, b) = (live::convert(&model, x), live::convert(&back, x));
    let largest = (&a.parameters - &b.parameters).fold(0.0f32, |m, d| m.max(d.abs()));
    assert!(largest < 1e-2, "{largest}");

    // Either reader refuses the other's file in words.
    let error = Model::read(&path).unwrap_err().to_string();
    assert!(error.contains("kind"), "{error}");
    let likely = scratch.path().join("l.safetensors");
    parent.write(&likely).unwrap();
    let error = RecurrentModel::read(&likely).unwrap_err().to_string();
    assert!(error.contains("this needs"), "{error}");

    // A file cut short, and one with a tensor of another shape.
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&likely, &bytes[..bytes.len() / 2]).unwrap();
    assert!(RecurrentModel::read(&likely).is_err());
    let mut wrong = model.clone();
    wrong.context_mean.pop();
    wrong.write(&likely).unwrap();
    let error = lipstream::error::chain(&RecurrentModel::read(&likely).unwrap_err());
    assert!(error.contains("mge.context_mean"), "{error}");
}

/// How far the device's arithmetic is from the floats, on whole clips and sounds shorter than the look-ahead: of the mouth, and in viseme weights.
fn apart(model: &RecurrentModel, clips: &Store) -> (f64, f64) {
    let tables = export_mge(model, &MgeSettings::default()).unwrap().bytes;
    let (mut error, mut power, mut visemes, mut frames) = (0.0f64, 0.0f64, 0.0f64, 0.0f64);
    for clip in every(clips) {
        let raw = &clip.x / &ndarray::ArrayView1::from(&model.scale);
        let heard = raw.mapv(|v| (v * 256.0).round() as i16);
        for (length, ahead, settles) in [
            (heard.nrows(), 8, false),
            (heard.nrows(), 8, true),
            (heard.nrows(), 3, false),
            (1, 8, true),
            (2, 3, false),
            (8, 8, true),
            (9, 6, false),
            (30, 8, true),
        ] {
            let heard = heard.slice(ndarray::s![..length, ..]).to_owned();
            let statics = heard.mapv(|v| f32::from(v) / 256.0);
            let mut floats = live::convert_within(model, statics.view(), ahead);
            if settles {
                settle(&mut floats.parameters, &model.deviation);
            }
            let said = fixed(&tables, &heard, ahead as u16, settles);
            assert_eq!(said.len(), length);
            for (t, frame) in said.iter().enumerate() {
                assert_eq!((frame.frame as usize, frame.sample as usize), (t, 160 * t + 200));
                for d in 0..OUTPUTS {
                    let fixed = f64::from(frame.values[d]) / 1024.0;
                    let float = f64::from(floats.parameters[[t, d]] / model.deviation[d]);
                    error += (fixed - float).powi(2);
                    power += float.powi(2);
                }
                for (v, weight) in frame.viseme_weights.iter().enumerate() {
                    visemes += (f64::from(*weight) / 255.0 - f64::from(floats.visemes[[t, v]])).powi(2);
                }
                frames += 1.0;
            }
        }
    }
    ((error / power).sqrt(), (visemes / frames).sqrt())
}

/// The device's arithmetic on whole LSBs of Q7.8, to the end of the sound.
fn fixed(tables: &[u8], statics: &Array2<i16>, look_ahead: u16, settles: bool) -> Vec<ParameterFrame> {
    let tables = Tables::new_checked(tables).unwrap();
    // Without beam and bound: what is compared is the arithmetic.
    let settings = StreamSettings {
        beam: Some(LogProb::from_q12(60 << 12)),
        most: Some(384),
        look_ahead: Some(look_ahead),
        settle: Some(settles),
        ..StreamSettings::default()
    };
    let mut converter = Box::new(Converter::<384>::new(&tables, settings));
    let mut out = Vec::new();
    for row in statics.rows() {
        let row: [i16; 13] = std::array::from_fn(|i| row[i]);
        out.extend(converter.push(Some(&row), None));
    }
    while !converter.is_done() {
        out.extend(converter.push(None, None));
    }
    out
}

#[test]
fn fixed_point_follows_the_floats() {
    let parent = parent();
    let data = data(&parent);
    for (feedback, maps, rates) in [
        (Feedback::Output, Gate::Both, Gate::Visual),
        (Feedback::Output, Gate::Audio, Gate::Audio),
        (Feedback::None, Gate::Visual, Gate::Visual),
    ] {
        let settings = MgeTrainSettings {
            feedback,
            maps,
            rates,
            ..small()
        };
        let model = quietly(&data, &parent, &settings, None);
        let (relative, visemes) = apart(&model, &data.validation);
        println!("{feedback:?} {maps:?} {rates:?}: {relative:.4} of the mouth, visemes {visemes:.4}");
        assert!(relative < 0.02, "{feedback:?} {maps:?} {rates:?}: {relative}");
        assert!(visemes < 0.03, "{feedback:?} {maps:?} {rates:?}: {visemes}");
    }
}
