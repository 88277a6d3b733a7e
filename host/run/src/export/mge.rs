//! Tables of a model trained on the error of its mouth: the projection in i16 (its columns are strongly correlated; in i8
//! it costs 4 % AMSE), every other matrix in i8 with a scale a row, what the states own in i8 with a scale a state, rates
//! as codes of [`lipstream_core::kinds::recurrent::rate`].
use std::f64::consts::LOG2_E;

use lipstream_core::N_STATIC;
use lipstream_core::context::tables::{MAX_INPUTS, MAX_MEANS, MAX_OFFSET, MAX_TAPS};
use lipstream_core::frame::MAX_PARAMETERS;
use lipstream_core::hmm::transition::{MAX_PHONES, N_VISUAL_STATES};
use lipstream_core::kinds::recurrent::gated::READ_BITS;
use lipstream_core::kinds::recurrent::rate::LOGISTIC_FRACTION_BITS;
use lipstream_core::kinds::recurrent::tables::*;
use lipstream_core::kinds::{Kind, Recurrent};
use lipstream_core::logmath::FRACTION_BITS;
use lipstream_core::model::Section;
use ndarray::Array2;

use super::tables::{Errors, SumRows, Tables, beam};
use super::{Export, ExportError, Result};
use crate::error::{bail, ensure};
use crate::kinds::recurrent::gated::{Gated, Part};
use crate::kinds::recurrent::model::RecurrentModel;
use crate::kinds::recurrent::parameters::{Feedback, Group};
use crate::kinds::recurrent::step::softmax;

/// Run-time settings that go into the tables.
#[derive(Clone, Copy, Debug)]
pub struct ExportSettings {
    /// Beam width in bits.
    pub beam_bits: f64,
}

impl Default for ExportSettings {
    fn default() -> Self {
        Self { beam_bits: 11.0 }
    }
}

/// Statics in LSBs of one: Q7.8.
const STATIC: f64 = 256.0;
/// z, memory and mouth in LSBs of one: Q5.10.
const SIGNAL: f64 = (1 << SIGNAL_FRACTION_BITS) as f64;
/// Log likelihoods in LSBs of a bit.
const BIT: f64 = (1 << FRACTION_BITS) as f64;

/// Quantises `model`.
///
/// # Errors
///
/// [`ExportError`]: what it hears of itself, its size or a number in it is none that the device takes, or the beam is out of its range.
pub fn export(model: &RecurrentModel, with: &ExportSettings) -> Result<Export> {
    let p = &model.parameters;
    let of = &p.shape;
    if of.feedback == Feedback::Memory {
        return Err(ExportError::MemoryFeedback);
    }
    let means = of.context.shifts.len();
    let mut tables = Tables::new(&[
        ("phones", of.phones, MAX_PHONES),
        ("context taps", of.context.taps.len(), MAX_TAPS),
        ("projected inputs", of.inputs, MAX_INPUTS),
        ("visual parameters", of.outputs, MAX_PARAMETERS),
        ("numbers in its memory", of.memory, MAX_MEMORY),
        (
            "numbers in its second memory",
            model.gated.as_ref().map_or(1, |gated| gated.shape.memory),
            MAX_GATED,
        ),
    ])?;
    ensure!(
        means <= MAX_MEANS,
        ExportError::Size,
        "the model has {means} exponential means, the device takes {MAX_MEANS}"
    );
    tables.put_phones(&model.parent.phones)?;
    tables.put_start_mean(&model.parent.start_mean);
    let own = OwnSettings {
        beam: beam(with.beam_bits)?,
        owns: [
            (of.maps.audio(), owns::AUDIO_MAPS),
            (of.rates.audio(), owns::AUDIO_RATES),
            (of.maps.visual(), owns::VISUAL_MAPS),
            (!of.rates.audio(), owns::VISUAL_RATES),
            (of.feedback == Feedback::Output, owns::FEEDBACK),
        ]
        .into_iter()
        .filter_map(|(has, bit)| has.then_some(bit))
        .sum(),
        share: model.gated.as_ref().map_or(0, share),
    };
    let mut settings = Vec::new();
    put_settings(&mut settings, &own);
    tables.put(SETTINGS, settings, None);
    let initial: Vec<f32> = softmax(p.of(Group::Initial))
        .iter()
        .map(|p| p.max(1e-30).ln())
        .collect();
    tables.put_transitions(
        &model.parent.phones,
        &model.transition(),
        &model.parent.bigram,
        &initial,
    )?;
    tables.put_context(model)?;
    tables.put_matrices(model)?;
    tables.put_gates(model)?;
    if let Some(gated) = &model.gated {
        tables.put_gated(gated, own.share)?;
    }
    tables.finish(<Recurrent as Kind>::TAG)
}

impl Tables {
    /// Taps, means, and the projection z = V·scale∘(c − c̄) with its columns in the order of increasing taps.
    fn put_context(&mut self, model: &RecurrentModel) -> Result<()> {
        let of = &model.parameters.shape;
        let mut order: Vec<usize> = (0..of.context.taps.len()).collect();
        order.sort_by_key(|&k| of.context.taps[k]);
        let taps: Vec<i32> = order.iter().map(|&k| of.context.taps[k]).collect();
        self.put_taps(&taps)?;
        let mut shifts = Vec::new();
        for &shift in &of.context.shifts {
            match u8::try_from(shift) {
                Ok(shift @ 1..=MAX_MEAN_SHIFT) => shifts.push(shift),
                _ => bail!(
                    ExportError::Number,
                    "an exponential mean of rate 2^-{shift} is outside the device's 1..=12"
                ),
            }
        }
        let mut bytes = Vec::new();
        put_mean_shifts(&mut bytes, shifts);
        self.put(MEAN_SHIFTS, bytes, None);
        let places: Vec<usize> = order
            .into_iter()
            .chain(of.context.taps.len()..of.context.taps.len() + of.context.shifts.len())
            .flat_map(|k| k * N_STATIC..(k + 1) * N_STATIC)
            .collect();
        let projection = model.parameters.matrix(Group::Projection);
        let mut rows = SumRows::new("relative to a row's largest");
        for row in projection.rows() {
            let weights: Vec<f64> = places
                .iter()
                .map(|&from| f64::from(row[from]) * f64::from(model.scale[from % N_STATIC]))
                .collect();
            let offset: f64 = row
                .iter()
                .zip(&model.context_mean)
                .map(|(w, m)| f64::from(*w) * f64::from(*m))
                .sum();
            rows.push(&weights, SIGNAL / STATIC, offset * SIGNAL)?;
        }
        rows.store_projection(self);
        Ok(())
    }

    fn put_matrices(&mut self, model: &RecurrentModel) -> Result<()> {
        let p = &model.parameters;
        let wide = |group: Group| p.matrix(group).mapv(f64::from);
        let bias = |group: Group, scale: f64| -> Vec<f64> {
            p.of(group).iter().map(|b| f64::from(*b) * scale).collect()
        };
        let parts = [
            (Matrix::AUDIO, Group::Audio, Some(Group::AudioBias), LOG2_E, BIT),
            (
                Matrix::VISUAL,
                Group::Visual,
                Some(Group::VisualBias),
                LOG2_E,
                BIT,
            ),
            (Matrix::DRIVE, Group::Drive, None, 1.0, SIGNAL),
            (
                Matrix::OUTPUT,
                Group::Global,
                Some(Group::GlobalBias),
                1.0,
                SIGNAL,
            ),
            (Matrix::MEMORY, Group::Output, None, 1.0, SIGNAL),
        ];
        for (matrix, weights, biases, scale, out) in parts {
            let bias = biases.map_or_else(Vec::new, |b| bias(b, scale));
            self.put_matrix(matrix, &(wide(weights) * scale), &bias, SIGNAL, out)?;
        }
        Ok(())
    }

    /// y = W u + b, u in LSBs of 1/`input`, y in LSBs of 1/`output`.
    fn put_matrix(
        &mut self,
        matrix: Matrix,
        weights: &Array2<f64>,
        bias: &[f64],
        input: f64,
        output: f64,
    ) -> Result<()> {
        let mut errors = Errors::new("relative to a row's largest");
        let (mut codes, mut scales) = (Vec::new(), Vec::new());
        for row in weights.rows() {
            let largest = row.iter().fold(0f64, |m, w| m.max(w.abs()));
            let step = largest / 127.0;
            let scale = step * output / input * f64::from(1 << SCALE_FRACTION_BITS);
            let most = if matrix.in_blocks {
                BLOCK_SCALE_LIMIT - 1
            } else {
                i32::MAX
            };
            ensure!(
                scale.round() <= f64::from(most),
                ExportError::Number,
                "a weight of {largest} in {} is too large for the device's tables",
                matrix.weights.name
            );
            put_row_number(&mut scales, scale.round() as i32);
            for w in row {
                codes.push(code(*w, step, largest, &mut errors));
            }
        }
        let mut bytes = Vec::new();
        put_weights(&mut bytes, matrix, &codes, weights.ncols());
        self.put(matrix.weights, bytes, errors.report());
        self.put(matrix.scale, scales, None);
        if let Some(section) = matrix.bias {
            let mut bytes = Vec::new();
            for b in bias {
                let b = (b * output).round();
                ensure!(
                    b.abs() <= f64::from(MAX_OFFSET),
                    ExportError::Number,
                    "a bias in {} is too large for the device's tables",
                    section.name
                );
                put_row_number(&mut bytes, b as i32);
            }
            self.put(section, bytes, None);
        }
        Ok(())
    }

    /// The second memory; `share`, Q0.16, of the mouth is multiplied into what it says.
    fn put_gated(&mut self, gated: &Gated, share: u16) -> Result<()> {
        let share = f64::from(share) / 65536.0;
        let read = f64::from(1 << READ_BITS);
        let gate = f64::from(1 << LOGISTIC_FRACTION_BITS);
        let parts = [
            (
                Matrix::GATED_INPUT,
                Part::Input,
                Part::InputBias,
                1.0,
                SIGNAL,
                gate,
            ),
            (Matrix::GATED_AGAIN, Part::Again, Part::AgainBias, 1.0, read, gate),
            (
                Matrix::GATED_OUTPUT,
                Part::Output,
                Part::OutputBias,
                share,
                read,
                SIGNAL,
            ),
            (
                Matrix::GATED_LATER,
                Part::Later,
                Part::LaterBias,
                share,
                read,
                SIGNAL,
            ),
        ];
        for (matrix, weights, biases, scale, input, output) in parts {
            let weights = gated.matrix(weights).mapv(|w| f64::from(w) * scale);
            let bias: Vec<f64> = gated.of(biases).iter().map(|b| f64::from(*b) * scale).collect();
            self.put_matrix(matrix, &weights, &bias, input, output)?;
        }
        let mut errors = Errors::new("of the memory");
        let first: Vec<i16> = gated
            .of(Part::First)
            .iter()
            .map(|h| {
                let value = f64::from(*h) * read;
                let q = errors.round(value, read);
                errors.add((q - value) / read);
                q as i16
            })
            .collect();
        let mut bytes = Vec::new();
        put_first_memory(&mut bytes, first);
        self.put(GATED_FIRST, bytes, errors.report());
        Ok(())
    }

    /// What the states of both chains own.
    fn put_gates(&mut self, model: &RecurrentModel) -> Result<()> {
        let p = &model.parameters;
        let of = &p.shape;
        let audio = Owned {
            maps: of.maps.audio(),
            rates: of.rates.audio(),
            groups: [
                Group::AudioGain,
                Group::AudioDrive,
                Group::AudioOffset,
                Group::AudioRate,
            ],
            sections: [AUDIO_GATES, AUDIO_GATE_SCALE],
            states: of.audio_states(),
        };
        let visual = Owned {
            maps: of.maps.visual(),
            rates: !of.rates.audio(),
            groups: [
                Group::VisualGain,
                Group::VisualDrive,
                Group::VisualOffset,
                Group::VisualRate,
            ],
            sections: [VISUAL_GATES, VISUAL_GATE_SCALE],
            states: N_VISUAL_STATES,
        };
        for owned in [audio, visual] {
            let mut errors = Errors::new("relative to a state's largest");
            let (mut bytes, mut scales) = (Vec::new(), Vec::new());
            for state in 0..owned.states {
                let mut maps = [Vec::new(), Vec::new(), Vec::new()];
                let mut scale = [0; 3];
                for ((group, map), scale) in owned.groups[..3].iter().zip(&mut maps).zip(&mut scale) {
                    let mut step = 0.0;
                    if owned.maps {
                        let row = p.row(*group, state);
                        let largest = row.iter().fold(0f64, |m, w| m.max(f64::from(w.abs())));
                        step = largest / 127.0;
                        map.extend(
                            row.iter()
                                .map(|w| code(f64::from(*w), step, largest, &mut errors)),
                        );
                    }
                    let whole = (step * f64::from(1 << SCALE_FRACTION_BITS)).round();
                    ensure!(
                        whole <= f64::from(i32::MAX),
                        ExportError::Number,
                        "what a state owns is too large for the device's tables"
                    );
                    *scale = whole as i32;
                }
                let mut rates = Vec::new();
                if owned.rates {
                    let logits = p.row(owned.groups[3], state);
                    rates.extend(
                        logits
                            .iter()
                            .map(|l| (f64::from(*l) * 16.0 + 128.0).round().clamp(0.0, 255.0) as u8),
                    );
                }
                let maps = maps.each_ref().map(|map| &map[..]);
                put_gate(&mut bytes, &mut scales, maps, &rates, scale);
            }
            self.put(owned.sections[0], bytes, errors.report());
            self.put(owned.sections[1], scales, None);
        }
        let mut errors = Errors::new("signal");
        let first = p.of(Group::FirstMemory).iter().map(|h| {
            let value = f64::from(*h) * SIGNAL;
            let q = errors.round(value, 32767.0);
            errors.add((q - value) / SIGNAL);
            q as i16
        });
        let mut bytes = Vec::new();
        put_first_memory(&mut bytes, first);
        self.put(FIRST_MEMORY, bytes, errors.report());
        self.put_mouth(model.deviation.iter().map(|d| d / SIGNAL as f32));
        Ok(())
    }
}

/// s in Q0.16, at least its smallest.
fn share(gated: &Gated) -> u16 {
    (gated.share * 65536.0).round().clamp(1.0, 65535.0) as u16
}

/// One chain's tables.
struct Owned {
    maps: bool,
    rates: bool,
    /// Gain, drive, offset, rate.
    groups: [Group; 4],
    sections: [Section; 2],
    states: usize,
}

/// `w` in steps, held to ±127.
fn code(w: f64, step: f64, largest: f64, errors: &mut Errors) -> i8 {
    if largest == 0.0 {
        return 0;
    }
    let q = errors.round(w / step, 127.0);
    errors.add((q * step - w) / largest);
    q as i8
}
