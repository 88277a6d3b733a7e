//! Tables of a local linear model: quantised densities, the projection of the context, the maps.
use std::f64::consts::{LOG2_E, PI};

use lipstream_core::context::tables::{MAX_INPUTS, MAX_TAPS};
use lipstream_core::frame::MAX_PARAMETERS;
use lipstream_core::hmm::transition::{MAX_PHONES, N_VISUAL_STATES};
use lipstream_core::kinds::likelihood::tables::*;
use lipstream_core::logmath::FRACTION_BITS;
use lipstream_core::model::Section;
use ndarray::Axis;

use super::tables::{Errors, SumRows, Tables, beam};
use super::{ExportError, ExportSettings, Result};
use crate::error::{bail, ensure};
use crate::hmm::mixtures::Mixtures;
use crate::kinds::likelihood::Model;
use crate::kinds::likelihood::inversion::centres;

/// Empty tables for a model of these sizes.
pub(super) fn begin(model: &Model) -> Result<Tables> {
    Tables::new(&[
        ("phones", model.phones.len(), MAX_PHONES),
        ("densities a state", model.audio.mean.dim().1, MAX_DENSITIES),
        (
            "densities a visual state",
            model.visual.mean.dim().1,
            MAX_DENSITIES,
        ),
        ("context taps", model.context.taps.len(), MAX_TAPS),
        ("projected inputs", model.context.projection.nrows(), MAX_INPUTS),
        ("visual parameters", model.visual_size(), MAX_PARAMETERS),
    ])
}

impl Tables {
    pub(super) fn put_likelihood_settings(
        &mut self,
        with: &ExportSettings,
        distance_gain: u32,
        visual_distance_gain: u32,
    ) -> Result<()> {
        ensure!(
            with.lag <= 1000,
            ExportError::Setting,
            "a lag of {} hops is too long",
            with.lag
        );
        let scale = with.acoustic_scale * 65536.0;
        ensure!(
            (0.0..=f64::from(MAX_ACOUSTIC_SCALE)).contains(&scale),
            ExportError::Setting,
            "an acoustic scale of {} is out of range",
            with.acoustic_scale
        );
        let own = OwnSettings {
            lag: with.lag,
            average: with.average,
            beam: beam(with.beam_bits)?,
            acoustic_scale: scale.round() as u32,
            distance_gain,
            visual_distance_gain,
        };
        let mut bytes = Vec::new();
        put_settings(&mut bytes, &own);
        self.put(SETTINGS, bytes, None);
        Ok(())
    }

    /// The densities of the sound; gives the gain on their squared distances.
    pub(super) fn put_audio_densities(&mut self, audio: &Mixtures) -> Result<u32> {
        self.put_densities(
            audio,
            [OBSERVATION_CENTRE, OBSERVATION_GAIN, DENSITIES, DENSITY_CONSTANTS],
        )
    }

    /// The densities of the mouth and the centres of its states; gives the gain on their squared distances.
    pub(super) fn put_visual_densities(&mut self, model: &Model) -> Result<u32> {
        let scales = parameter_scales(model);
        // As a table of observations: an LSB is 1/256.
        let mut scaled = model.visual.clone();
        for ((_, _, d), mean) in scaled.mean.indexed_iter_mut() {
            *mean /= 256.0 * scales[d];
        }
        for ((_, _, d), variance) in scaled.variance.indexed_iter_mut() {
            *variance /= (256.0 * scales[d]).powi(2);
        }
        let mut errors = Errors::new("deviation");
        let mut bytes = Vec::new();
        for row in centres(&model.visual).rows() {
            let quantised = row.iter().zip(&scales).map(|(centre, scale)| {
                let value = f64::from(centre / scale);
                let q = errors.round(value, 32767.0);
                errors.add((q - value) / DEVIATION_LSB);
                q as i16
            });
            put_visual_centre(&mut bytes, quantised);
        }
        self.put(VISUAL_CENTRES, bytes, errors.report());
        self.put_densities(
            &scaled,
            [
                PARAMETER_CENTRE,
                PARAMETER_GAIN,
                VISUAL_DENSITIES,
                VISUAL_DENSITY_CONSTANTS,
            ],
        )
    }

    /// Means in i8 steps and inverse deviations in u8 steps of mixtures over numbers whose LSB is 1/256, into sections for centre,
    /// gain, densities and constants; gives the gain on squared distances.
    ///
    /// A dimension's mean step is the larger of what its means' range needs (range/254) and [`FINEST_STEP`] of its
    /// smallest deviation, so that quiet dimensions (Δ, ΔΔ) leave no steps of the inverse deviation unused. One
    /// step ω of the inverse deviation, in mean steps, serves all dimensions.
    fn put_densities(&mut self, mixtures: &Mixtures, into: [Section; 4]) -> Result<u32> {
        let what = into[2];
        let used: Vec<(usize, usize)> = mixtures
            .log_weight
            .indexed_iter()
            .filter(|(_, w)| is_used(**w))
            .map(|(at, _)| at)
            .collect();
        ensure!(
            !used.is_empty(),
            ExportError::Number,
            "the model has no density for {}",
            what.name
        );
        let size = mixtures.mean.dim().2;
        let mut centre = vec![0f64; size];
        let mut step = vec![0f64; size];
        let mut omega = 0f64;
        for d in 0..size {
            let (mut low, mut high, mut narrow) = (f64::MAX, f64::MIN, f64::MAX);
            for &(s, k) in &used {
                let mean = f64::from(mixtures.mean[[s, k, d]]);
                (low, high) = (low.min(mean), high.max(mean));
                narrow = narrow.min(f64::from(mixtures.variance[[s, k, d]]).sqrt());
            }
            centre[d] = ((low + high) / 2.0 * 256.0).round() / 256.0;
            step[d] = ((high - low) / 2.0 / 126.0).max(FINEST_STEP * narrow);
            // The gain below must fit, and be precise enough: an observation's LSB is 1/256.
            step[d] = step[d].max(1.0 / 4096.0);
            omega = omega.max(step[d] / narrow / 255.0);
        }
        // A step of the difference is 1/16 mean step; the product is shifted down before squaring.
        let unit = f64::from(1 << DISTANCE_SHIFT) / f64::from(1 << MEAN_SHIFT) * omega;
        let gain = 0.5 * LOG2_E * unit * unit * f64::from(1 << FRACTION_BITS) * f64::from(1 << 20);
        if gain > f64::from(MAX_DISTANCE_GAIN) {
            bail!(
                ExportError::Number,
                "the variances of {} differ too much for the device's tables",
                what.name
            );
        }
        let gains: Vec<u32> = step
            .iter()
            .map(|s| (65536.0 * f64::from(1 << MEAN_SHIFT) / 256.0 / s).round() as u32)
            .collect();
        ensure!(
            gains.iter().all(|g| (1..=MAX_GAIN).contains(g)),
            ExportError::Number,
            "a variance of {} is too small or too large for the device's tables",
            what.name
        );
        ensure!(
            centre.iter().all(|c| c.abs() < 128.0),
            ExportError::Number,
            "a mean of {} is outside the range of the device's tables",
            what.name
        );
        let (mut centres, mut gain_bytes) = (Vec::new(), Vec::new());
        for (c, g) in centre.iter().zip(gains) {
            put_scaling(&mut centres, &mut gain_bytes, (c * 256.0) as i16, g);
        }
        self.put(into[0], centres, None);
        self.put(into[1], gain_bytes, None);
        self.put_density_tables(mixtures, &centre, &step, omega, [into[2], into[3]])?;
        Ok(gain.round() as u32)
    }

    fn put_density_tables(
        &mut self,
        mixtures: &Mixtures,
        centre: &[f64],
        step: &[f64],
        omega: f64,
        into: [Section; 2],
    ) -> Result<()> {
        let mut errors = Errors::new("deviation (means)");
        let mut bytes = Vec::new();
        let mut constants = Vec::new();
        for ((s, k), log_weight) in mixtures.log_weight.indexed_iter() {
            let mut constant = f64::from(*log_weight) * LOG2_E;
            let used = is_used(*log_weight);
            let mut means = Vec::with_capacity(step.len());
            let mut inverses = Vec::with_capacity(step.len());
            for d in 0..step.len() {
                let mean = f64::from(mixtures.mean[[s, k, d]]);
                let deviation = f64::from(mixtures.variance[[s, k, d]]).sqrt();
                let q = if used {
                    errors.round((mean - centre[d]) / step[d], 127.0)
                } else {
                    0.0
                };
                let inverse = (step[d] / deviation / omega).round().clamp(1.0, 255.0);
                // The normaliser of the density as the device sees it, so that it still integrates to one.
                constant += (inverse * omega / step[d]).log2() - 0.5 * (2.0 * PI).log2();
                if used {
                    errors.add((centre[d] + q * step[d] - mean) / deviation);
                }
                means.push(q as i8);
                inverses.push(inverse as u8);
            }
            let constant = if used {
                let q = (constant * f64::from(1 << FRACTION_BITS)).round();
                ensure!(
                    q.abs() <= f64::from(MAX_CONSTANT),
                    ExportError::Number,
                    "a weight or variance of {} is out of range",
                    into[0].name
                );
                q as i32
            } else {
                NO_DENSITY
            };
            put_density(&mut bytes, &mut constants, means, inverses, constant);
        }
        self.put(into[0], bytes, errors.report());
        self.put(into[1], constants, None);
        Ok(())
    }

    pub(super) fn put_projection(&mut self, model: &Model) -> Result<()> {
        let context = &model.context;
        self.put_taps(&context.taps)?;
        let mut rows = SumRows::new("relative to a row's largest");
        for row in context.projection.rows() {
            // Σ over Q7.8 statics to x in Q5.11.
            let weights: Vec<f64> = row.iter().map(|w| f64::from(*w)).collect();
            let offset: f64 = weights
                .iter()
                .zip(&context.mean)
                .map(|(w, m)| w * f64::from(*m))
                .sum();
            rows.push(
                &weights,
                f64::from(1 << INPUT_FRACTION_BITS) / 256.0,
                offset * f64::from(1 << INPUT_FRACTION_BITS),
            )?;
        }
        rows.store_projection(self);
        Ok(())
    }

    pub(super) fn put_maps(&mut self, model: &Model) -> Result<()> {
        let maps = &model.maps;
        let (d, x) = (model.visual_size(), model.context.projection.nrows());
        let scale = parameter_scales(model);
        self.put_mouth(scale.iter().copied());
        let mut rows = SumRows::new("relative to a row's largest");
        for (row, scale) in maps.global.rows().into_iter().zip(&scale) {
            let fine = f64::from(1 << SUM_FRACTION_BITS) / f64::from(*scale);
            let weights: Vec<f64> = row.iter().take(x).map(|w| f64::from(*w)).collect();
            rows.push(
                &weights,
                fine / f64::from(1 << INPUT_FRACTION_BITS),
                f64::from(row[x]) * fine,
            )?;
        }
        rows.store(self, [GLOBAL_MAP, GLOBAL_SHIFT, GLOBAL_BIAS]);
        let (mut weights, mut scales, mut biases) = (Vec::new(), Vec::new(), Vec::new());
        let mut weight_errors = Errors::new("deviation per unit of x");
        let mut bias_errors = Errors::new("deviation");
        debug_assert_eq!(maps.state.dim(), (N_VISUAL_STATES, d, x + 1));
        for map in maps.state.axis_iter(Axis(0)) {
            for (row, scale) in map.rows().into_iter().zip(&scale) {
                let lsb = f64::from(*scale);
                let largest = row
                    .iter()
                    .take(x)
                    .fold(0f64, |m, w| m.max(f64::from(w.abs()) / lsb));
                let row_scale = (largest / 127.0 * 256.0).ceil().clamp(1.0, 65535.0);
                let codes = row.iter().take(x).map(|w| {
                    let value = f64::from(*w) / lsb;
                    let q = weight_errors.round(value / (row_scale / 256.0), 127.0);
                    weight_errors.add((q * row_scale / 256.0 - value) / DEVIATION_LSB);
                    q as i8
                });
                let bias = f64::from(row[x]) / lsb;
                let q = bias_errors.round(bias, 32767.0);
                bias_errors.add((q - bias) / DEVIATION_LSB);
                put_state_row(
                    [&mut weights, &mut scales, &mut biases],
                    codes,
                    row_scale as u16,
                    q as i16,
                );
            }
        }
        self.put(STATE_MAPS, weights, weight_errors.report());
        self.put(STATE_SCALE, scales, None);
        self.put(STATE_BIAS, biases, bias_errors.report());
        Ok(())
    }
}

/// Whether a density of this log weight is one.
fn is_used(log_weight: f32) -> bool {
    log_weight > Mixtures::NO_WEIGHT / 10.0
}

/// Finest mean step, in the smallest deviation of its dimension.
const FINEST_STEP: f64 = 0.08;

/// Parameter LSBs in one standard deviation of a parameter: values reach ±16 deviations.
const DEVIATION_LSB: f64 = 32767.0 / 16.0;

/// Real units of one LSB of each parameter: 1/2048 of its standard deviation over the visual states' mixtures.
fn parameter_scales(model: &Model) -> Vec<f32> {
    let visual = &model.visual;
    (0..model.visual_size())
        .map(|d| {
            let (mut weight, mut mean, mut square) = (0.0, 0.0, 0.0);
            for ((s, k), log_weight) in visual.log_weight.indexed_iter() {
                let w = f64::from(*log_weight).exp();
                let m = f64::from(visual.mean[[s, k, d]]);
                weight += w;
                mean += w * m;
                square += w * (m * m + f64::from(visual.variance[[s, k, d]]));
            }
            let weight = weight.max(f64::MIN_POSITIVE);
            let variance = square / weight - (mean / weight) * (mean / weight);
            // The maps may reach further than the mixtures say: the bias at least must fit four times.
            let bias = f64::from(model.maps.global[[d, model.context.projection.nrows()]].abs());
            let scale = variance.max(0.0).sqrt().max(bias / 4.0).max(1e-20) / DEVIATION_LSB;
            scale as f32
        })
        .collect()
}
