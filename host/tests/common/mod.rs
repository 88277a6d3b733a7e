//! What the front end's tests share: the integer path as an array, signal-to-noise ratio, sounds of our own.
#![allow(dead_code)] // each test target uses its part

use std::ops::Range;

use lipstream_core::frontend::{Config, FrontEnd, Hop};
use lipstream_core::{N_OBSERVATION, N_STATIC};
use ndarray::{Array2, s};

pub(crate) mod sounds;

/// A start mean in Q7.8.
pub(crate) fn q8(mean: [f32; N_STATIC]) -> [i16; N_STATIC] {
    mean.map(|m| (m * 256.0).round() as i16)
}

/// All hops that `samples` bring when they are pushed `piece` at a time.
pub(crate) fn hops(samples: &[i16], start_mean: Option<[f32; N_STATIC]>, piece: usize) -> Vec<Hop> {
    let mut frontend = FrontEnd::new(Config {
        start_mean: q8(start_mean.unwrap_or([0.0; N_STATIC])),
        normalise: start_mean.is_some(),
    });
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

/// Observations of the integer front end in the reference's units, `[frames, 39]`.
pub(crate) fn features_fixed(samples: &[i16], start_mean: Option<[f32; N_STATIC]>) -> Array2<f64> {
    let rows: Vec<[i16; N_OBSERVATION]> = hops(samples, start_mean, samples.len().max(1))
        .into_iter()
        .filter_map(|hop| hop.observation)
        .collect();
    Array2::from_shape_fn((rows.len(), N_OBSERVATION), |(t, i)| {
        f64::from(rows[t][i]) / 256.0
    })
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
