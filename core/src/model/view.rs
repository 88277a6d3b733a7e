//! The checked view of a model's bytes.
use super::check;
use super::error::ModelError;
use super::field::{self, BLOCK, Matrix, NAME_SIZE, Section, Shape, header, owns, settings};
use super::part::{Blocks, Density, Gate, I16s, Rows, Scaling, StateRow, SumRow, U16s};
use crate::hmm::transition::{N_CHOICES, N_CLASSES};
use crate::logmath::{LogProb, NEVER_I16};
use crate::parameters::N_VISEMES;
use crate::{N_OBSERVATION, N_STATIC};

/// A model whose bytes have been checked: every section is there, has the length that the sizes ask for, and
/// holds only numbers that the converter can take. It borrows the bytes and copies none of the tables; no
/// accessor can fail or panic (an index beyond the model's sizes gives zeros or nothing).
#[derive(Clone, Copy, Debug)]
pub struct Model<'a> {
    bytes: &'a [u8],
    shape: Shape,
    /// By [`Section`] tag.
    sections: [&'a [u8]; field::N_SECTIONS],
}

impl<'a> Model<'a> {
    /// Checks `bytes` from the first to the last; see [`ModelError`].
    pub fn new_checked(bytes: &'a [u8]) -> Result<Self, ModelError> {
        let (shape, sections) = check::layout(bytes)?;
        let model = Self {
            bytes,
            shape,
            sections,
        };
        check::values(&model)?;
        Ok(model)
    }

    #[inline]
    pub(super) fn section(&self, section: Section) -> &'a [u8] {
        self.sections[section as usize]
    }

    #[inline]
    pub(super) fn i16s(&self, section: Section) -> I16s<'a> {
        I16s(self.section(section))
    }

    /// The bytes that this is a view of.
    pub fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// Number that tells models apart: a checksum of the tables.
    pub fn id(&self) -> u32 {
        u32_at(self.bytes, header::MODEL_ID)
    }

    pub fn shape(&self) -> Shape {
        self.shape
    }

    /// P
    #[inline]
    pub fn n_phones(&self) -> usize {
        self.shape.phones
    }

    /// D
    #[inline]
    pub fn n_parameters(&self) -> usize {
        self.shape.parameters
    }

    /// Viseme of a phone, below 13.
    #[inline]
    pub fn viseme(&self, phone: usize) -> usize {
        usize::from(u8_at(self.section(Section::PhoneVisemes), phone))
    }

    /// Visemes of all phones.
    #[inline]
    pub fn visemes(&self) -> &'a [u8] {
        self.section(Section::PhoneVisemes)
    }

    /// Name of a phone; empty beyond the last.
    pub fn phone_name(&self, phone: usize) -> &'a str {
        let names = self.section(Section::PhoneNames);
        let name = names
            .get(NAME_SIZE * phone..NAME_SIZE * (phone + 1))
            .unwrap_or(&[]);
        let end = name.iter().position(|b| *b == 0).unwrap_or(name.len());
        core::str::from_utf8(&name[..end]).unwrap_or("")
    }

    /// Mean of the raw statics that a stream starts from, Q7.8.
    pub fn start_mean(&self) -> [i16; N_STATIC] {
        let mut mean = [0; N_STATIC];
        for (to, from) in mean.iter_mut().zip(self.i16s(Section::StartMean).iter()) {
            *to = from;
        }
        mean
    }

    /// Centre (Q7.8) and gain (Q16.16) of each of the 39 numbers of an observation.
    #[inline]
    pub fn observation_scaling(&self) -> impl Iterator<Item = (i16, u32)> + 'a {
        self.centres_and_gains(Section::ObservationCentre, Section::ObservationGain)
    }

    /// Centre (parameter LSBs) and gain (Q16.16) of each parameter before the visual densities; nothing without them.
    #[inline]
    pub fn parameter_scaling(&self) -> impl Iterator<Item = (i16, u32)> + 'a {
        self.centres_and_gains(Section::ParameterCentre, Section::ParameterGain)
    }

    #[inline(always)]
    fn centres_and_gains(&self, centres: Section, gains: Section) -> impl Iterator<Item = (i16, u32)> + 'a {
        let gains = self.section(gains).as_chunks().0;
        self.i16s(centres)
            .iter()
            .zip(gains.iter().map(|b| u32::from_le_bytes(*b)))
    }

    /// The densities of audio state 5·phone + i, over 39 numbers.
    #[inline]
    pub fn mixture(&self, state: usize) -> impl Iterator<Item = Density<'a>> + 'a {
        let tables = [Section::DensityConstants, Section::Densities];
        self.densities(tables, self.shape.densities, N_OBSERVATION, state)
    }

    /// Whether the tables have visual densities, see [`crate::hmm::feedback`].
    #[inline]
    pub fn has_visual_densities(&self) -> bool {
        self.shape.visual_densities > 0
    }

    /// The densities of visual state 5·viseme + j, over the parameters.
    #[inline]
    pub fn visual_mixture(&self, state: usize) -> impl Iterator<Item = Density<'a>> + 'a {
        let tables = [Section::VisualDensityConstants, Section::VisualDensities];
        self.densities(tables, self.shape.visual_densities, self.shape.parameters, state)
    }

    /// The `count` densities of a state, over `size` numbers each.
    #[inline(always)]
    fn densities(
        &self,
        [constants, densities]: [Section; 2],
        count: usize,
        size: usize,
        state: usize,
    ) -> impl Iterator<Item = Density<'a>> + 'a {
        let of_state = |section: Section, bytes: usize| {
            self.section(section)
                .get(state * bytes..(state + 1) * bytes)
                .unwrap_or(&[])
        };
        let halves = of_state(densities, count * 2 * size).chunks_exact(2 * size);
        let constants = of_state(constants, count * 4).as_chunks().0;
        constants.iter().zip(halves).map(move |(constant, both)| {
            let constant = i32::from_le_bytes(*constant);
            let (mean, inverse_deviation) = both.split_at_checked(size).unwrap_or((&[], &[]));
            Density {
                constant: (constant != field::NO_DENSITY).then_some(LogProb::from_q12(constant)),
                mean,
                inverse_deviation,
            }
        })
    }

    /// Mean of the mixture of visual state 5·viseme + j, parameter LSBs `[D]`.
    #[inline]
    pub fn visual_centre(&self, state: usize) -> I16s<'a> {
        self.i16s(Section::VisualCentres)
            .row(state, self.shape.parameters)
    }

    /// [`Model::distance_gain`] of the visual densities.
    pub fn visual_distance_gain(&self) -> u32 {
        u32_at(self.section(Section::Settings), settings::VISUAL_DISTANCE_GAIN)
    }

    /// Log probabilities of the four choices of a joint state of `phone` in transition class `class`.
    #[inline]
    pub fn choices(&self, phone: usize, class: usize) -> [LogProb; N_CHOICES] {
        let row = self
            .i16s(Section::Transitions)
            .row(N_CLASSES * phone + class, N_CHOICES);
        let mut out = [LogProb::NEVER; N_CHOICES];
        for (to, from) in out.iter_mut().zip(row.iter()) {
            *to = LogProb::from_table(from);
        }
        out
    }

    /// Log P(next | phone) for every next phone, Q5.10.
    #[inline]
    pub fn bigram(&self, phone: usize) -> I16s<'a> {
        self.i16s(Section::Bigram).row(phone, self.shape.phones)
    }

    /// Log P(viseme of the next phone | phone) for every viseme, Q5.10.
    #[inline]
    pub fn viseme_bigram(&self, phone: usize) -> I16s<'a> {
        self.i16s(Section::VisemeBigram).row(phone, N_VISEMES)
    }

    /// Log P(first phone) for every phone, Q5.10.
    #[inline]
    pub fn initial(&self) -> I16s<'a> {
        self.i16s(Section::Initial)
    }

    /// Context taps in hops relative to the frame, increasing, −40..=16.
    #[inline]
    pub fn taps(&self) -> impl DoubleEndedIterator<Item = i8> + ExactSizeIterator + 'a {
        self.section(Section::Taps).iter().map(|b| *b as i8)
    }

    /// The latest tap, hops after the frame; 0 if all lie before it.
    pub fn look_ahead(&self) -> usize {
        self.taps()
            .next_back()
            .map_or(0, |t| usize::from(t.max(0).unsigned_abs()))
    }

    /// Rows of the projection: mantissas `[13(T + M)]`, shift, offset.
    #[inline]
    pub fn projection(&self) -> impl Iterator<Item = SumRow<'a>> + 'a {
        self.sum_rows(
            [
                Section::Projection,
                Section::ProjectionShift,
                Section::ProjectionOffset,
            ],
            self.shape.context(),
        )
    }

    /// Rows of the global map: mantissas `[X]`, shift, bias.
    #[inline]
    pub fn global_map(&self) -> impl Iterator<Item = SumRow<'a>> + 'a {
        self.sum_rows(
            [Section::GlobalMap, Section::GlobalShift, Section::GlobalBias],
            self.shape.inputs,
        )
    }

    #[inline]
    fn sum_rows(
        &self,
        [weights, shift, offset]: [Section; 3],
        width: usize,
    ) -> impl Iterator<Item = SumRow<'a>> + 'a {
        self.section(weights)
            .chunks_exact(2 * width)
            .zip(self.section(shift))
            .zip(self.section(offset).as_chunks().0)
            .map(|((weights, shift), offset)| SumRow {
                weights: I16s(weights),
                shift: u32::from(*shift),
                offset: i32::from_le_bytes(*offset),
            })
    }

    /// Rows of the residual map of visual state 5·viseme + j: weights i8 `[X]`, scale, bias.
    #[inline]
    pub fn state_map(&self, visual_state: usize) -> impl Iterator<Item = StateRow<'a>> + 'a {
        let Shape {
            inputs: x,
            parameters: d,
            ..
        } = self.shape;
        let size = d * x;
        let weights = self
            .section(Section::StateMaps)
            .get(visual_state * size..(visual_state + 1) * size)
            .unwrap_or(&[]);
        weights
            .chunks_exact(x)
            .zip(
                U16s(self.section(Section::StateScale))
                    .row(visual_state, d)
                    .iter(),
            )
            .zip(self.i16s(Section::StateBias).row(visual_state, d).iter())
            .map(|((weights, scale), bias)| StateRow { weights, scale, bias })
    }

    /// Whether the model has a memory (see [`crate::mge`]); else it speaks by local linear maps.
    #[inline]
    pub fn is_recurrent(&self) -> bool {
        self.shape.memory > 0
    }

    /// Rates of the context's exponential means, as right shifts 1..=12.
    #[inline]
    pub fn mean_shifts(&self) -> &'a [u8] {
        self.section(Section::MeanShifts)
    }

    /// One of the matrices of a model with a memory that lie row by row, `columns` wide.
    #[inline]
    pub fn rows(&self, matrix: Matrix, columns: usize) -> Rows<'a> {
        debug_assert!(!matrix.in_blocks);
        Rows {
            weights: self.section(matrix.weights).as_chunks().0,
            fours: columns.div_ceil(BLOCK),
            scaling: self.scaling(matrix),
        }
    }

    /// One of the matrices of a model with a memory that lie in blocks, `columns` wide.
    #[inline]
    pub fn blocks(&self, matrix: Matrix, columns: usize) -> Blocks<'a> {
        debug_assert!(matrix.in_blocks);
        Blocks {
            weights: self.section(matrix.weights).as_chunks().0,
            fours: columns.div_ceil(BLOCK),
            scaling: self.scaling(matrix),
        }
    }

    fn scaling(&self, matrix: Matrix) -> Scaling<'a> {
        Scaling {
            scale: self.section(matrix.scale).as_chunks().0,
            bias: matrix.bias.map_or(&[], |bias| self.section(bias).as_chunks().0),
        }
    }

    /// What audio state 5·phone + i brings to the memory and to the mouth.
    #[inline]
    pub fn audio_gate(&self, state: usize) -> Gate<'a> {
        self.gate(
            [Section::AudioGates, Section::AudioGateScale],
            [owns::AUDIO_MAPS, owns::AUDIO_RATES],
            state,
        )
    }

    /// What visual state 5·viseme + j brings to the memory and to the mouth.
    #[inline]
    pub fn visual_gate(&self, state: usize) -> Gate<'a> {
        self.gate(
            [Section::VisualGates, Section::VisualGateScale],
            [owns::VISUAL_MAPS, owns::VISUAL_RATES],
            state,
        )
    }

    fn gate(&self, [tables, scales]: [Section; 2], [maps, rates]: [u16; 2], state: usize) -> Gate<'a> {
        let Shape {
            memory: h,
            parameters: d,
            ..
        } = self.shape;
        let size = self.shape.gate(maps, rates);
        let bytes = self
            .section(tables)
            .get(state * size..(state + 1) * size)
            .unwrap_or(&[]);
        let (h_maps, d_maps) = if self.shape.owns(maps) { (h, d) } else { (0, 0) };
        let (gain, rest) = bytes.split_at_checked(h_maps).unwrap_or((&[], &[]));
        let (drive, rest) = rest.split_at_checked(h_maps).unwrap_or((&[], &[]));
        let (offset, rate) = rest.split_at_checked(d_maps).unwrap_or((&[], &[]));
        let scale = self.section(scales).as_chunks::<4>().0.as_chunks::<3>().0;
        Gate {
            gain,
            drive,
            offset,
            rate,
            scale: scale.get(state).map_or([0; 3], |s| s.map(i32::from_le_bytes)),
        }
    }

    /// The memory before the first frame, Q5.10 `[H]`.
    #[inline]
    pub fn first_memory(&self) -> I16s<'a> {
        self.i16s(Section::FirstMemory)
    }

    /// Real units of one LSB of each parameter, for the host: never computed with here.
    pub fn parameter_scales(&self) -> impl ExactSizeIterator<Item = f32> + 'a {
        self.section(Section::ParameterScale)
            .as_chunks()
            .0
            .iter()
            .map(|b| f32::from_bits(u32::from_le_bytes(*b)))
    }

    /// Lag that the model was made for, hops.
    pub fn lag(&self) -> usize {
        usize::from(u16_at(self.section(Section::Settings), settings::LAG))
    }

    /// Whether three frames are averaged.
    pub fn average(&self) -> bool {
        u16_at(self.section(Section::Settings), settings::AVERAGE) == 1
    }

    /// Beam that the model was made for, as a width.
    pub fn beam(&self) -> LogProb {
        LogProb::from_q12(u32_at(self.section(Section::Settings), settings::BEAM) as i32)
    }

    /// Exponent on the audio likelihood, Q16.16.
    pub fn acoustic_scale(&self) -> u32 {
        u32_at(self.section(Section::Settings), settings::ACOUSTIC_SCALE)
    }

    /// LSB 2⁻²⁰: log2 units of 2⁻¹² for one unit of a density's squared distance.
    pub fn distance_gain(&self) -> u32 {
        u32_at(self.section(Section::Settings), settings::DISTANCE_GAIN)
    }
}

pub(super) fn u8_at(bytes: &[u8], at: usize) -> u8 {
    bytes.get(at).copied().unwrap_or(0)
}

pub(super) fn u16_at(bytes: &[u8], at: usize) -> u16 {
    match bytes.get(at..at + 2) {
        Some(&[a, b]) => u16::from_le_bytes([a, b]),
        _ => 0,
    }
}

pub(super) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    match bytes.get(at..at + 4) {
        Some(&[a, b, c, d]) => u32::from_le_bytes([a, b, c, d]),
        _ => 0,
    }
}

/// Whether a table number may stand for a probability: ≤ 1, "never" allowed.
pub(super) fn is_probability(value: i16) -> bool {
    value <= 0
}

/// Whether a table number is log2 0.
pub(super) fn is_never(value: i16) -> bool {
    value == NEVER_I16
}
