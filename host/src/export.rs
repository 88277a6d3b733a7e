//! The float model quantised into the device's tables, and how much was lost on the way.
//!
//! The layout of the tables is [`lipstream_core::model::field`]; equal models give equal bytes.
use std::f64::consts::{LN_2, LOG2_E, PI};

use anyhow::{Result, bail, ensure};
use lipstream_core::hmm::transition::{N_CHOICES, N_CLASSES};
use lipstream_core::logmath::{FRACTION_BITS, NEVER_I16, TABLE_FRACTION_BITS};
use lipstream_core::model::field::{
    ALIGNMENT, CRC_SIZE, DISTANCE_SHIFT, FORMAT_VERSION, FRONT_END_FINGERPRINT, INPUT_FRACTION_BITS, MAGIC,
    MEAN_SHIFT, N_SECTIONS, N_VISUAL_STATES, NAME_SIZE, NO_DENSITY, SUM_FRACTION_BITS, Section, Shape,
    checksum, entry, header, limit, settings, shape,
};
use lipstream_core::{N_OBSERVATION, N_STATIC};
use ndarray::Axis;
use serde::Serialize;

use crate::hmm::system::System;
use crate::model::{Mixtures, Model};
use crate::phones::VISEMES;

/// Run-time settings that go into the tables.
#[derive(Clone, Copy, Debug)]
pub struct ExportSettings {
    /// Hops of fixed-lag smoothing.
    pub lag: u16,
    /// Beam width in bits.
    pub beam_bits: f64,
    /// Exponent on the audio likelihood.
    pub acoustic_scale: f64,
    /// Three-frame moving average (X&L section 6).
    pub average: bool,
}

/// Width of the beam where nobody says otherwise, bits. On 400 training clips of GRID talker 1, 16 bits lose the thread now and
/// then and cost 2.6 % AMSE against no beam, 20 bits 0.3 %, 24 bits 0.2 %.
pub const DEFAULT_BEAM_BITS: f64 = 24.0;

impl ExportSettings {
    /// What the model asks for.
    pub fn of(model: &Model) -> Self {
        Self {
            lag: u16::try_from(model.following.lag).unwrap_or(u16::MAX),
            beam_bits: DEFAULT_BEAM_BITS,
            acoustic_scale: f64::from(model.following.acoustic_scale),
            average: true,
        }
    }
}

/// Tables and what quantising cost.
pub struct Export {
    pub bytes: Vec<u8>,
    pub report: Vec<SectionReport>,
}

/// Size and error of one section.
#[derive(Clone, Debug, Serialize)]
pub struct SectionReport {
    pub section: String,
    pub bytes: usize,
    /// None for sections that are exact.
    pub error: Option<ErrorReport>,
}

/// Quantisation error of one section.
#[derive(Clone, Debug, Serialize)]
pub struct ErrorReport {
    /// What the two numbers are measured in.
    pub unit: &'static str,
    pub max: f64,
    pub rms: f64,
    /// Numbers that were outside the range and have been held to it.
    pub clipped: usize,
}

/// Sums up differences between a number and its quantised form.
struct Errors {
    unit: &'static str,
    max: f64,
    sum: f64,
    count: usize,
    clipped: usize,
}

impl Errors {
    fn new(unit: &'static str) -> Self {
        Self {
            unit,
            max: 0.0,
            sum: 0.0,
            count: 0,
            clipped: 0,
        }
    }

    fn add(&mut self, error: f64) {
        self.max = self.max.max(error.abs());
        self.sum += error * error;
        self.count += 1;
    }

    /// `value` to the nearest whole number within ±`limit`.
    fn round(&mut self, value: f64, limit: f64) -> f64 {
        let rounded = value.round();
        if rounded.abs() > limit {
            self.clipped += 1;
        }
        rounded.clamp(-limit, limit)
    }

    fn report(self) -> Option<ErrorReport> {
        Some(ErrorReport {
            unit: self.unit,
            max: self.max,
            rms: (self.sum / self.count.max(1) as f64).sqrt(),
            clipped: self.clipped,
        })
    }
}

/// Quantises `model`.
pub fn export(model: &Model, with: &ExportSettings) -> Result<Export> {
    if !model.system.is_live() {
        bail!(
            "the device cannot run a model of system {}: train one with `--system {}`",
            model.system.name,
            System::LOCAL_LINEAR.name
        );
    }
    let mut tables = Tables::new(model)?;
    tables.put_header_sections(model, with)?;
    let distance_gain = tables.put_densities(&model.audio)?;
    tables.put_settings(with, distance_gain)?;
    tables.put_transitions(model)?;
    tables.put_projection(model)?;
    tables.put_maps(model)?;
    tables.finish()
}

struct Tables {
    shape: Shape,
    sections: Vec<(Section, Vec<u8>, Option<ErrorReport>)>,
}

impl Tables {
    fn new(model: &Model) -> Result<Self> {
        let shape = Shape {
            phones: model.phones.len(),
            densities: model.audio.mean.dim().1,
            taps: model.context.taps.len(),
            inputs: model.context.projection.nrows(),
            parameters: model.visual_size(),
        };
        let sizes = [
            ("phones", shape.phones, limit::PHONES),
            ("densities a state", shape.densities, limit::DENSITIES),
            ("context taps", shape.taps, limit::TAPS),
            ("projected inputs", shape.inputs, limit::INPUTS),
            ("visual parameters", shape.parameters, limit::PARAMETERS),
        ];
        for (what, have, limit) in sizes {
            ensure!(
                (1..=limit).contains(&have),
                "the model has {have} {what}, the device takes 1 to {limit}"
            );
        }
        Ok(Self {
            shape,
            sections: Vec::new(),
        })
    }

    fn put(&mut self, section: Section, bytes: Vec<u8>, error: Option<ErrorReport>) {
        debug_assert_eq!(bytes.len(), self.shape.length(section), "{section:?}");
        self.sections.push((section, bytes, error));
    }

    fn put_header_sections(&mut self, model: &Model, with: &ExportSettings) -> Result<()> {
        let Shape {
            phones,
            densities,
            taps,
            inputs,
            parameters,
        } = self.shape;
        let mut sizes = vec![0; shape::SIZE];
        for (at, value) in [
            (shape::PHONES, phones),
            (shape::DENSITIES, densities),
            (shape::TAPS, taps),
            (shape::INPUTS, inputs),
            (shape::PARAMETERS, parameters),
        ] {
            put_u16(&mut sizes, at, value as u16);
        }
        self.put(Section::Shape, sizes, None);
        ensure!(with.lag <= 1000, "a lag of {} hops is too long", with.lag);
        let visemes = model.phones.iter().map(|p| p.viseme().0).collect();
        self.put(Section::PhoneVisemes, visemes, None);
        let mut names = vec![0; NAME_SIZE * phones];
        for (phone, name) in model.phones.iter().zip(names.chunks_exact_mut(NAME_SIZE)) {
            let text = phone.name().as_bytes();
            ensure!(text.len() <= NAME_SIZE, "phone name {} is too long", phone.name());
            name[..text.len()].copy_from_slice(text);
        }
        self.put(Section::PhoneNames, names, None);
        let mut errors = Errors::new("feature");
        let start = model.start_mean.iter().flat_map(|m| {
            let value = f64::from(*m);
            let q = errors.round(value * 256.0, 32767.0);
            errors.add(q / 256.0 - value);
            (q as i16).to_le_bytes()
        });
        let start = start.collect();
        self.put(Section::StartMean, start, errors.report());
        Ok(())
    }

    fn put_settings(&mut self, with: &ExportSettings, distance_gain: u32) -> Result<()> {
        let beam = with.beam_bits * f64::from(1 << FRACTION_BITS);
        ensure!(
            beam >= 1.0 && beam <= f64::from(limit::BEAM),
            "a beam of {} bits is out of range",
            with.beam_bits
        );
        let scale = with.acoustic_scale * 65536.0;
        ensure!(
            (0.0..=f64::from(limit::ACOUSTIC_SCALE)).contains(&scale),
            "an acoustic scale of {} is out of range",
            with.acoustic_scale
        );
        let mut bytes = vec![0; settings::SIZE];
        put_u16(&mut bytes, settings::LAG, with.lag);
        put_u16(&mut bytes, settings::AVERAGE, u16::from(with.average));
        put_u32(&mut bytes, settings::BEAM, beam.round() as u32);
        put_u32(&mut bytes, settings::ACOUSTIC_SCALE, scale.round() as u32);
        put_u32(&mut bytes, settings::DISTANCE_GAIN, distance_gain);
        self.put(Section::Settings, bytes, None);
        Ok(())
    }

    /// Means in i8 steps and inverse deviations in u8 steps; gives the gain on squared distances.
    ///
    /// A dimension's mean step is the larger of what its means' range needs (range/254) and [`FINEST_STEP`] of its
    /// smallest deviation, so that quiet dimensions (Δ, ΔΔ) leave no steps of the inverse deviation unused. One
    /// step ω of the inverse deviation, in mean steps, serves all dimensions.
    fn put_densities(&mut self, audio: &Mixtures) -> Result<u32> {
        let used: Vec<(usize, usize)> = audio
            .log_weight
            .indexed_iter()
            .filter(|(_, w)| **w > Mixtures::NO_WEIGHT / 10.0)
            .map(|(at, _)| at)
            .collect();
        ensure!(!used.is_empty(), "the model has no audio density");
        let mut centre = [0f64; N_OBSERVATION];
        let mut step = [0f64; N_OBSERVATION];
        let mut omega = 0f64;
        for d in 0..N_OBSERVATION {
            let (mut low, mut high, mut narrow) = (f64::MAX, f64::MIN, f64::MAX);
            for &(s, k) in &used {
                let mean = f64::from(audio.mean[[s, k, d]]);
                (low, high) = (low.min(mean), high.max(mean));
                narrow = narrow.min(f64::from(audio.variance[[s, k, d]]).sqrt());
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
        if gain > f64::from(limit::DISTANCE_GAIN) {
            bail!("the audio variances differ too much for the device's tables");
        }
        let gains: Vec<u32> = step
            .iter()
            .map(|s| (65536.0 * f64::from(1 << MEAN_SHIFT) / 256.0 / s).round() as u32)
            .collect();
        ensure!(
            gains.iter().all(|g| *g <= limit::OBSERVATION_GAIN),
            "an audio variance is too small for the device's tables"
        );
        ensure!(
            centre.iter().all(|c| c.abs() < 128.0),
            "an audio mean is outside the front end's range"
        );
        let bytes = centre
            .iter()
            .flat_map(|c| ((c * 256.0) as i16).to_le_bytes())
            .collect();
        self.put(Section::ObservationCentre, bytes, None);
        self.put(
            Section::ObservationGain,
            gains.iter().flat_map(|g| g.to_le_bytes()).collect(),
            None,
        );
        self.put_density_tables(audio, &centre, &step, omega)?;
        Ok(gain.round() as u32)
    }

    fn put_density_tables(
        &mut self,
        audio: &Mixtures,
        centre: &[f64],
        step: &[f64],
        omega: f64,
    ) -> Result<()> {
        let mut errors = Errors::new("deviation (means)");
        let mut bytes = Vec::new();
        let mut constants = Vec::new();
        for ((s, k), log_weight) in audio.log_weight.indexed_iter() {
            let mut constant = f64::from(*log_weight) * LOG2_E;
            let used = *log_weight > Mixtures::NO_WEIGHT / 10.0;
            let mut inverses = Vec::with_capacity(N_OBSERVATION);
            for d in 0..N_OBSERVATION {
                let mean = f64::from(audio.mean[[s, k, d]]);
                let deviation = f64::from(audio.variance[[s, k, d]]).sqrt();
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
                bytes.push(q as i8 as u8);
                inverses.push(inverse as u8);
            }
            bytes.extend(inverses);
            let constant = if used {
                let q = (constant * f64::from(1 << FRACTION_BITS)).round();
                ensure!(
                    q.abs() <= f64::from(limit::CONSTANT),
                    "an audio density's weight or variance is out of range"
                );
                q as i32
            } else {
                NO_DENSITY
            };
            constants.extend(constant.to_le_bytes());
        }
        self.put(Section::Densities, bytes, errors.report());
        self.put(Section::DensityConstants, constants, None);
        Ok(())
    }

    fn put_transitions(&mut self, model: &Model) -> Result<()> {
        let phones = self.shape.phones;
        debug_assert_eq!(model.transition.dim(), (phones, N_CLASSES, N_CHOICES));
        let viseme_bigram = model.phones.iter().enumerate().flat_map(|(p, _)| {
            (0..VISEMES.len()).map(move |viseme| {
                let sum: f64 = model
                    .phones
                    .iter()
                    .zip(model.bigram.row(p))
                    .filter(|(next, _)| usize::from(next.viseme().0) == viseme)
                    .map(|(_, b)| f64::from(*b).exp())
                    .sum();
                if sum > 0.0 {
                    sum.ln()
                } else {
                    f64::from(Mixtures::NO_WEIGHT)
                }
            })
        });
        let wide = |values: &mut dyn Iterator<Item = &f32>| values.map(|v| f64::from(*v)).collect::<Vec<_>>();
        for (section, values) in [
            (Section::Transitions, wide(&mut model.transition.iter())),
            (Section::Bigram, wide(&mut model.bigram.iter())),
            (Section::VisemeBigram, viseme_bigram.collect()),
            (Section::Initial, wide(&mut model.initial.iter())),
        ] {
            let mut errors = Errors::new("bit");
            let bytes = values
                .iter()
                .flat_map(|v| table_log(*v, &mut errors).to_le_bytes());
            let bytes = bytes.collect();
            self.put(section, bytes, errors.report());
        }
        Ok(())
    }

    fn put_projection(&mut self, model: &Model) -> Result<()> {
        let context = &model.context;
        let mut bytes = Vec::new();
        for &tap in &context.taps {
            ensure!(
                tap >= i32::from(limit::FIRST_TAP) && tap <= i32::from(limit::LAST_TAP),
                "context tap {tap} is outside {}..={}",
                limit::FIRST_TAP,
                limit::LAST_TAP
            );
            bytes.push(tap as i8 as u8);
        }
        ensure!(
            context.taps.is_sorted_by(|a, b| a < b),
            "the context taps are not strictly increasing"
        );
        self.put(Section::Taps, bytes, None);
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
        debug_assert_eq!(context.mean.len(), self.shape.taps * N_STATIC);
        rows.store(
            self,
            [
                Section::Projection,
                Section::ProjectionShift,
                Section::ProjectionOffset,
            ],
        );
        Ok(())
    }

    fn put_maps(&mut self, model: &Model) -> Result<()> {
        let maps = &model.maps;
        let (d, x) = (self.shape.parameters, self.shape.inputs);
        let scale = parameter_scales(model);
        self.put(
            Section::ParameterScale,
            scale.iter().flat_map(|s| s.to_le_bytes()).collect(),
            None,
        );
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
        rows.store(
            self,
            [Section::GlobalMap, Section::GlobalShift, Section::GlobalBias],
        );
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
                for w in row.iter().take(x) {
                    let value = f64::from(*w) / lsb;
                    let q = weight_errors.round(value / (row_scale / 256.0), 127.0);
                    weight_errors.add((q * row_scale / 256.0 - value) / DEVIATION_LSB);
                    weights.push(q as i8 as u8);
                }
                let bias = f64::from(row[x]) / lsb;
                let q = bias_errors.round(bias, 32767.0);
                bias_errors.add((q - bias) / DEVIATION_LSB);
                scales.extend((row_scale as u16).to_le_bytes());
                biases.extend((q as i16).to_le_bytes());
            }
        }
        self.put(Section::StateMaps, weights, weight_errors.report());
        self.put(Section::StateScale, scales, None);
        self.put(Section::StateBias, biases, bias_errors.report());
        Ok(())
    }

    /// Header, section table, sections in tag order, checksum.
    fn finish(mut self) -> Result<Export> {
        self.sections.sort_by_key(|(section, ..)| *section as u16);
        debug_assert_eq!(self.sections.len(), N_SECTIONS);
        let mut out = vec![0; header::SIZE + N_SECTIONS * entry::SIZE];
        let mut report = Vec::new();
        let mut id = Vec::new();
        for (i, (section, bytes, error)) in self.sections.into_iter().enumerate() {
            out.resize(out.len().next_multiple_of(ALIGNMENT), 0);
            let base = header::SIZE + i * entry::SIZE;
            put_u16(&mut out, base + entry::TAG, section as u16);
            let offset = out.len() as u32;
            put_u32(&mut out, base + entry::OFFSET, offset);
            put_u32(&mut out, base + entry::LENGTH, bytes.len() as u32);
            out.extend(&bytes);
            id.extend(checksum(&bytes).to_le_bytes());
            report.push(SectionReport {
                section: format!("{section:?}"),
                bytes: bytes.len(),
                error,
            });
        }
        out.resize(out.len().next_multiple_of(ALIGNMENT), 0);
        let length = (out.len() + CRC_SIZE) as u32;
        out[header::MAGIC..header::MAGIC + MAGIC.len()].copy_from_slice(&MAGIC);
        put_u16(&mut out, header::VERSION, FORMAT_VERSION);
        put_u16(&mut out, header::N_SECTIONS, N_SECTIONS as u16);
        put_u32(&mut out, header::LENGTH, length);
        put_u32(&mut out, header::FRONT_END, FRONT_END_FINGERPRINT);
        put_u32(&mut out, header::MODEL_ID, checksum(&id));
        let crc = checksum(&out);
        out.extend(crc.to_le_bytes());
        lipstream_core::model::Model::new_checked(&out)?;
        Ok(Export { bytes: out, report })
    }
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

/// Rows of a matrix with i16 mantissas and a shift a row.
struct SumRows {
    weights: Vec<u8>,
    shifts: Vec<u8>,
    offsets: Vec<u8>,
    errors: Errors,
}

impl SumRows {
    fn new(unit: &'static str) -> Self {
        Self {
            weights: Vec::new(),
            shifts: Vec::new(),
            offsets: Vec::new(),
            errors: Errors::new(unit),
        }
    }

    /// One row: Σ wᵢ·uᵢ·`scale`, where uᵢ are integers, and an offset in the sum's LSB.
    fn push(&mut self, weights: &[f64], scale: f64, offset: f64) -> Result<()> {
        let largest = weights.iter().fold(0f64, |m, w| m.max(w.abs())) * scale;
        // The largest mantissa in [2¹⁴, 2¹⁵).
        let shift = if largest > 0.0 {
            (32767.0 / largest).log2().floor().min(f64::from(limit::SHIFT))
        } else {
            0.0
        };
        ensure!(
            shift >= 0.0,
            "a weight of {largest} is too large for the device's tables"
        );
        let up = shift.exp2();
        for w in weights {
            let value = w * scale * up;
            let q = self.errors.round(value, 32767.0);
            if largest > 0.0 {
                self.errors.add((q - value) / (largest * up));
            }
            self.weights.extend((q as i16).to_le_bytes());
        }
        ensure!(
            offset.abs() <= f64::from(limit::OFFSET),
            "an offset of {offset} is too large for the device's tables"
        );
        self.shifts.push(shift as u8);
        self.offsets.extend((offset.round() as i32).to_le_bytes());
        Ok(())
    }

    fn store(self, tables: &mut Tables, [weights, shifts, offsets]: [Section; 3]) {
        tables.put(weights, self.weights, self.errors.report());
        tables.put(shifts, self.shifts, None);
        tables.put(offsets, self.offsets, None);
    }
}

/// A natural log probability in Q5.10 log2.
fn table_log(value: f64, errors: &mut Errors) -> i16 {
    if value <= f64::from(Mixtures::NO_WEIGHT) / 10.0 {
        return NEVER_I16;
    }
    let bits = value / LN_2;
    let q = errors
        .round(bits * f64::from(1 << TABLE_FRACTION_BITS), 32767.0)
        .min(0.0);
    errors.add(q / f64::from(1 << TABLE_FRACTION_BITS) - bits);
    q as i16
}

fn put_u16(bytes: &mut [u8], at: usize, value: u16) {
    bytes[at..at + 2].copy_from_slice(&value.to_le_bytes());
}

fn put_u32(bytes: &mut [u8], at: usize, value: u32) {
    bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
}
