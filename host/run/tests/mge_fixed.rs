//! Streams of a model with a memory, of random numbers: cuts, ends, hostile sounds, crafted tables. Against its floats a
//! trained one is held in `mge.rs`.
mod common;

use common::tables::{hear_out, n_sections, nth, seal};
use lipstream::export::{MgeSettings, export_mge};
use lipstream::kinds::recurrent::model::RecurrentModel;
use lipstream::kinds::recurrent::parameters::{Feedback, Gate, Group};
use lipstream::synthetic::{self, Sizes};
use lipstream_core::kinds::recurrent::{Converter, TOKENS};
use lipstream_core::logmath::LogProb;
use lipstream_core::model::ModelError;
use lipstream_core::model::container::{CRC_SIZE, entry, header};
use lipstream_core::wire::Profile;
use lipstream_core::{AnyModel, Likelihood, Model, ParameterFrame, Recurrent, Stream, StreamSettings};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

type Tables<'a> = Model<'a, Recurrent<'a>>;

const OUTPUTS: usize = 5;

#[test]
fn another_kind_of_tables_is_refused_in_words() {
    let recurrent = tables(&model(Feedback::Output, Gate::Both, Gate::Visual, 8));
    let error = Model::<Likelihood>::new_checked(&recurrent).unwrap_err();
    assert_eq!(
        error.to_string(),
        "model is of kind Recurrent, this program was built for kind Likelihood"
    );
    let mut unknown = recurrent.clone();
    unknown[header::KIND] = 77;
    seal(&mut unknown);
    assert_eq!(
        AnyModel::new_checked(&unknown).err(),
        Some(ModelError::UnknownKind { kind: 77 })
    );
    // A kind that is known, with the sections of another.
    unknown[header::KIND] = 1;
    seal(&mut unknown);
    assert!(matches!(
        AnyModel::new_checked(&unknown),
        Err(ModelError::Missing { .. })
    ));
}

/// A model of random numbers of the sizes that trained ones have, with a second memory.
fn model(feedback: Feedback, maps: Gate, rates: Gate, seed: u64) -> RecurrentModel {
    let rng = &mut Pcg64::seed_from_u64(seed);
    let parent = synthetic::model(&Sizes::small(), 2.0, rng);
    let mut model = synthetic::recurrent(parent, OUTPUTS, feedback, maps, rates, rng);
    model.gated = Some(synthetic::second_memory(&model, 9, rng));
    model
}

fn tables(model: &RecurrentModel) -> Vec<u8> {
    export_mge(model, &MgeSettings::default()).unwrap().bytes
}

#[test]
fn a_stream_does_not_depend_on_its_cuts_and_begins_anew_after_its_end() {
    let model = model(Feedback::Output, Gate::Both, Gate::Visual, 8);
    let tables = tables(&model);
    let tables = Tables::new_checked(&tables).unwrap();
    let rng = &mut Pcg64::seed_from_u64(2);
    let sounds: [Vec<i16>; 5] = [
        (0..16000).map(|_| rng.random_range(-3000..3000)).collect(),
        vec![0; 8000],
        vec![32767; 8000],
        (0..8000)
            .map(|n| if n / 40 % 2 == 0 { 32767 } else { -32768 })
            .collect(),
        (0..16000)
            .map(|n| {
                if n < 8000 {
                    0
                } else {
                    rng.random_range(-30000..30000)
                }
            })
            .collect(),
    ];
    let mut stream = Box::new(Stream::new(&tables, StreamSettings::default()));
    for sound in &sounds {
        let mut whole: Option<Vec<ParameterFrame>> = None;
        for cut in [1, 7, 160, 4096] {
            let mut said = Vec::new();
            for piece in sound.chunks(cut) {
                let mut rest = piece;
                while !rest.is_empty() {
                    let (taken, frame) = stream.push(rest);
                    rest = &rest[taken..];
                    said.extend(frame);
                }
            }
            while let Some(frame) = stream.finish() {
                said.push(frame);
            }
            assert_eq!(said.len(), (sound.len() - 400) / 160 + 1);
            match &whole {
                Some(whole) => assert!(*whole == said, "cut every {cut} samples"),
                None => whole = Some(said),
            }
        }
    }
    assert_eq!(stream.delay_samples(), 8 * 160 + 200);
}

/// Crafted tables with a right checksum: either refused, or the stream runs through any sound without a panic (overflow
/// checks are on in test builds).
#[test]
fn crafted_tables_never_panic() {
    let good = tables(&model(Feedback::Output, Gate::Both, Gate::Visual, 9));
    let mut rng = Pcg64::seed_from_u64(6);
    let (mut accepted, mut refused) = (0, 0);
    for round in 0..300 {
        let mut bad = good.clone();
        let body = header::SIZE + n_sections(&bad) * entry::SIZE..bad.len() - CRC_SIZE;
        if round % 3 == 0 {
            // Everything random, or as large as it gets, in one section.
            let range = nth(&bad, rng.random_range(0..n_sections(&bad))).1;
            let extreme = [0x7f, 0x80, 0xff][rng.random_range(0..3)];
            let random = rng.random_bool(0.5);
            for byte in &mut bad[range] {
                *byte = if random { rng.random() } else { extreme };
            }
        } else {
            for _ in 0..rng.random_range(1..200) {
                let at = rng.random_range(body.clone());
                bad[at] = rng.random();
            }
        }
        seal(&mut bad);
        let Ok(tables) = AnyModel::new_checked(&bad) else {
            refused += 1;
            continue;
        };
        accepted += 1;
        let samples: Vec<i16> = (0..4000).map(|_| rng.random()).collect();
        hear_out(&tables, &samples);
    }
    assert!(
        accepted > 20 && refused > 20,
        "{accepted} accepted, {refused} refused"
    );
}

/// Every frame that a stream of this size gives for a sound, and in how many the beam was narrowed.
fn run<'m, const ROOM: usize>(
    tables: &'m Tables<'m>,
    settings: StreamSettings,
    sound: &[i16],
) -> (Vec<ParameterFrame>, u32) {
    let mut stream = Box::new(Stream::<Recurrent, Converter<ROOM>>::sized(tables, settings));
    let mut said = Vec::new();
    let mut rest = sound;
    while !rest.is_empty() {
        let (taken, frame) = stream.push(rest);
        rest = &rest[taken..];
        said.extend(frame);
    }
    said.extend(std::iter::from_fn(|| stream.finish()));
    (said, stream.narrowed())
}

fn rustle(samples: usize) -> Vec<i16> {
    let rng = &mut Pcg64::seed_from_u64(6);
    (0..samples)
        .map(|n| {
            let loud = 200 + 3000 * ((n / 1600) % 3) as i32;
            rng.random_range(-loud..loud) as i16
        })
        .collect()
}

#[test]
fn profiles_wait_as_long_as_they_say_and_are_switched_at_run_time() {
    let model = model(Feedback::Output, Gate::Both, Gate::Visual, 8);
    let tables = tables(&model);
    let tables = Tables::new_checked(&tables).unwrap();
    let sound = rustle(16_000);
    let frames = (sound.len() - 400) / 160 + 1;
    let mut stream = Box::new(Stream::new(&tables, StreamSettings::default()));
    for (profile, hops, most_ms) in [
        (Profile::Studio, 8, f64::INFINITY),
        (Profile::Live, 3, 45.0),
        (Profile::Standard, 6, 80.0),
        (Profile::Live, 3, 45.0),
    ] {
        stream.set(StreamSettings::of(profile));
        assert_eq!(stream.delay_samples(), hops * 160 + 200);
        assert!(stream.delay_samples() as f64 / 16.0 <= most_ms, "{profile:?}");
        let (mut heard, mut said) = (0, Vec::new());
        for piece in sound.chunks(160) {
            let mut rest = piece;
            while !rest.is_empty() {
                let (taken, frame) = stream.push(rest);
                rest = &rest[taken..];
                heard += taken;
                if let Some(frame) = frame {
                    // The last sample that a frame waits for is exactly so far behind its centre.
                    assert_eq!(heard, frame.sample as usize + stream.delay_samples());
                    said.push(frame);
                }
            }
        }
        said.extend(std::iter::from_fn(|| stream.finish()));
        assert_eq!(said.len(), frames, "{profile:?}");
        // The same as a stream that never knew another profile.
        let (anew, _) = run::<384>(&tables, StreamSettings::of(profile), &sound);
        assert!(said == anew, "{profile:?}");
    }
}

#[test]
fn a_stream_of_a_devices_room_gives_the_same_frames() {
    let model = model(Feedback::Output, Gate::Both, Gate::Visual, 8);
    let tables = tables(&model);
    let tables = Tables::new_checked(&tables).unwrap();
    let sound = rustle(16_000);
    for profile in [Profile::Live, Profile::Studio] {
        let large = run::<384>(&tables, StreamSettings::of(profile), &sound);
        let small = run::<TOKENS>(&tables, StreamSettings::of(profile), &sound);
        assert!(large == small, "{profile:?}");
    }
    // What a likelihood-trained model keeps besides (a window of frames, densities' emissions, frames that wait) is not here.
    let (large, small) = (size_of::<Stream<Likelihood>>(), size_of::<Stream<Recurrent>>());
    assert!(2 * small < large, "{small} of {large} bytes");
}

/// Flat emissions keep every state alive: the bounds hold all the same, and say so.
#[test]
fn bounds_narrow_the_beam_and_are_counted() {
    let mut flat = model(Feedback::Output, Gate::Both, Gate::Visual, 8);
    for group in [Group::Audio, Group::AudioBias, Group::Visual, Group::VisualBias] {
        flat.parameters.of_mut(group).fill(0.0);
    }
    let tables = tables(&flat);
    let tables = Tables::new_checked(&tables).unwrap();
    let sound = rustle(8_000);
    let settings = StreamSettings {
        beam: Some(LogProb::from_q12(40 << 12)),
        most: Some(12),
        phones: Some(3),
        ..StreamSettings::default()
    };
    let mut stream = Box::new(Stream::new(&tables, settings));
    let mut rest = &sound[..];
    let (mut frames, mut most) = (0, 0);
    while !rest.is_empty() {
        let (taken, frame) = stream.push(rest);
        rest = &rest[taken..];
        frames += u32::from(frame.is_some());
        most = most.max(stream.active());
    }
    assert_eq!(most, 12);
    assert!(
        stream.narrowed() > frames / 2,
        "{} of {frames}",
        stream.narrowed()
    );
    stream.reset();
    assert_eq!(stream.narrowed(), 0);
    // With room for all of them nothing is held back.
    let roomy = StreamSettings {
        most: Some(u16::MAX),
        phones: Some(u16::MAX),
        ..settings
    };
    assert_eq!(run::<2048>(&tables, roomy, &sound).1, 0);
}
