//! The integer front end against its `f64` twin: speech-like sound of our own, quiet and loud, and sounds that break
//! front ends. Every number asserted here stands in `docs/frontend.md`.
mod common;

use common::{snr_db, sounds};
use lipstream::frontend;
use lipstream::reference::{self, Normalisation};
use lipstream_core::N_CEPSTRA;

#[test]
fn voice_is_accurate_at_every_level() {
    for (attenuation_db, least_db) in [(0, 55.0), (20, 50.0), (40, 40.0)] {
        let voice = common::quieter(&sounds::voice(3.0, 8000.0), f64::from(attenuation_db));
        let want = reference::statics(&voice);
        let got = frontend::observations(&voice, Normalisation::None).mapv(f64::from);
        let cepstra = snr_db(&want, &got, 0..N_CEPSTRA);
        println!("−{attenuation_db} dB: {cepstra:.1} dB");
        assert!(cepstra >= least_db, "−{attenuation_db} dB: {cepstra:.1} dB");
    }
}

/// Largest error of c1..c12 and of E on each sound; the cepstra's dynamic range is about ±60.
#[test]
fn difficult_sounds_stay_close() {
    for (name, samples, worst_cepstrum) in sounds::difficult() {
        let want = reference::statics(&samples);
        let got = frontend::observations(&samples, Normalisation::None).mapv(f64::from);
        assert_eq!(want.nrows(), got.nrows(), "{name}");
        let mut worst = [0f64; 2];
        for t in 0..want.nrows() {
            for i in 0..=N_CEPSTRA {
                let error = (want[[t, i]].clamp(-128.0, 127.996) - got[[t, i]]).abs();
                let of = &mut worst[usize::from(i == N_CEPSTRA)];
                *of = of.max(error);
            }
        }
        println!("{name}: cepstra {:.4}, energy {:.4}", worst[0], worst[1]);
        assert!(worst[0] <= worst_cepstrum, "{name}: cepstrum off by {}", worst[0]);
        assert!(worst[1] <= 0.0022, "{name}: energy off by {}", worst[1]);
    }
}

#[test]
fn all_39_numbers_follow_the_twin() {
    let voice = sounds::voice(3.0, 8000.0);
    let start_mean = [
        3.0, -2.0, 1.0, 0.0, -1.0, 0.5, 0.0, 0.0, 0.0, 0.25, 0.0, -4.0, 16.0,
    ];
    for normalisation in [Normalisation::None, Normalisation::Causal { start_mean }] {
        let want = reference::observations(&voice, normalisation).mapv(f64::from);
        let got = frontend::observations(&voice, normalisation).mapv(f64::from);
        assert_eq!(want.dim(), (got.nrows(), 39));
        for (name, columns, least_db) in [
            ("statics", 0..12, 50.0),
            ("Δ", 13..25, 45.0),
            ("ΔΔ", 26..38, 40.0),
        ] {
            let snr = snr_db(&want, &got, columns);
            println!("{name}: {snr:.1} dB");
            assert!(snr >= least_db, "{name}: {snr:.1} dB");
        }
    }
}

/// c1..c12 of a voice stay within ±60 at any level; Q7.8 has room for full-scale pure tones, the farthest of sounds, too.
#[test]
fn cepstra_stay_in_range() {
    let mut largest = 0f64;
    for attenuation_db in [0, 20, 40, 60] {
        let voice = common::quieter(&sounds::voice(3.0, 32000.0), f64::from(attenuation_db));
        let statics = reference::statics(&voice);
        let cepstra = statics.slice(ndarray::s![.., ..N_CEPSTRA]);
        largest = cepstra.iter().fold(largest, |a, c| a.max(c.abs()));
    }
    println!("voice: {largest:.1}");
    assert!(largest <= 60.0, "{largest}");

    let mut farthest = 0f64;
    for step in 0..400 {
        let hz = 20.0 * f64::from(step);
        let angle = |n: usize| std::f64::consts::TAU * hz * n as f64 / 16_000.0;
        let tone: Vec<i16> = (0..400).map(|n| (32767.0 * angle(n).cos()) as i16).collect();
        let want = reference::statics(&tone);
        let got = frontend::observations(&tone, Normalisation::None);
        for i in 0..N_CEPSTRA {
            let error = (f64::from(got[[0, i]]) - want[[0, i]]).abs();
            assert!(error < 0.1, "{hz} Hz, c{}: off by {error}", i + 1);
            farthest = farthest.max(want[[0, i]].abs());
        }
    }
    println!("tones: {farthest:.1}");
    assert!(farthest < 127.0, "{farthest}");
}
