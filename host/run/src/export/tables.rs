//! What the tables of every model have: sizes, settings, phones, transitions; and the container.
use std::f64::consts::LN_2;

use anyhow::{Result, ensure};
use lipstream_core::hmm::transition::{N_CHOICES, N_CLASSES};
use lipstream_core::logmath::{FRACTION_BITS, NEVER_I16, TABLE_FRACTION_BITS};
use lipstream_core::model::field::{
    ALIGNMENT, CRC_SIZE, FORMAT_VERSION, FRONT_END_FINGERPRINT, MAGIC, N_SECTIONS, NAME_SIZE, Section, Shape,
    checksum, entry, header, limit, settings, shape,
};
use ndarray::{Array1, Array2, Array3};

use super::{ErrorReport, Export, ExportSettings, SectionReport};
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
    pub(super) shape: Shape,
    sections: Vec<(Section, Vec<u8>, Option<ErrorReport>)>,
}

impl Tables {
    /// Empty tables of these sizes; `sizes` are checked against the core's limits, by name.
    pub(super) fn new(shape: Shape, sizes: &[(&str, usize, usize)]) -> Result<Self> {
        for &(what, have, limit) in sizes {
            ensure!(
                (1..=limit).contains(&have),
                "the model has {have} {what}, the device takes 1 to {limit}"
            );
        }
        let mut out = Self {
            shape,
            sections: Vec::new(),
        };
        let mut bytes = vec![0; shape::SIZE];
        for (at, value) in [
            (shape::PHONES, shape.phones),
            (shape::DENSITIES, shape.densities),
            (shape::TAPS, shape.taps),
            (shape::INPUTS, shape.inputs),
            (shape::PARAMETERS, shape.parameters),
            (shape::MEMORY, shape.memory),
            (shape::MEANS, shape.means),
            (shape::OWNS, usize::from(shape.owns)),
            (shape::VISUAL_DENSITIES, shape.visual_densities),
        ] {
            put_u16(&mut bytes, at, value as u16);
        }
        out.put(Section::Shape, bytes, None);
        Ok(out)
    }

    pub(super) fn put(&mut self, section: Section, bytes: Vec<u8>, error: Option<ErrorReport>) {
        debug_assert_eq!(bytes.len(), self.shape.length(section), "{section:?}");
        self.sections.push((section, bytes, error));
    }

    pub(super) fn has(&self, section: Section) -> bool {
        self.sections.iter().any(|(s, ..)| *s == section)
    }

    pub(super) fn put_phones(&mut self, phones: &[Phone]) -> Result<()> {
        let visemes = phones.iter().map(|p| p.viseme().0).collect();
        self.put(Section::PhoneVisemes, visemes, None);
        let mut names = vec![0; NAME_SIZE * phones.len()];
        for (phone, name) in phones.iter().zip(names.chunks_exact_mut(NAME_SIZE)) {
            let text = phone.name().as_bytes();
            ensure!(text.len() <= NAME_SIZE, "phone name {} is too long", phone.name());
            name[..text.len()].copy_from_slice(text);
        }
        self.put(Section::PhoneNames, names, None);
        Ok(())
    }

    pub(super) fn put_start_mean(&mut self, start_mean: &Array1<f32>) {
        let mut errors = Errors::new("feature");
        let start = start_mean.iter().flat_map(|m| {
            let value = f64::from(*m);
            let q = errors.round(value * 256.0, 32767.0);
            errors.add(q / 256.0 - value);
            (q as i16).to_le_bytes()
        });
        let start = start.collect();
        self.put(Section::StartMean, start, errors.report());
    }

    pub(super) fn put_settings(
        &mut self,
        with: &ExportSettings,
        distance_gain: u32,
        visual_distance_gain: u32,
    ) -> Result<()> {
        ensure!(with.lag <= 1000, "a lag of {} hops is too long", with.lag);
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
        put_u32(&mut bytes, settings::VISUAL_DISTANCE_GAIN, visual_distance_gain);
        self.put(Section::Settings, bytes, None);
        Ok(())
    }

    /// Context taps in hops, strictly increasing.
    pub(super) fn put_taps(&mut self, taps: &[i32]) -> Result<()> {
        let mut bytes = Vec::new();
        for &tap in taps {
            ensure!(
                tap >= i32::from(limit::FIRST_TAP) && tap <= i32::from(limit::LAST_TAP),
                "context tap {tap} is outside {}..={}",
                limit::FIRST_TAP,
                limit::LAST_TAP
            );
            bytes.push(tap as i8 as u8);
        }
        ensure!(
            taps.is_sorted_by(|a, b| a < b),
            "the context taps are not strictly increasing"
        );
        self.put(Section::Taps, bytes, None);
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
            (Section::Transitions, wide(&mut transition.iter())),
            (Section::Bigram, wide(&mut bigram.iter())),
            (Section::VisemeBigram, viseme_bigram.collect()),
            (Section::Initial, wide(&mut initial.iter())),
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

    /// Header, section table, sections in tag order, checksum.
    pub(super) fn finish(mut self) -> Result<Export> {
        for section in Section::ALL {
            if self.shape.length(section) == 0 && !self.has(section) {
                self.put(section, Vec::new(), None);
            }
        }
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

/// Rows of a matrix with i16 mantissas and a shift a row.
pub(super) struct SumRows {
    weights: Vec<u8>,
    shifts: Vec<u8>,
    offsets: Vec<u8>,
    errors: Errors,
}

impl SumRows {
    pub(super) fn new(unit: &'static str) -> Self {
        Self {
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
            room.log2().floor().min(f64::from(limit::SHIFT))
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

fn put_u16(bytes: &mut [u8], at: usize, value: u16) {
    bytes[at..at + 2].copy_from_slice(&value.to_le_bytes());
}

fn put_u32(bytes: &mut [u8], at: usize, value: u32) {
    bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
}
