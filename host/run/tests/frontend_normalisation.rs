//! What `docs/frontend.md` and `core/src/frontend/normalise.rs` say of the causal mean: gate, time constant, causality, error.
mod common;

use common::sounds;
use lipstream::reference::{self, Normalisation, normalise};
use lipstream_core::N_STATIC;
use lipstream_core::frontend::floor::LEVEL;
use lipstream_core::frontend::normalise::Normaliser;
use rand::SeedableRng as _;

const E: usize = N_STATIC - 1;

/// Which frames the gate calls speech.
fn speech(samples: &[i16]) -> Vec<bool> {
    let mut gate = normalise::SpeechGate::default();
    let raw = reference::live_statics(samples);
    raw.column(E).iter().map(|&e| gate.next(e)).collect()
}

/// 256 frames of speech, to 1/e, are seven seconds of the synthetic voice, more than half of which is pauses.
#[test]
fn the_time_constant_is_256_frames_of_speech() {
    let voice = sounds::voice(20.0, 8000.0);
    let raw = reference::live_statics(&voice);
    let open = speech(&voice);
    // Two streams that start 8 apart in every number approach each other frame by frame of speech.
    let far = normalise::causal(raw.view(), &[8.0; N_STATIC]);
    let near = normalise::causal(raw.view(), &[0.0; N_STATIC]);
    let mut frames_of_speech = 0;
    let mut at_one_e = None;
    for t in 0..raw.nrows() {
        frames_of_speech += i32::from(open[t]);
        let expected = 8.0 * (255.0f64 / 256.0).powi(frames_of_speech);
        for i in 0..N_STATIC {
            let apart = near[[t, i]] - far[[t, i]];
            assert!(
                (apart - expected).abs() < 1e-9,
                "frame {t}: {apart}, not {expected}"
            );
        }
        if at_one_e.is_none() && expected < 8.0 / std::f64::consts::E {
            at_one_e = Some(t as f64 * 0.01);
        }
    }
    let seconds = at_one_e.expect("twenty seconds are enough");
    println!("to 1/e after {seconds} s of talk");
    assert!((6.0..8.0).contains(&seconds), "to 1/e after {seconds} s");
}

/// After 20 dB up the gate opens at once, that is with the first syllable; after 20 dB down within two seconds.
#[test]
fn the_gate_opens_again_after_a_jump() {
    let loud = sounds::voice(30.0, 12000.0);
    let quiet = common::quieter(&loud, 20.0);
    let steady = speech(&loud);
    for second in 8..20 {
        let jump = second * 16_000;
        let first = second * 100;
        let first_open = |open: &[bool]| (first..open.len()).find(|&t| open[t]).expect("it opens") - first;
        let up = [&quiet[..jump], &loud[jump..]].concat();
        let down = [&loud[..jump], &quiet[jump..]].concat();
        let (up, down, without) = (
            first_open(&speech(&up)),
            first_open(&speech(&down)),
            first_open(&steady),
        );
        println!(
            "jump at {second} s: opens {up} frames after 20 dB up, {down} after 20 dB down, {without} after none"
        );
        assert!(
            up <= without + 1,
            "{up} frames after a jump up, {without} after none"
        );
        assert!(down <= 200, "{down} frames after a jump down");
    }
}

/// Frames up to t do not know what comes after t.
#[test]
fn the_mean_knows_no_future() {
    let voice = sounds::voice(6.0, 8000.0);
    let mut other = voice.clone();
    let cut = 3 * 16_000;
    other[cut..].iter_mut().for_each(|x| *x /= 7);
    let causal = Normalisation::Causal {
        start_mean: [0.0; N_STATIC],
    };
    let frames = reference::frame_count(cut);
    for observe in [reference::observations, lipstream::frontend::observations] {
        let (one, two) = (observe(&voice, causal), observe(&other, causal));
        let statics = |a: &ndarray::Array2<f32>| a.slice(ndarray::s![..frames, ..N_STATIC]).to_owned();
        assert_eq!(statics(&one), statics(&two));
        assert_ne!(one, two);
    }
}

/// The integer mean against exact arithmetic over two minutes of the same statics: 0.001, besides half an LSB of the output.
#[test]
fn the_integer_mean_is_exact_to_a_thousandth() {
    let voice = sounds::voice(120.0, 6000.0);
    let statics = lipstream::frontend::observations(&voice, Normalisation::None);
    let raw = statics.slice(ndarray::s![.., ..N_STATIC]).mapv(f64::from);
    let want = normalise::causal(raw.view(), &[0.0; N_STATIC]);
    let mut normaliser = Normaliser::new(&[0; N_STATIC]);
    let mut worst = 0f64;
    for (row, want) in raw.outer_iter().zip(want.outer_iter()) {
        let frame = std::array::from_fn(|i| (row[i] * 256.0) as i16);
        for (got, want) in normaliser.next(&frame).iter().zip(want) {
            worst = worst.max((f64::from(*got) / 256.0 - want).abs());
        }
    }
    println!("off by {worst:.5} at most");
    assert!(worst <= 0.5 / 256.0 + 0.001, "off by {worst}");
}

/// The zero of a sound is taken off within a rounding of real numbers, wherever it lies and however the sound is cut; a voice keeps
/// its level, and what is silence but for its zero becomes digital silence.
#[test]
fn the_zero_of_the_sound_is_found() {
    let voice = sounds::voice(2.0, 8000.0);
    let shifted = |by: i16| -> Vec<i16> { voice.iter().map(|x| x.saturating_add(by)).collect() };
    for by in [0, 98, -3000] {
        let samples = shifted(by);
        let got = reference::without_offset(&samples);
        let mut zero = f64::from(samples[0]);
        for (n, (x, y)) in samples.iter().zip(&got).enumerate() {
            zero += (f64::from(*x) - zero) / 128.0;
            let error = f64::from(*x) - zero - f64::from(*y);
            assert!(error.abs() <= 1.0, "offset {by}, sample {n}: off by {error}");
        }
        let at_once = reference::without_offset(&voice);
        let apart = got.iter().zip(&at_once).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(apart <= Some(1), "offset {by} is heard: {apart:?}");
    }
    let power = |samples: &[i16]| samples.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>();
    let kept_db = 10.0 * (power(&reference::without_offset(&voice)) / power(&voice)).log10();
    assert!(kept_db.abs() < 0.5, "the voice changes by {kept_db} dB");
    assert!(reference::without_offset(&[98; 4000]).iter().all(|y| *y == 0));
    // A step into silence with an offset is over within the window that holds it and the four behind it.
    let step: Vec<i16> = [0; 4000].into_iter().chain([98; 4000]).collect();
    assert!(reference::without_offset(&step)[5000..].iter().all(|y| *y == 0));
}

/// The floor is the mean of what white noise of its level brings to each channel and to the energy: digital silence is heard as that noise is in HTK's numbers,
/// and noise 30 dB louder hardly hears it.
#[test]
fn digital_silence_is_a_quiet_room() {
    let mut rng = rand_pcg::Pcg64::seed_from_u64(4);
    let mut hiss = |level: f64| -> Vec<i16> {
        (0..160_000)
            .map(|_| (level * lipstream::random::normal_f64(&mut rng)).round() as i16)
            .collect()
    };
    let mean = |raw: ndarray::Array2<f64>| raw.mean_axis(ndarray::Axis(0)).expect("frames");
    let room = mean(reference::statics(&hiss(LEVEL as f64)));
    let silence = mean(reference::live_statics(&[0; 16_000]));
    for (i, (a, b)) in room.iter().zip(&silence).enumerate() {
        // Logarithms of single windows lie below that of their mean, alike in all channels.
        assert!((a - b).abs() < 0.5, "static {i}: {a} in the room, {b} in silence");
    }
    let loud = hiss(30.0 * LEVEL as f64);
    let apart = mean(reference::live_statics(&loud)) - mean(reference::statics(&loud));
    assert!(apart.iter().all(|d| d.abs() < 0.2), "{apart}");
}
