//! What the integer front end of `lipstream_core` computes, as arrays.
use lipstream_core::frontend::{Config, FrontEnd};
use lipstream_core::{N_OBSERVATION, N_STATIC};
use ndarray::Array2;

use crate::reference::Normalisation;

/// Value of one LSB of Q7.8.
pub const LSB: f32 = 1.0 / 256.0;

/// A start mean in the front end's Q7.8, saturating.
pub fn start_mean_q8(mean: &[f32; N_STATIC]) -> [i16; N_STATIC] {
    mean.map(|m| (m / LSB).round() as i16) // `as` saturates
}

/// The front end's configuration that does what `normalisation` says.
pub fn config(normalisation: Normalisation) -> Config {
    match normalisation {
        Normalisation::None => Config {
            start_mean: [0; N_STATIC],
            normalise: false,
        },
        Normalisation::Causal { start_mean } => Config {
            start_mean: start_mean_q8(&start_mean),
            normalise: true,
        },
    }
}

/// Statics, Δ and ΔΔ of a whole sound in the units of `reference::observations`, `[frames, 39]`.
pub fn observations(samples: &[i16], normalisation: Normalisation) -> Array2<f32> {
    let mut frontend = FrontEnd::new(config(normalisation));
    let mut values = Vec::new();
    let mut rest = samples;
    while !rest.is_empty() {
        let (taken, hop) = frontend.push(rest);
        rest = &rest[taken..];
        values.extend(hop.and_then(|hop| hop.observation).into_iter().flatten());
    }
    while let Some(hop) = frontend.finish() {
        values.extend(hop.observation.into_iter().flatten());
    }
    let frames = values.len() / N_OBSERVATION;
    let values = values.into_iter().map(|v| f32::from(v) * LSB).collect();
    Array2::from_shape_vec((frames, N_OBSERVATION), values).expect("whole frames")
}
