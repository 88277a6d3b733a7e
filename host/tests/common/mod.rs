//! What the tests of sound and front end share: the integer path as an array, signal-to-noise ratio, sounds of our own.
#![allow(dead_code)] // each test target uses its part

use std::ops::Range;

use lipstream::audio;
use lipstream::frontend::config;
use lipstream::reference::Normalisation;
use lipstream_core::frontend::{FrontEnd, Hop};
use ndarray::{Array2, s};

pub(crate) mod hcopy;
pub(crate) mod sounds;
pub(crate) mod tables;
pub(crate) mod talker;

/// All hops that `samples` bring when they are pushed `piece` at a time.
pub(crate) fn hops(samples: &[i16], normalisation: Normalisation, piece: usize) -> Vec<Hop> {
    let mut frontend = FrontEnd::new(config(normalisation));
    let mut out = Vec::new();
    for mut rest in samples.chunks(piece) {
        while !rest.is_empty() {
            let (taken, hop) = frontend.push(rest);
            assert!(taken > 0);
            rest = &rest[taken..];
            out.extend(hop);
        }
    }
    out.extend(std::iter::from_fn(|| frontend.finish()));
    out
}

/// 10·log₁₀ of the power of `want` about its column means over the power of the difference, in the given columns.
pub(crate) fn snr_db(want: &Array2<f64>, got: &Array2<f64>, columns: Range<usize>) -> f64 {
    let want = want.slice(s![.., columns.clone()]);
    let got = got.slice(s![.., columns]);
    let mean = want.mean_axis(ndarray::Axis(0)).expect("at least one frame");
    let signal: f64 = (&want - &mean).iter().map(|x| x * x).sum();
    let noise: f64 = (&want - &got).iter().map(|x| x * x).sum();
    10.0 * (signal / noise).log10()
}

/// The same sound `db` quieter, rounded to samples.
pub(crate) fn quieter(samples: &[i16], db: f64) -> Vec<i16> {
    let gain = 10f64.powf(-db / 20.0);
    samples
        .iter()
        .map(|&x| (f64::from(x) * gain).round() as i16)
        .collect()
}

/// The error of bytes that must be refused: one line.
pub(crate) fn refused(name: &str, bytes: &[u8]) -> String {
    let error = match audio::decode(bytes) {
        Ok(sound) => panic!("{name}: read as {} samples", sound.samples.len()),
        Err(error) => format!("{error:#}"),
    };
    assert!(!error.contains('\n') && error.len() > 10, "{name}: {error:?}");
    error
}
