//! What the tables of every model have: sizes, settings, phones, transitions; and the container.
use std::f64::consts::LN_2;

use lipstream_core::context::tables::{
    FIRST_TAP, LAST_TAP, MAX_OFFSET, MAX_SHIFT, PROJECTION, PROJECTION_OFFSET, PROJECTION_SHIFT, TAPS,
    put_sum_row, put_taps,
};
use lipstream_core::hmm::search::MAX_BEAM;
use lipstream_core::hmm::tables::{
    BIGRAM, INITIAL, NAME_SIZE, PHONE_NAMES, PHONE_VISEMES, TRANSITIONS, VISEME_BIGRAM, put_logs, put_phone,
};
use lipstream_core::hmm::transition::{N_CHOICES, N_CLASSES};
use lipstream_core::kinds::AnyModel;
use lipstream_core::logmath::{FRACTION_BITS, LogProb, NEVER_I16, TABLE_FRACTION_BITS};
use lipstream_core::model::common::{GROUPS, PARAMETER_SCALE, START_MEAN, put_group};
use lipstream_core::model::{Section, container, put_f32s, put_i16s};
use ndarray::{Array1, Array2, Array3};

use super::{ErrorReport, Export, ExportError, Result, SectionReport};
use crate::error::ensure;
use crate::hmm::mixtures::Mixtures;
use crate::phones::{Phone, VISEMES};

/// Sums up differences between a number and its quantised form.
pub(super) struct Errors {
    unit: &'static str,
    max: f64,
    sum: f64,
    count: usize,
    clipped: usize,
}

impl Errors {
    pub(super) fn new(unit: &'static str) -> Self {
        Self {
            unit,
            max: 0.0,
            sum: 0.0,
            count: 0,
            clipped: 0,
        }
    }

    pub(super) fn add(&mut self, error: f64) {
        self.max = self.max.max(error.abs());
        self.sum += error * error;
        self.count += 1;
    }

    /// `value` to the nearest whole number within ±`limit`.
    pub(super) fn round(&mut self, value: f64, limit: f64) -> f64 {
        let rounded = value.round();
        if rounded.abs() > limit {
            self.clipped += 1;
        }
        rounded.clamp(-limit, limit)
    }

    pub(super) fn report(self) -> Option<ErrorReport> {
        Some(ErrorReport {
            unit: self.unit,
            max: self.max,
            rms: (self.sum / self.count.max(1) as f64).sqrt(),
            clipped: self.clipped,
        })
    }
}

/// The sections so far.
pub(super) struct Tables {
    sections: Vec<(Section, Vec<u8>, Option<ErrorReport>)>,
}

impl Tables {
    /// Empty tables; `sizes` of the model are checked against the core's limits, by name.
    pub(super) fn new(sizes: &[(&str, usize, usize)]) -> Result<Self> {
        for &(what, have, limit) in sizes {
            ensure!(
                (1..=limit).contains(&have),
                ExportError::Size,
                "the model has {have} {what}, the device takes 1 to {limit}"
            );
        }
        Ok(Self { sections: Vec::new() })
    }

    pub(super) fn put(&mut self, section: Section, bytes: Vec<u8>, error: Option<ErrorReport>) {
        self.sections.push((section, bytes, error));
    }

    /// The one group of today's models, and real units of its parameters' LSBs.
    pub(super) fn put_mouth(&mut self, scales: impl IntoIterator<Item = f32>) {
        let mut bytes = Vec::new();
        put_f32s(&mut bytes, scales);
        let mut groups = Vec::new();
        put_group(&mut groups, "mouth", (bytes.len() / 4) as u16);
        self.put(GROUPS, groups, None);
        self.put(PARAMETER_SCALE, bytes, None);
    }

    pub(super) fn put_phones(&mut self, phones: &[Phone]) -> Result<()> {
        let (mut names, mut visemes) = (Vec::new(), Vec::new());
        for phone in phones {
            ensure!(
                phone.name().len() <= NAME_SIZE,
                ExportError::Size,
                "phone name {} is too long",
                phone.name()
            );
            put_phone(&mut names, &mut visemes, phone.name(), phone.viseme().0);
        }
        self.put(PHONE_VISEMES, visemes, None);
        self.put(PHONE_NAMES, names, None);
        Ok(())
    }

    pub(super) fn put_start_mean(&mut self, start_mean: &Array1<f32>) {
        let mut errors = Errors::new("feature");
        let start = start_mean.iter().map(|m| {
            let value = f64::from(*m);
            let q = errors.round(value * 256.0, 32767.0);
            errors.add(q / 256.0 - value);
            q as i16
        });
        let mut bytes = Vec::new();
        put_i16s(&mut bytes, start);
        self.put(START_MEAN, bytes, errors.report());
    }

    /// Context taps in hops, strictly increasing.
    pub(super) fn put_taps(&mut self, taps: &[i32]) -> Result<()> {
        for &tap in taps {
            ensure!(
                tap >= i32::from(FIRST_TAP) && tap <= i32::from(LAST_TAP),
                ExportError::Number,
                "context tap {tap} is outside {}..={}",
                FIRST_TAP,
                LAST_TAP
            );
        }
        ensure!(
            taps.is_sorted_by(|a, b| a < b),
            ExportError::Number,
            "the context taps are not strictly increasing"
        );
        let mut bytes = Vec::new();
        put_taps(&mut bytes, taps.iter().map(|tap| *tap as i8));
        self.put(TAPS, bytes, None);
        Ok(())
    }

    /// Natural logs of the transition table `[P, 15, 4]`, the bigram `[P, P]` and the first phone `[P]`.
    pub(super) fn put_transitions(
        &mut self,
        phones: &[Phone],
        transition: &Array3<f32>,
        bigram: &Array2<f32>,
        initial: &[f32],
    ) -> Result<()> {
        debug_assert_eq!(transition.dim(), (phones.len(), N_CLASSES, N_CHOICES));
        let viseme_bigram = (0..phones.len()).flat_map(|p| {
            (0..VISEMES.len()).map(move |viseme| {
                let sum: f64 = phones
                    .iter()
                    .zip(bigram.row(p))
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
            (TRANSITIONS, wide(&mut transition.iter())),
            (BIGRAM, wide(&mut bigram.iter())),
            (VISEME_BIGRAM, viseme_bigram.collect()),
            (INITIAL, wide(&mut initial.iter())),
        ] {
            let mut errors = Errors::new("bit");
            let mut bytes = Vec::new();
            put_logs(&mut bytes, values.iter().map(|v| table_log(*v, &mut errors)));
            self.put(section, bytes, errors.report());
        }
        Ok(())
    }

    /// The whole block for a model of this kind, read once to see that it is one.
    pub(super) fn finish(mut self, kind: u16) -> Result<Export> {
        self.sections.sort_by_key(|(section, ..)| section.tag);
        let parts: Vec<(Section, &[u8])> = self.sections.iter().map(|(s, b, _)| (*s, &b[..])).collect();
        let mut bytes = Vec::new();
        container::write(kind, &parts, &mut bytes);
        AnyModel::new_checked(&bytes)?;
        let report = self
            .sections
            .into_iter()
            .map(|(section, bytes, error)| SectionReport {
                section: section.name.to_owned(),
                bytes: bytes.len(),
                error,
            });
        Ok(Export {
            bytes,
            report: report.collect(),
        })
    }
}

/// A beam in the core's units.
pub(super) fn beam(bits: f64) -> Result<LogProb> {
    let q12 = bits * f64::from(1 << FRACTION_BITS);
    ensure!(
        q12 >= 1.0 && q12 <= f64::from(MAX_BEAM),
        ExportError::Setting,
        "a beam of {bits} bits is out of range"
    );
    Ok(LogProb::from_q12(q12.round() as i32))
}

/// Rows of a matrix with i16 mantissas and a shift a row.
pub(super) struct SumRows {
    weights: Vec<u8>,
    shifts: Vec<u8>,
    offsets: Vec<u8>,
    most_shift: u8,
    errors: Errors,
}

impl SumRows {
    pub(super) fn new(unit: &'static str) -> Self {
        Self::within(unit, MAX_SHIFT)
    }

    /// Rows whose sums are shifted by no more than this.
    pub(super) fn within(unit: &'static str, most_shift: u8) -> Self {
        Self {
            most_shift,
            weights: Vec::new(),
            shifts: Vec::new(),
            offsets: Vec::new(),
            errors: Errors::new(unit),
        }
    }

    /// One row: Σ wᵢ·uᵢ·`scale`, where uᵢ are integers, and an offset in the sum's LSB.
    pub(super) fn push(&mut self, weights: &[f64], scale: f64, offset: f64) -> Result<()> {
        let largest = weights.iter().fold(0f64, |m, w| m.max(w.abs())) * scale;
        // Mantissas below 2¹⁵ that add up to less than 2¹⁶ with all their roundings.
        let sum = weights.iter().map(|w| w.abs()).sum::<f64>() * scale;
        let room = (32767.0 / largest).min((65535.0 - weights.len() as f64) / sum);
        let shift = if largest > 0.0 {
            room.log2().floor().min(f64::from(self.most_shift))
        } else {
            0.0
        };
        ensure!(
            shift >= 0.0,
            ExportError::Number,
            "a weight of {largest} is too large for the device's tables"
        );
        let up = shift.exp2();
        let mut mantissas = Vec::with_capacity(weights.len());
        for w in weights {
            let value = w * scale * up;
            let q = self.errors.round(value, 32767.0);
            if largest > 0.0 {
                self.errors.add((q - value) / (largest * up));
            }
            mantissas.push(q as i16);
        }
        ensure!(
            offset.abs() <= f64::from(MAX_OFFSET),
            ExportError::Number,
            "an offset of {offset} is too large for the device's tables"
        );
        put_sum_row(
            [&mut self.weights, &mut self.shifts, &mut self.offsets],
            mantissas,
            shift as u8,
            offset.round() as i32,
        );
        Ok(())
    }

    pub(super) fn store_projection(self, tables: &mut Tables) {
        self.store(tables, [PROJECTION, PROJECTION_SHIFT, PROJECTION_OFFSET]);
    }

    /// Rows that have no offset.
    pub(super) fn store_without_offsets(self, tables: &mut Tables, [weights, shifts]: [Section; 2]) {
        tables.put(weights, self.weights, self.errors.report());
        tables.put(shifts, self.shifts, None);
    }

    pub(super) fn store(self, tables: &mut Tables, [weights, shifts, offsets]: [Section; 3]) {
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
