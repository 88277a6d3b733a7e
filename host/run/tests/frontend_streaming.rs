//! The integer front end as a stream: cutting, finishing, starting anew, normalisation while the level jumps.
mod common;

use common::{hops, sounds};
use lipstream::frontend::{self, config};
use lipstream::reference::{self, Normalisation, normalise};
use lipstream_core::frontend::{FrontEnd, OBSERVATION_DELAY};
use lipstream_core::{FRAME_SAMPLES, HOP_SAMPLES, N_STATIC};

const E: usize = N_STATIC - 1;

/// The mean of the voice at full level.
fn start_mean() -> [f32; N_STATIC] {
    reference::speech_mean([sounds::voice(5.0, 8000.0)]).expect("the voice speaks")
}

fn causal() -> Normalisation {
    Normalisation::Causal {
        start_mean: start_mean(),
    }
}

#[test]
fn cutting_changes_nothing() {
    let voice = sounds::voice(1.3, 8000.0);
    for normalisation in [Normalisation::None, causal()] {
        let whole = hops(&voice, normalisation, voice.len());
        for piece in [1, 7, 160, 4096] {
            assert_eq!(hops(&voice, normalisation, piece), whole, "pieces of {piece}");
        }
    }
}

/// Every length near the borders gives HCopy's number of frames, statics at once and observations four hops later.
#[test]
fn finish_gives_what_the_look_ahead_held_back() {
    let voice = sounds::voice(0.5, 8000.0);
    for frames in 0..=7usize {
        let least = if frames == 0 {
            0
        } else {
            FRAME_SAMPLES + (frames - 1) * HOP_SAMPLES
        };
        let most = FRAME_SAMPLES + frames * HOP_SAMPLES - HOP_SAMPLES.min(FRAME_SAMPLES);
        for length in [
            least,
            if frames == 0 {
                FRAME_SAMPLES - 1
            } else {
                most + HOP_SAMPLES - 1
            },
        ] {
            let samples = &voice[..length];
            assert_eq!(reference::frame_count(length), frames);
            let got = hops(samples, causal(), 50);
            let expected = if frames == 0 {
                0
            } else {
                frames + OBSERVATION_DELAY
            };
            assert_eq!(got.len(), expected, "{length} samples");
            for (t, hop) in got.iter().enumerate() {
                assert_eq!(hop.index as usize, t);
                assert_eq!(hop.statics.is_some(), t < frames, "{length} samples, hop {t}");
                assert_eq!(hop.observation.is_some(), t >= OBSERVATION_DELAY);
            }
            // A hop's statics are the same frame's in its observation.
            for t in 0..frames {
                let late = got[t + OBSERVATION_DELAY].observation.unwrap();
                assert_eq!(late[..N_STATIC], got[t].statics.unwrap());
            }
            let want = reference::observations(samples, causal());
            let fixed = frontend::observations(samples, causal());
            assert_eq!(want.dim(), fixed.dim());
            for (a, b) in want.iter().zip(&fixed) {
                assert!((a - b).abs() < 0.05, "{length} samples: {a} and {b}");
            }
        }
    }
}

#[test]
fn a_new_stream_starts_from_the_beginning() {
    let voice = sounds::voice(0.7, 8000.0);
    let first = hops(&voice, causal(), 160);
    let mut frontend = FrontEnd::new(config(causal()));
    for round in 0..3 {
        let mut again = Vec::new();
        let mut rest = &voice[..];
        while !rest.is_empty() {
            let (taken, hop) = frontend.push(rest);
            again.extend(hop);
            rest = &rest[taken..];
        }
        again.extend(std::iter::from_fn(|| frontend.finish()));
        assert_eq!(frontend.finish(), None);
        assert_eq!(again, first, "round {round}");
        // Once after `finish` alone, once after a stream that was broken off.
        if round == 1 {
            frontend.push(&voice[..300]);
            frontend.reset();
        }
    }
}

/// Mean of normalised E over what the gate lets through, from `from` to `to` seconds.
fn speech_level(samples: &[i16], from: f64, to: f64) -> (f64, f64) {
    let raw = reference::live_statics(samples);
    let float = normalise::causal(raw.view(), &start_mean());
    let fixed = frontend::observations(samples, causal());
    let mut gate = normalise::SpeechGate::default();
    let (mut sums, mut count) = ([0.0; 2], 0.0);
    for t in 0..raw.nrows() {
        let speech = gate.next(raw[[t, E]]);
        let time = t as f64 * 0.01;
        if speech && (from..to).contains(&time) {
            sums[0] += float[[t, E]];
            sums[1] += f64::from(fixed[[t, E]]);
            count += 1.0;
        }
    }
    assert!(count > 20.0, "the gate lets {count} frames through");
    (sums[0] / count, sums[1] / count)
}

/// 20 dB down or up in mid-stream: 4.6 nats at once, and gone within fourteen seconds.
#[test]
fn a_level_jump_is_followed() {
    let loud = sounds::voice(30.0, 12000.0);
    let quiet = common::quieter(&loud, 20.0);
    let jump = 10 * 16_000;
    for (before, after, sign) in [(&loud, &quiet, -1.0), (&quiet, &loud, 1.0)] {
        let samples: Vec<i16> = before[..jump].iter().chain(&after[jump..]).copied().collect();
        let before = speech_level(&samples, 8.0, 10.0);
        let at_once = speech_level(&samples, 11.0, 13.0);
        let settled = speech_level(&samples, 24.0, 30.0);
        println!("before {before:?}, after the jump {at_once:?}, settled {settled:?}");
        for (b, j, s) in [(before.0, at_once.0, settled.0), (before.1, at_once.1, settled.1)] {
            assert!(b.abs() < 1.2, "before: {b}");
            assert!(j * sign > 1.5, "just after: {j}");
            assert!(s.abs() < 0.5, "settled: {s}");
        }
    }
}

/// A minute of silence, hum or hiss after speech leaves the mean where it was, but for the second in which the
/// gate learns that it is steady.
#[test]
fn steady_sounds_do_not_pull_the_mean() {
    let voice = sounds::voice(8.0, 8000.0);
    for (name, steady) in [
        ("digital silence", vec![0; 60 * 16_000]),
        ("hum", sounds::hum(60.0, 3000.0)),
        ("quiet hum", sounds::hum(60.0, 60.0)),
        ("hiss", sounds::hiss(60.0, 400.0)),
        ("faint hiss", sounds::hiss(60.0, 4.0)),
    ] {
        let samples: Vec<i16> = voice.iter().chain(&steady).chain(&voice).copied().collect();
        let raw = reference::live_statics(&samples);
        let normalised = normalise::causal(raw.view(), &start_mean());
        let mean_at = |second: f64| {
            let t = (second * 100.0) as usize;
            (0..N_STATIC)
                .map(|i| raw[[t, i]] - normalised[[t, i]])
                .collect::<Vec<f64>>()
        };
        let (end_of_voice, settled, end) = (mean_at(7.9), mean_at(10.0), mean_at(67.9));
        let distance = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max);
        let moved = distance(&end_of_voice, &settled);
        println!("{name}: moved {moved:.3}, then {:.4}", distance(&settled, &end));
        assert!(moved < 1.5, "{name}: the mean moved by {moved} at first");
        assert!(distance(&settled, &end) < 0.02, "{name}: the mean drifts");
    }
}

/// The integer mean stays with the exact one over minutes.
#[test]
fn the_integer_mean_does_not_wander_off() {
    let voice = sounds::voice(120.0, 6000.0);
    let want = reference::observations(&voice, causal());
    let got = frontend::observations(&voice, causal());
    let last = want.nrows() - 200..want.nrows();
    for t in last {
        for i in 0..N_STATIC {
            let error = (want[[t, i]] - got[[t, i]]).abs();
            assert!(error < 0.06, "frame {t}, number {i}: off by {error}");
        }
    }
}
