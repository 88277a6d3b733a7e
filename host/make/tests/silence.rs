//! What the shipped model's mouth does where nobody speaks: after speech, in noise, breath, clicks and hum.
//! `cargo test -p lipstream-make --test silence -- --nocapture` prints it (docs/models.md).
use lipstream::engine::stream;
use lipstream::lips::Lips;
use lipstream::mouth::MouthSpace;
use lipstream::tensors::Tensors;
use lipstream_core::{AnyModel, AnyStream, ParameterFrame, StreamSettings};
use lipstream_media::sound;
use ndarray::{Array2, Array4};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const TABLES: &[u8] = include_bytes!("../../../models/grid-s1.tables");
const MODEL: &[u8] = include_bytes!("../../../models/grid-s1.safetensors");
/// Frames of 200 ms.
const SETTLED: usize = 20;

/// The drawn mouth's gap in pixels, and how far its parameters move from frame to frame.
struct Mouth {
    gap: Vec<f32>,
    motion: Vec<f32>,
    closed_below: f32,
}

fn images(space: &MouthSpace, parameters: &Array2<f32>) -> Array4<u8> {
    let mut out = Array4::zeros((parameters.nrows(), space.height, space.width, 3));
    for (mut image, row) in out.outer_iter_mut().zip(parameters.rows()) {
        let pixels = space.expand(row);
        for (to, from) in image.iter_mut().zip(&pixels) {
            *to = from.round().clamp(0.0, 255.0) as u8;
        }
    }
    out
}

/// How far the parameters move from frame to frame.
fn motion(said: &Array2<f32>) -> Vec<f32> {
    (1..said.nrows())
        .map(|t| {
            let step = &said.row(t) - &said.row(t - 1);
            step.dot(&step).sqrt()
        })
        .collect()
}

/// `sound` through the device's stream.
fn say(sound: &[i16], settings: StreamSettings) -> Array2<f32> {
    let tables = AnyModel::new_checked(TABLES).unwrap();
    stream(&tables, sound, settings).unwrap().parameters
}

/// `sound` through the device's stream, drawn; lips are learnt on the mouths of [`speech`].
fn watch(sound: &[i16]) -> Mouth {
    let tensors = Tensors::parse(MODEL, "the shipped model").unwrap();
    let space = MouthSpace::load(&tensors).unwrap();
    let said_in_speech = say(&speech(), StreamSettings::default());
    let lips = Lips::learn(images(&space, &said_in_speech).view()).expect("lips in the drawn mouth");
    let said = say(sound, StreamSettings::default());
    Mouth {
        gap: lips
            .gaps(images(&space, &said).view())
            .expect("lips in every picture"),
        motion: motion(&said),
        closed_below: lips.closed_below(),
    }
}

fn speech() -> Vec<i16> {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/hello.wav");
    sound::read(&path).unwrap().samples
}

fn mean(values: &[f32]) -> f32 {
    values.iter().sum::<f32>() / values.len() as f32
}

fn noise(samples: usize, amplitude: f32, rng: &mut Pcg64) -> Vec<i16> {
    (0..samples)
        .map(|_| (amplitude * rng.random_range(-1.0f32..1.0)) as i16)
        .collect()
}

/// Sounds of two seconds that are no speech, and the share of speech's motion that the mouth may keep in them.
fn no_speech(rng: &mut Pcg64) -> [(&'static str, Vec<i16>, f32); 6] {
    const LENGTH: usize = 32_000;
    let tau = |hz: f32, n: usize| (std::f32::consts::TAU * hz * n as f32 / 16_000.0).sin();
    let breath = (0..LENGTH)
        .scan(0.0f32, |low, n| {
            let swell = tau(0.5, n).abs();
            *low += 0.3 * (rng.random_range(-1.0f32..1.0) - *low);
            Some((300.0 * swell * *low) as i16)
        })
        .collect();
    let click = |n: usize| {
        if n % 8_000 < 10 {
            6_000 - 600 * (n % 8_000) as i16
        } else {
            0
        }
    };
    [
        ("digital silence", vec![0; LENGTH], 0.06),
        ("quiet hiss", noise(LENGTH, 30.0, rng), 0.15),
        ("loud hiss", noise(LENGTH, 1_000.0, rng), 0.15),
        ("breath", breath, 0.2),
        ("clicks", (0..LENGTH).map(click).collect(), 0.35),
        (
            "hum of 50 and 150 Hz",
            (0..LENGTH)
                .map(|n| (500.0 * tau(50.0, n) + 250.0 * tau(150.0, n)) as i16)
                .collect(),
            0.1,
        ),
    ]
}

#[test]
fn the_mouth_opens_in_speech() {
    let mouth = watch(&speech());
    let open = mouth.gap.iter().filter(|g| **g > mouth.closed_below).count();
    assert!(open > mouth.gap.len() / 2, "{open} of {} frames", mouth.gap.len());
}

/// Closed in every frame, and nearly still, from 200 ms after the last word on; also where nobody has spoken yet.
#[test]
fn the_mouth_stays_closed_where_nobody_speaks() {
    let rng = &mut Pcg64::seed_from_u64(5);
    let speech = speech();
    let talking = mean(&watch(&speech).motion);
    println!(
        "where the mouth is from 200 ms on: widest gap as a share of what counts as open, motion as a share of speech's, unsettled"
    );
    let mut wrong = Vec::new();
    for (name, sound, share) in no_speech(rng) {
        for before in [&speech[..], &[]] {
            let mouth = watch(&[before, &sound].concat());
            let from = before.len() / 160 + SETTLED;
            let widest = mouth.gap[from..].iter().fold(0.0f32, |m, g| m.max(*g));
            let moved = mean(&mouth.motion[from..]) / talking;
            let when = if before.is_empty() {
                "alone"
            } else {
                "after speech"
            };
            let unsettled = StreamSettings {
                settle: Some(false),
                ..StreamSettings::default()
            };
            let unsettled = motion(&say(&[before, &sound].concat(), unsettled));
            println!(
                "{name} {when}: {:.2} {moved:.3} {:.3}",
                widest / mouth.closed_below,
                mean(&unsettled[from..]) / talking
            );
            if widest >= mouth.closed_below {
                wrong.push(format!(
                    "{name} {when}: a gap of {widest} px, closed is below {}",
                    mouth.closed_below
                ));
            }
            if moved >= share {
                wrong.push(format!("{name} {when}: {moved} of the motion in speech"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("; "));
}

/// Ten minutes of noise whose level jumps: a frame each 10 ms to the end, and a stream that is as new after `reset`.
#[test]
fn ten_minutes_of_noise_leave_a_stream_as_good_as_new() {
    let tables = AnyModel::new_checked(TABLES).unwrap();
    let speech = speech();
    let run = |stream: &mut AnyStream, samples: &[i16]| -> Vec<ParameterFrame> {
        let (mut rest, mut said) = (samples, Vec::new());
        while !rest.is_empty() {
            let (taken, frame) = stream.push(rest);
            rest = &rest[taken..];
            said.extend(frame);
        }
        said
    };
    let mut stream = Box::new(AnyStream::new(&tables, StreamSettings::default()));
    let fresh = run(&mut stream, &speech);
    stream.reset();
    let rng = &mut Pcg64::seed_from_u64(9);
    let mut frames = 0;
    for second in 0..600 {
        let level = [30.0, 3_000.0, 40_000.0, 0.5][second % 4];
        frames += run(&mut stream, &noise(16_000, level, rng)).len();
    }
    let waiting = (stream.delay_samples() - 200) / 160;
    assert_eq!(frames, (600 * 16_000 - 400) / 160 + 1 - waiting);
    stream.reset();
    assert!(run(&mut stream, &speech) == fresh);
}
