//! The sections of a recurrent model, and their writers.
use super::Recurrent;
use crate::context::ContextTables;
use crate::context::tables::{MAX_MEANS, MAX_OFFSET};
use crate::hmm::HmmTables;
use crate::hmm::search::MAX_BEAM;
use crate::hmm::transition::{N_EMITTING, N_VISUAL_STATES};
use crate::logmath::LogProb;
use crate::model::container::{Section, Sections, check};
use crate::model::{Head, I16s, ModelError, i32s, put_i16s, put_i32s, put_u16s, u16_at, u32_at};

/// Run-time settings and what the states own, see [`put_settings`].
pub const SETTINGS: Section = Section::new(0x2000, "RecurrentSettings");
/// u8 `[M]`: rates of the context's exponential means, as right shifts.
pub const MEAN_SHIFTS: Section = Section::new(0x2001, "MeanShifts");
/// U: i8 rows `[5P][Z]`, see [`Matrix`].
pub const AUDIO_WEIGHTS: Section = Section::new(0x2002, "AudioWeights");
/// i32 `[5P]`: scales of U's rows.
pub const AUDIO_SCALE: Section = Section::new(0x2003, "AudioScale");
/// i32 `[5P]`, log2, LSB 2⁻¹² bit.
pub const AUDIO_BIAS: Section = Section::new(0x2004, "AudioBias");
/// F: i8 rows `[65][D]`, or nothing where the mouth does not feed back.
pub const VISUAL_WEIGHTS: Section = Section::new(0x2005, "VisualWeights");
/// i32 `[65]`: scales of F's rows.
pub const VISUAL_SCALE: Section = Section::new(0x2006, "VisualScale");
/// i32 `[65]`, log2, LSB 2⁻¹² bit.
pub const VISUAL_BIAS: Section = Section::new(0x2007, "VisualBias");
/// V_d: i8 `[H][Z]` in blocks.
pub const DRIVE_WEIGHTS: Section = Section::new(0x2008, "DriveWeights");
/// i32 `[H]`: scales of V_d's rows.
pub const DRIVE_SCALE: Section = Section::new(0x2009, "DriveScale");
/// W₀: i8 `[D][Z]` in blocks.
pub const OUTPUT_WEIGHTS: Section = Section::new(0x200a, "OutputWeights");
/// i32 `[D]`: scales of W₀'s rows.
pub const OUTPUT_SCALE: Section = Section::new(0x200b, "OutputScale");
/// i32 `[D]`, Q10.
pub const OUTPUT_BIAS: Section = Section::new(0x200c, "OutputBias");
/// O: i8 `[D][H]` in blocks.
pub const MEMORY_WEIGHTS: Section = Section::new(0x200d, "MemoryWeights");
/// i32 `[D]`: scales of O's rows.
pub const MEMORY_SCALE: Section = Section::new(0x200e, "MemoryScale");
/// Per audio state: i8 gains `[H]`, drives `[H]` and offsets `[D]` if the audio states have maps; u8 rates `[H]` if they have rates.
pub const AUDIO_GATES: Section = Section::new(0x200f, "AudioGates");
/// i32 `[5P][3]`: scales of gains, drives, offsets, LSB 2⁻²⁴.
pub const AUDIO_GATE_SCALE: Section = Section::new(0x2010, "AudioGateScale");
/// Per visual state what [`AUDIO_GATES`] has per audio state.
pub const VISUAL_GATES: Section = Section::new(0x2011, "VisualGates");
/// i32 `[65][3]`, as [`AUDIO_GATE_SCALE`].
pub const VISUAL_GATE_SCALE: Section = Section::new(0x2012, "VisualGateScale");
/// i16 `[H]`, Q5.10: the memory before the first frame.
pub const FIRST_MEMORY: Section = Section::new(0x2013, "FirstMemory");
/// W_g: i8 `[3K][Z]` in blocks, what the second memory's resets, updates and news hear, see [`super::gated`]. This and the following sections are
/// there only if [`OwnSettings::share`] is not 0.
pub const GATED_INPUT_WEIGHTS: Section = Section::new(0x2014, "GatedInputWeights");
/// i32 `[3K]`: scales of W_g's rows.
pub const GATED_INPUT_SCALE: Section = Section::new(0x2015, "GatedInputScale");
/// i32 `[3K]`, LSB 2⁻¹².
pub const GATED_INPUT_BIAS: Section = Section::new(0x2016, "GatedInputBias");
/// R_g: i8 `[3K][K]` in blocks, what they take from the memory before.
pub const GATED_AGAIN_WEIGHTS: Section = Section::new(0x2017, "GatedAgainWeights");
/// i32 `[3K]`: scales of R_g's rows.
pub const GATED_AGAIN_SCALE: Section = Section::new(0x2018, "GatedAgainScale");
/// i32 `[3K]`, LSB 2⁻¹².
pub const GATED_AGAIN_BIAS: Section = Section::new(0x2019, "GatedAgainBias");
/// s·O_g: i8 `[D][K]` in blocks, the share of the mouth that the second memory says.
pub const GATED_OUTPUT_WEIGHTS: Section = Section::new(0x201a, "GatedOutputWeights");
/// i32 `[D]`: scales of its rows.
pub const GATED_OUTPUT_SCALE: Section = Section::new(0x201b, "GatedOutputScale");
/// i32 `[D]`, Q10.
pub const GATED_OUTPUT_BIAS: Section = Section::new(0x201c, "GatedOutputBias");
/// s·O'_g: i8 `[D][K]` in blocks, what the second memory says of the frame after.
pub const GATED_LATER_WEIGHTS: Section = Section::new(0x201d, "GatedLaterWeights");
/// i32 `[D]`: scales of its rows.
pub const GATED_LATER_SCALE: Section = Section::new(0x201e, "GatedLaterScale");
/// i32 `[D]`, Q10.
pub const GATED_LATER_BIAS: Section = Section::new(0x201f, "GatedLaterBias");
/// i16 `[K]`, Q1.14: the second memory before the first frame.
pub const GATED_FIRST: Section = Section::new(0x2020, "GatedFirst");

/// Most numbers of the second memory.
pub const MAX_GATED: usize = 128;

/// Most numbers of a memory.
pub const MAX_MEMORY: usize = 192;
/// Scales of a matrix in blocks are less, LSB 2⁻²⁴.
pub const BLOCK_SCALE_LIMIT: i32 = 1 << 23;
/// Slowest exponential mean: 2⁻¹².
pub const MAX_MEAN_SHIFT: u8 = 12;
/// Fraction bits of a matrix row's scale.
pub const SCALE_FRACTION_BITS: u32 = 24;
/// Fraction bits of z, of the memory that the output reads, and of the mouth: parameters come in 1/1024.
pub const SIGNAL_FRACTION_BITS: u32 = 10;

/// Offsets in [`SETTINGS`].
pub mod settings {
    /// i32, bits, LSB 2⁻¹²
    pub const BEAM: usize = 0;
    /// u16, bits of [`owns`](super::owns)
    pub const OWNS: usize = 4;
    /// u16, Q0.16: share of the second memory in the mouth; 0 where there is none
    pub const SHARE: usize = 6;
    /// Bytes of the section.
    pub const SIZE: usize = 8;
}

/// Bits of [`settings::OWNS`]: which states own what.
pub mod owns {
    /// Audio states have gains, drives and offsets.
    pub const AUDIO_MAPS: u16 = 1;
    /// Audio states have rates.
    pub const AUDIO_RATES: u16 = 2;
    /// Visual states have gains, drives and offsets.
    pub const VISUAL_MAPS: u16 = 4;
    /// Visual states have rates.
    pub const VISUAL_RATES: u16 = 8;
    /// The last mouth feeds back into the visual emissions.
    pub const FEEDBACK: u16 = 16;
    /// All of them.
    pub const ALL: u16 = 31;
}

/// The run-time settings that a recurrent model was made for, and what its states own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OwnSettings {
    /// Width of the beam.
    pub beam: LogProb,
    /// Bits of [`owns`].
    pub owns: u16,
    /// Share of the second memory in the mouth, Q0.16; 0: the model has none.
    pub share: u16,
}

impl OwnSettings {
    fn read(sections: &mut Sections) -> Result<Self, ModelError> {
        let bytes = sections.take_sized(SETTINGS, settings::SIZE)?;
        let beam = u32_at(bytes, settings::BEAM);
        let owns = u16_at(bytes, settings::OWNS);
        check(SETTINGS, [beam > 0 && beam <= MAX_BEAM as u32, owns <= owns::ALL])?;
        Ok(Self {
            beam: LogProb::from_q12(beam as i32),
            owns,
            share: u16_at(bytes, settings::SHARE),
        })
    }

    /// Whether the states own what `bit` of [`owns`] says.
    pub fn owns(&self, bit: u16) -> bool {
        self.owns & bit != 0
    }
}

/// Writes [`SETTINGS`]; the fields in the order of the offsets in [`settings`].
pub fn put_settings(to: &mut impl Extend<u8>, own: &OwnSettings) {
    put_i32s(to, [own.beam.q12()]);
    put_u16s(to, [own.owns, own.share]);
}

/// Rows, and columns of each, that lie together in a matrix in blocks: [`BLOCK`]² bytes are four columns of four rows, row
/// by row; then come the next four columns of these rows. In either layout a weight w is the byte w + 128, and columns (in
/// blocks rows too) are filled up to a multiple of four with weights 0.
pub const BLOCK: usize = 4;

/// Bytes of a matrix row by row.
const fn rows_size(rows: usize, columns: usize) -> usize {
    rows * columns.div_ceil(BLOCK) * BLOCK
}

/// Bytes of a matrix in blocks.
const fn blocks_size(rows: usize, columns: usize) -> usize {
    rows.div_ceil(BLOCK) * columns.div_ceil(BLOCK) * BLOCK * BLOCK
}

/// A matrix of i8 weights with a scale a row and perhaps a bias: row r of the product with u is
/// bias_r + (scale_r·Σ weight·u) / 2²⁴.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Matrix {
    /// Section of the weights.
    pub weights: Section,
    /// Section of the scales, i32, LSB 2⁻²⁴.
    pub scale: Section,
    /// Section of the biases, i32.
    pub bias: Option<Section>,
    /// Whether the weights lie in blocks, not row by row.
    pub in_blocks: bool,
}

impl Matrix {
    /// U, by row: log emissions of the audio states from z.
    pub const AUDIO: Self = Self {
        weights: AUDIO_WEIGHTS,
        scale: AUDIO_SCALE,
        bias: Some(AUDIO_BIAS),
        in_blocks: false,
    };
    /// F, by row: log emissions of the visual states from the last mouth.
    pub const VISUAL: Self = Self {
        weights: VISUAL_WEIGHTS,
        scale: VISUAL_SCALE,
        bias: Some(VISUAL_BIAS),
        in_blocks: false,
    };
    /// V_d, in blocks: what z drives the memory with.
    pub const DRIVE: Self = Self {
        weights: DRIVE_WEIGHTS,
        scale: DRIVE_SCALE,
        bias: None,
        in_blocks: true,
    };
    /// W₀, in blocks: the mouth from z.
    pub const OUTPUT: Self = Self {
        weights: OUTPUT_WEIGHTS,
        scale: OUTPUT_SCALE,
        bias: Some(OUTPUT_BIAS),
        in_blocks: true,
    };
    /// O, in blocks: the mouth from the memory.
    pub const MEMORY: Self = Self {
        weights: MEMORY_WEIGHTS,
        scale: MEMORY_SCALE,
        bias: None,
        in_blocks: true,
    };

    /// W_g, in blocks: what the second memory hears of z.
    pub const GATED_INPUT: Self = Self {
        weights: GATED_INPUT_WEIGHTS,
        scale: GATED_INPUT_SCALE,
        bias: Some(GATED_INPUT_BIAS),
        in_blocks: true,
    };
    /// R_g, in blocks: what the second memory takes from itself.
    pub const GATED_AGAIN: Self = Self {
        weights: GATED_AGAIN_WEIGHTS,
        scale: GATED_AGAIN_SCALE,
        bias: Some(GATED_AGAIN_BIAS),
        in_blocks: true,
    };
    /// s·O_g, in blocks: what the second memory says.
    pub const GATED_OUTPUT: Self = Self {
        weights: GATED_OUTPUT_WEIGHTS,
        scale: GATED_OUTPUT_SCALE,
        bias: Some(GATED_OUTPUT_BIAS),
        in_blocks: true,
    };

    /// s·O'_g, in blocks: what the second memory says of the frame after.
    pub const GATED_LATER: Self = Self {
        weights: GATED_LATER_WEIGHTS,
        scale: GATED_LATER_SCALE,
        bias: Some(GATED_LATER_BIAS),
        in_blocks: true,
    };

    fn take<'a>(
        self,
        sections: &mut Sections<'a>,
        rows: usize,
        columns: usize,
    ) -> Result<(&'a [u8], Scaling<'a>), ModelError> {
        let size = match self.in_blocks {
            true => blocks_size(rows, columns),
            false => rows_size(rows, columns),
        };
        let weights = sections.take_sized(self.weights, size)?;
        let scale = sections.take_sized(self.scale, 4 * rows)?;
        if self.in_blocks {
            check(
                self.scale,
                i32s(scale).map(|s| (0..BLOCK_SCALE_LIMIT).contains(&s)),
            )?;
        }
        let mut bias: &[u8] = &[];
        if let Some(section) = self.bias {
            bias = sections.take_sized(section, 4 * rows)?;
            let within = -MAX_OFFSET..=MAX_OFFSET;
            check(section, i32s(bias).map(|v| within.contains(&v)))?;
        }
        let scaling = Scaling {
            scale: scale.as_chunks().0,
            bias: bias.as_chunks().0,
        };
        Ok((weights, scaling))
    }
}

/// Writes the weights of a matrix, given row by row, `columns` each: as rows or in blocks.
pub fn put_weights(to: &mut impl Extend<u8>, matrix: Matrix, weights: &[i8], columns: usize) {
    let rows = weights.len() / columns.max(1);
    let together = if matrix.in_blocks { BLOCK } else { 1 };
    for first_row in (0..rows).step_by(together) {
        for first_column in (0..columns).step_by(BLOCK) {
            for row in first_row..first_row + together {
                let codes = (first_column..first_column + BLOCK).map(|column| {
                    let inside = row < rows && column < columns;
                    let weight = weights.get(row * columns + column).filter(|_| inside);
                    weight.map_or(0, |w| *w) as u8 ^ 0x80
                });
                to.extend(codes);
            }
        }
    }
}

/// Writes the scale of one row of a matrix, LSB 2⁻²⁴, or its bias in the LSB of the product.
pub fn put_row_number(to: &mut impl Extend<u8>, number: i32) {
    put_i32s(to, [number]);
}

/// What becomes of the sums of a matrix's rows.
#[derive(Clone, Copy, Debug)]
pub struct Scaling<'a> {
    scale: &'a [[u8; 4]],
    /// Empty where there is none.
    bias: &'a [[u8; 4]],
}

impl Scaling<'_> {
    /// Scale of a row, LSB 2⁻²⁴.
    #[inline]
    pub fn scale(&self, row: usize) -> i32 {
        self.scale.get(row).map_or(0, |b| i32::from_le_bytes(*b))
    }

    /// Bias of a row, within ±2³⁰.
    #[inline]
    pub fn bias(&self, row: usize) -> i32 {
        self.bias.get(row).map_or(0, |b| i32::from_le_bytes(*b))
    }
}

/// A matrix of i8 weights row by row, see [`Matrix`].
#[derive(Clone, Copy, Debug)]
pub struct Rows<'a> {
    weights: &'a [[u8; BLOCK]],
    /// Columns, in fours.
    fours: usize,
    /// What becomes of the sums.
    pub scaling: Scaling<'a>,
}

impl<'a> Rows<'a> {
    fn take(
        sections: &mut Sections<'a>,
        matrix: Matrix,
        rows: usize,
        columns: usize,
    ) -> Result<Self, ModelError> {
        let (weights, scaling) = matrix.take(sections, rows, columns)?;
        Ok(Self {
            weights: weights.as_chunks().0,
            fours: columns.div_ceil(BLOCK),
            scaling,
        })
    }

    /// Weights of a row + 128, in fours; empty beyond the end.
    #[inline]
    pub fn weights(&self, row: usize) -> &'a [[u8; BLOCK]] {
        self.weights
            .get(row * self.fours..(row + 1) * self.fours)
            .unwrap_or(&[])
    }
}

/// A matrix of i8 weights in blocks, see [`BLOCK`].
#[derive(Clone, Copy, Debug)]
pub struct Blocks<'a> {
    weights: &'a [[u8; BLOCK * BLOCK]],
    /// Columns, in fours.
    fours: usize,
    /// What becomes of the sums.
    pub scaling: Scaling<'a>,
}

impl<'a> Blocks<'a> {
    fn take(
        sections: &mut Sections<'a>,
        matrix: Matrix,
        rows: usize,
        columns: usize,
    ) -> Result<Self, ModelError> {
        let (weights, scaling) = matrix.take(sections, rows, columns)?;
        Ok(Self {
            weights: weights.as_chunks().0,
            fours: columns.div_ceil(BLOCK),
            scaling,
        })
    }

    /// Number of rows, without those that fill up the last block.
    #[inline]
    pub fn len(&self) -> usize {
        self.scaling.scale.len()
    }

    /// Whether there is no row.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The blocks, four rows each: four columns of them at a time.
    #[inline]
    pub fn blocks(&self) -> impl Iterator<Item = &'a [[u8; BLOCK * BLOCK]]> + use<'a> {
        self.weights.chunks_exact(self.fours.max(1))
    }
}

/// The second memory, see [`super::gated`].
#[derive(Clone, Copy, Debug)]
pub struct GatedTables<'a> {
    /// W_g and b_g: rows of resets, of updates, of news.
    pub input: Blocks<'a>,
    /// R_g and its biases, in the same order.
    pub again: Blocks<'a>,
    /// s·O_g and its biases for the frame of a step, and for the frame after.
    pub output: [Blocks<'a>; 2],
    /// The memory before the first frame, Q1.14 `[K]`.
    pub first: I16s<'a>,
    /// s, Q0.16.
    pub share: u16,
}

impl<'a> GatedTables<'a> {
    /// `None` where the model has no second memory.
    fn read(
        sections: &mut Sections<'a>,
        share: u16,
        inputs: usize,
        outputs: usize,
    ) -> Result<Option<Self>, ModelError> {
        if share == 0 {
            return Ok(None);
        }
        let (first, k) = sections.take_items(GATED_FIRST, 2, MAX_GATED)?;
        Ok(Some(Self {
            input: Blocks::take(sections, Matrix::GATED_INPUT, 3 * k, inputs)?,
            again: Blocks::take(sections, Matrix::GATED_AGAIN, 3 * k, k)?,
            output: [
                Blocks::take(sections, Matrix::GATED_OUTPUT, outputs, k)?,
                Blocks::take(sections, Matrix::GATED_LATER, outputs, k)?,
            ],
            first: I16s(first),
            share,
        }))
    }

    /// K, numbers in the second memory.
    #[inline]
    pub fn size(&self) -> usize {
        self.first.iter().count()
    }
}

/// What one state brings to the memory and to the mouth. Slices are empty where the chain does not own them.
#[derive(Clone, Copy, Debug)]
pub struct Gate<'a> {
    /// i8 two's complement `[H]`.
    pub gain: &'a [u8],
    /// i8 two's complement `[H]`.
    pub drive: &'a [u8],
    /// i8 two's complement `[D]`.
    pub offset: &'a [u8],
    /// Codes of [`rate`](super::rate) `[H]`.
    pub rate: &'a [u8],
    /// Of gain, drive and offset, LSB 2⁻²⁴.
    pub scale: [i32; 3],
}

/// The gates of one chain's states.
#[derive(Clone, Copy, Debug)]
pub(super) struct GateTables<'a> {
    bytes: &'a [u8],
    scale: &'a [[[u8; 4]; 3]],
    /// Numbers of gains and of drives; of offsets; of rates.
    sizes: [usize; 3],
}

impl<'a> GateTables<'a> {
    fn take(
        sections: &mut Sections<'a>,
        [gates, scale]: [Section; 2],
        states: usize,
        sizes: [usize; 3],
    ) -> Result<Self, ModelError> {
        let [h, d, rates] = sizes;
        let scale = sections.take_sized(scale, 12 * states)?;
        Ok(Self {
            bytes: sections.take_sized(gates, states * (2 * h + d + rates))?,
            scale: scale.as_chunks::<4>().0.as_chunks::<3>().0,
            sizes,
        })
    }

    pub(super) fn of(&self, state: usize) -> Gate<'a> {
        let [h, d, rates] = self.sizes;
        let size = 2 * h + d + rates;
        let bytes = self.bytes.get(state * size..(state + 1) * size).unwrap_or(&[]);
        let (gain, rest) = bytes.split_at_checked(h).unwrap_or((&[], &[]));
        let (drive, rest) = rest.split_at_checked(h).unwrap_or((&[], &[]));
        let (offset, rate) = rest.split_at_checked(d).unwrap_or((&[], &[]));
        Gate {
            gain,
            drive,
            offset,
            rate,
            scale: self
                .scale
                .get(state)
                .map_or([0; 3], |s| s.map(i32::from_le_bytes)),
        }
    }
}

/// Writes the gate of one state into [`AUDIO_GATES`] or [`VISUAL_GATES`] (gains, drives, offsets, rates: each empty where the chain
/// does not own it) and its scales (of gains, drives, offsets; LSB 2⁻²⁴) into the section of scales.
pub fn put_gate<E: Extend<u8>>(
    gates: &mut E,
    scales: &mut E,
    maps: [&[i8]; 3],
    rates: &[u8],
    scale: [i32; 3],
) {
    for map in maps {
        gates.extend(map.iter().map(|w| *w as u8));
    }
    gates.extend(rates.iter().copied());
    put_i32s(scales, scale);
}

/// Writes [`MEAN_SHIFTS`].
pub fn put_mean_shifts(to: &mut impl Extend<u8>, shifts: impl IntoIterator<Item = u8>) {
    to.extend(shifts);
}

/// Writes [`FIRST_MEMORY`], Q5.10, or [`GATED_FIRST`], Q1.14.
pub fn put_first_memory(to: &mut impl Extend<u8>, memory: impl IntoIterator<Item = i16>) {
    put_i16s(to, memory);
}

pub(super) fn read<'a>(sections: &mut Sections<'a>, head: &Head<'a>) -> Result<Recurrent<'a>, ModelError> {
    let settings = OwnSettings::read(sections)?;
    let hmm = HmmTables::read(sections)?;
    let mean_shifts = sections.take(MEAN_SHIFTS)?;
    if mean_shifts.len() > MAX_MEANS {
        return Err(ModelError::Size {
            section: MEAN_SHIFTS,
            have: mean_shifts.len(),
            most: MAX_MEANS,
        });
    }
    check(
        MEAN_SHIFTS,
        mean_shifts.iter().map(|s| (1..=MAX_MEAN_SHIFT).contains(s)),
    )?;
    let context = ContextTables::read(sections, mean_shifts.len())?;
    let (first_memory, h) = sections.take_items(FIRST_MEMORY, 2, MAX_MEMORY)?;
    let (d, z) = (head.n_parameters(), context.n_inputs());
    let (s, v) = (N_EMITTING * hmm.n_phones(), N_VISUAL_STATES);
    let n_fed_back = if settings.owns(owns::FEEDBACK) { d } else { 0 };
    let sizes = |maps: u16, rates: u16| {
        let (of_h, of_d) = if settings.owns(maps) { (h, d) } else { (0, 0) };
        [of_h, of_d, if settings.owns(rates) { h } else { 0 }]
    };
    Ok(Recurrent {
        audio: Rows::take(sections, Matrix::AUDIO, s, z)?,
        visual: Rows::take(sections, Matrix::VISUAL, v, n_fed_back)?,
        drive: Blocks::take(sections, Matrix::DRIVE, h, z)?,
        output: Blocks::take(sections, Matrix::OUTPUT, d, z)?,
        memory: Blocks::take(sections, Matrix::MEMORY, d, h)?,
        audio_gates: GateTables::take(
            sections,
            [AUDIO_GATES, AUDIO_GATE_SCALE],
            s,
            sizes(owns::AUDIO_MAPS, owns::AUDIO_RATES),
        )?,
        visual_gates: GateTables::take(
            sections,
            [VISUAL_GATES, VISUAL_GATE_SCALE],
            v,
            sizes(owns::VISUAL_MAPS, owns::VISUAL_RATES),
        )?,
        hmm,
        context,
        settings,
        mean_shifts,
        gated: GatedTables::read(sections, settings.share, z, d)?,
        first_memory: I16s(first_memory),
        n_parameters: d,
        n_fed_back,
    })
}
