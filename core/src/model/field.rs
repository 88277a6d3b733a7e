//! Layout of the model's tables (format version 4). Every offset and every length is here and only here.
//!
//! ```text
//! header             32 bytes
//! section table      N_SECTIONS × 12 bytes: tag u16, zero u16, offset u32, length u32
//! sections           each starting at a multiple of 4, in any order
//! CRC-32 (ISO-HDLC)  4 bytes, over everything before it
//! ```

use crate::hmm::transition::N_CLASSES;
use crate::parameters::N_VISEMES;
use crate::{N_OBSERVATION, N_STATIC};

/// First bytes of every model.
pub const MAGIC: [u8; 8] = *b"lipstrm\0";
/// Version of this layout; any other is refused.
pub const FORMAT_VERSION: u16 = 4;
/// The front end that the tables were trained for. Raised whenever its numbers change.
pub const FRONT_END_FINGERPRINT: u32 = 0x4850_0001;

/// Offsets in the header.
pub mod header {
    pub const MAGIC: usize = 0;
    /// u16
    pub const VERSION: usize = 8;
    /// u16
    pub const N_SECTIONS: usize = 10;
    /// u32, of the whole block with its CRC
    pub const LENGTH: usize = 12;
    /// u32
    pub const FRONT_END: usize = 16;
    /// u32
    pub const MODEL_ID: usize = 20;
    /// Two u32, zero.
    pub const RESERVED: usize = 24;
    pub const SIZE: usize = 32;
}

/// Offsets in one entry of the section table.
pub mod entry {
    /// u16
    pub const TAG: usize = 0;
    /// u16, zero
    pub const RESERVED: usize = 2;
    /// u32, from the start of the block
    pub const OFFSET: usize = 4;
    /// u32
    pub const LENGTH: usize = 8;
    pub const SIZE: usize = 12;
}

/// Bytes of the CRC at the end.
pub const CRC_SIZE: usize = 4;
/// Sections start at multiples of this.
pub const ALIGNMENT: usize = 4;

/// The sections, by tag. Every model has all of them; those of the other kind of model are empty: a model with a memory
/// (H > 0, see [`crate::mge`]) has no densities and no local linear maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u16)]
pub enum Section {
    /// Sizes, see [`shape`].
    Shape = 0,
    /// Run-time settings, see [`settings`].
    Settings = 1,
    /// u8 `[P]`: viseme of each phone.
    PhoneVisemes = 2,
    /// `[P][4]`: names in ASCII, filled up with zeros.
    PhoneNames = 3,
    /// i16 `[13]`, Q7.8: where the causal mean starts.
    StartMean = 4,
    /// i16 `[39]`, Q7.8: taken off an observation before the densities see it.
    ObservationCentre = 5,
    /// u32 `[39]`, Q16.16: then multiplied by this, which gives sixteenths of a density's mean LSB.
    ObservationGain = 6,
    /// `[5P][K]` of (i8 `[39]` means, u8 `[39]` inverse deviations).
    Densities = 7,
    /// i32 `[5P][K]`, LSB 2⁻¹² bit: log2 of weight and normaliser; [`NO_DENSITY`] for one that is not used.
    DensityConstants = 8,
    /// i16 `[P][15][4]`, Q5.10 log2.
    Transitions = 9,
    /// i16 `[P][P]`, Q5.10 log2 of P(next | phone).
    Bigram = 10,
    /// i16 `[P][13]`, Q5.10 log2 of P(viseme of the next phone | phone).
    VisemeBigram = 11,
    /// i16 `[P]`, Q5.10 log2 of P(first phone).
    Initial = 12,
    /// i8 `[T]`: hops relative to the frame, increasing.
    Taps = 13,
    /// i16 `[X][13(T + M)]`, mantissas; the sizes of a row's add up to less than 2¹⁶.
    Projection = 14,
    /// u8 `[X]`: the sum of a row is shifted down by this to x in Q5.11, or to z in Q5.10 in a model with a memory.
    ProjectionShift = 15,
    /// i32 `[X]`, Q5.11 or Q5.10: then taken off.
    ProjectionOffset = 16,
    /// i16 `[D][X]`, mantissas.
    GlobalMap = 17,
    /// u8 `[D]`: the sum of a row is shifted down by this to parameter LSBs in Q8.
    GlobalShift = 18,
    /// i32 `[D]`, parameter LSBs in Q8.
    GlobalBias = 19,
    /// i8 `[65][D][X]`.
    StateMaps = 20,
    /// u16 `[65][D]`, Q8.8: parameter LSBs per unit of x and LSB of the map.
    StateScale = 21,
    /// i16 `[65][D]`, parameter LSBs.
    StateBias = 22,
    /// f32 `[D]`: real units of one parameter LSB. Carried for the host, never computed with here.
    ParameterScale = 23,
    /// u8 `[M]`: rates of the context's exponential means, as right shifts.
    MeanShifts = 24,
    /// U: i8 `[5P][Z]`; i32 `[5P]`; i32 `[5P]`, log2, LSB 2⁻¹² bit. See [`Matrix`] for all that follow.
    AudioWeights = 25,
    AudioScale = 26,
    AudioBias = 27,
    /// F: i8 `[65][D]`; i32; i32 `[65]`, log2, LSB 2⁻¹² bit.
    VisualWeights = 28,
    VisualScale = 29,
    VisualBias = 30,
    /// V_d: i8 `[H][Z]` in blocks; i32; no bias.
    DriveWeights = 31,
    DriveScale = 32,
    /// W₀: i8 `[D][Z]` in blocks; i32; i32 `[D]`, Q10.
    OutputWeights = 33,
    OutputScale = 34,
    OutputBias = 35,
    /// O: i8 `[D][H]` in blocks; i32; no bias.
    MemoryWeights = 36,
    MemoryScale = 37,
    /// Per audio state: i8 gains `[H]`, drives `[H]` and offsets `[D]` if the audio states have maps; u8 rates `[H]` if
    /// they have rates.
    AudioGates = 38,
    /// i32 `[5P][3]`: scales of gains, drives, offsets, LSB 2⁻²⁴.
    AudioGateScale = 39,
    /// The same of the visual states.
    VisualGates = 40,
    VisualGateScale = 41,
    /// i16 `[H]`, Q5.10: the memory before the first frame.
    FirstMemory = 42,
    /// i16 `[D]`, parameter LSBs: taken off a mouth before the visual densities see it. This and what follows is there where
    /// L > 0: what [`crate::hmm::feedback`] needs.
    ParameterCentre = 43,
    /// u32 `[D]`, Q16.16: then multiplied by this, which gives sixteenths of a visual density's mean LSB.
    ParameterGain = 44,
    /// `[65][L]` of (i8 `[D]` means, u8 `[D]` inverse deviations).
    VisualDensities = 45,
    /// i32 `[65][L]`, as [`Section::DensityConstants`].
    VisualDensityConstants = 46,
    /// i16 `[65][D]`, parameter LSBs: mean of each visual state's mixture.
    VisualCentres = 47,
}

/// Rows, and columns of each, that lie together in a matrix in blocks: [`BLOCK`]² bytes are four columns of four rows, row
/// by row; then come the next four columns of these rows. In either layout a weight w is the byte w + 128, and columns (in
/// blocks rows too) are filled up to a multiple of four with weights 0.
pub const BLOCK: usize = 4;

/// Bytes of a matrix row by row.
pub const fn rows_size(rows: usize, columns: usize) -> usize {
    rows * columns.div_ceil(BLOCK) * BLOCK
}

/// Bytes of a matrix in blocks.
pub const fn blocks_size(rows: usize, columns: usize) -> usize {
    rows.div_ceil(BLOCK) * columns.div_ceil(BLOCK) * BLOCK * BLOCK
}

/// A matrix of i8 weights with a scale a row and perhaps a bias: row r of the product with u is
/// bias_r + (scale_r·Σ weight·u) / 2²⁴.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Matrix {
    pub weights: Section,
    pub scale: Section,
    pub bias: Option<Section>,
    /// Whether the weights lie in blocks, not row by row.
    pub in_blocks: bool,
}

impl Matrix {
    pub const AUDIO: Self = Self {
        weights: Section::AudioWeights,
        scale: Section::AudioScale,
        bias: Some(Section::AudioBias),
        in_blocks: false,
    };
    pub const VISUAL: Self = Self {
        weights: Section::VisualWeights,
        scale: Section::VisualScale,
        bias: Some(Section::VisualBias),
        in_blocks: false,
    };
    pub const DRIVE: Self = Self {
        weights: Section::DriveWeights,
        scale: Section::DriveScale,
        bias: None,
        in_blocks: true,
    };
    pub const OUTPUT: Self = Self {
        weights: Section::OutputWeights,
        scale: Section::OutputScale,
        bias: Some(Section::OutputBias),
        in_blocks: true,
    };
    pub const MEMORY: Self = Self {
        weights: Section::MemoryWeights,
        scale: Section::MemoryScale,
        bias: None,
        in_blocks: true,
    };
    pub const ALL: [Self; 5] = [Self::AUDIO, Self::VISUAL, Self::DRIVE, Self::OUTPUT, Self::MEMORY];
}

/// Fraction bits of a matrix row's scale.
pub const SCALE_FRACTION_BITS: u32 = 24;
/// Fraction bits of z, of the memory that the output reads, and of the mouth: parameters come in 1/1024.
pub const SIGNAL_FRACTION_BITS: u32 = 10;

impl Section {
    pub const ALL: [Section; N_SECTIONS] = [
        Section::Shape,
        Section::Settings,
        Section::PhoneVisemes,
        Section::PhoneNames,
        Section::StartMean,
        Section::ObservationCentre,
        Section::ObservationGain,
        Section::Densities,
        Section::DensityConstants,
        Section::Transitions,
        Section::Bigram,
        Section::VisemeBigram,
        Section::Initial,
        Section::Taps,
        Section::Projection,
        Section::ProjectionShift,
        Section::ProjectionOffset,
        Section::GlobalMap,
        Section::GlobalShift,
        Section::GlobalBias,
        Section::StateMaps,
        Section::StateScale,
        Section::StateBias,
        Section::ParameterScale,
        Section::MeanShifts,
        Section::AudioWeights,
        Section::AudioScale,
        Section::AudioBias,
        Section::VisualWeights,
        Section::VisualScale,
        Section::VisualBias,
        Section::DriveWeights,
        Section::DriveScale,
        Section::OutputWeights,
        Section::OutputScale,
        Section::OutputBias,
        Section::MemoryWeights,
        Section::MemoryScale,
        Section::AudioGates,
        Section::AudioGateScale,
        Section::VisualGates,
        Section::VisualGateScale,
        Section::FirstMemory,
        Section::ParameterCentre,
        Section::ParameterGain,
        Section::VisualDensities,
        Section::VisualDensityConstants,
        Section::VisualCentres,
    ];
}

pub const N_SECTIONS: usize = 48;

/// Offsets in [`Section::Shape`], all u16.
pub mod shape {
    /// P
    pub const PHONES: usize = 0;
    /// K, densities of a mixture; 0 in a model with a memory
    pub const DENSITIES: usize = 2;
    /// T, context taps
    pub const TAPS: usize = 4;
    /// X (local linear) or Z (with a memory), numbers that the maps read
    pub const INPUTS: usize = 6;
    /// D
    pub const PARAMETERS: usize = 8;
    /// H, numbers in the memory; 0 in a local linear model
    pub const MEMORY: usize = 10;
    /// M, exponential means of the context
    pub const MEANS: usize = 12;
    /// Which states own what, see [`super::owns`].
    pub const OWNS: usize = 14;
    /// L, densities of a visual mixture; 0 where the tables have none
    pub const VISUAL_DENSITIES: usize = 16;
    pub const SIZE: usize = 18;
}

/// Bits of [`shape::OWNS`].
pub mod owns {
    pub const AUDIO_MAPS: u16 = 1;
    pub const AUDIO_RATES: u16 = 2;
    pub const VISUAL_MAPS: u16 = 4;
    pub const VISUAL_RATES: u16 = 8;
    /// The last mouth feeds back into the visual emissions.
    pub const FEEDBACK: u16 = 16;
    pub const ALL: u16 = 31;
}

/// Offsets in [`Section::Settings`].
pub mod settings {
    /// u16, hops
    pub const LAG: usize = 0;
    /// u16, 1 = average three frames, 0 = do not
    pub const AVERAGE: usize = 2;
    /// i32, bits, LSB 2⁻¹²
    pub const BEAM: usize = 4;
    /// u32, Q16.16: exponent on the audio likelihood
    pub const ACOUSTIC_SCALE: usize = 8;
    /// u32, LSB 2⁻²⁰: log2 units of 2⁻¹² for one unit of a density's squared distance
    pub const DISTANCE_GAIN: usize = 12;
    /// u32, the same of the visual densities
    pub const VISUAL_DISTANCE_GAIN: usize = 16;
    pub const SIZE: usize = 20;
}

/// Constant of a density that is not used.
pub const NO_DENSITY: i32 = i32::MIN;

/// Fraction bits of what the projection gives (x, i16).
pub const INPUT_FRACTION_BITS: u32 = 11;
/// Fraction bits below a parameter LSB in sums.
pub const SUM_FRACTION_BITS: u32 = 8;
/// A density's mean LSB is 2⁴ LSBs of a centred and scaled observation.
pub const MEAN_SHIFT: u32 = 4;
/// Centred and scaled observations are held to ± this: ±8191 of 2⁻⁴ mean LSBs.
pub const OBSERVATION_LIMIT: i32 = 8191;
/// (difference · inverse deviation) is shifted down by this before it is squared.
pub const DISTANCE_SHIFT: u32 = 9;

/// Limits of every size; the sizes of the core's buffers.
pub mod limit {
    pub const PHONES: usize = 48;
    pub const DENSITIES: usize = 32;
    pub const TAPS: usize = 32;
    pub const INPUTS: usize = 96;
    pub const PARAMETERS: usize = crate::parameters::MAX_PARAMETERS;
    pub const MEMORY: usize = 192;
    /// Scales of a matrix in blocks are less, LSB 2⁻²⁴.
    pub const BLOCK_SCALE: i32 = 1 << 23;
    pub const MEANS: usize = 6;
    /// Slowest exponential mean: 2⁻¹².
    pub const MEAN_SHIFT: u8 = 12;
    /// Earliest and latest context tap, hops.
    pub const FIRST_TAP: i8 = -40;
    pub const LAST_TAP: i8 = 16;
    /// Largest right shift of a sum.
    pub const SHIFT: u8 = 40;
    /// Largest |constant| of a density, LSBs of 2⁻¹²: 16384 bits.
    pub const CONSTANT: i32 = 1 << 26;
    /// Largest gain on a squared distance.
    pub const DISTANCE_GAIN: u32 = 1 << 28;
    /// Largest acoustic scale, Q16.16: 4.
    pub const ACOUSTIC_SCALE: u32 = 4 << 16;
    /// Widest beam, LSBs of 2⁻¹²: 16384 bits, no beam at all.
    pub const BEAM: i32 = 1 << 26;
    /// Largest gain on an observation or on a mouth, Q16.16.
    pub const OBSERVATION_GAIN: u32 = 1 << 30;
    /// Largest |bias| or |offset| of a sum.
    pub const OFFSET: i32 = 1 << 30;
}

/// States of a phone or viseme.
pub const N_EMITTING: usize = 5;
/// Visual states: 5 · viseme + j.
pub const N_VISUAL_STATES: usize = N_EMITTING * N_VISEMES;
/// Bytes of a phone's name.
pub const NAME_SIZE: usize = 4;
/// Bytes of one density: means, then inverse deviations.
pub const DENSITY_SIZE: usize = 2 * N_OBSERVATION;

/// Sizes of one model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// P
    pub phones: usize,
    /// K, densities of a mixture
    pub densities: usize,
    /// T, context taps
    pub taps: usize,
    /// X (local linear) or Z (with a memory), numbers that the maps read
    pub inputs: usize,
    /// D
    pub parameters: usize,
    /// H, numbers in the memory; 0 in a local linear model
    pub memory: usize,
    /// M, exponential means of the context
    pub means: usize,
    /// Bits of [`owns`].
    pub owns: u16,
    /// L, densities of a visual mixture; 0 where the tables have none
    pub visual_densities: usize,
}

impl Shape {
    /// Bytes of a section in a model of these sizes. No overflow within [`limit`].
    pub const fn length(&self, section: Section) -> usize {
        let Shape {
            phones: p,
            densities: k,
            taps: t,
            inputs: x,
            parameters: d,
            memory: h,
            means: m,
            owns: _,
            visual_densities: l,
        } = *self;
        let (s, v) = (N_EMITTING * p, N_VISUAL_STATES);
        // 1 or 0: what only a local linear model has, and what only a model with a memory has.
        let linear = (h == 0) as usize;
        let recurrent = 1 - linear;
        // 1 or 0: whether the mouth can be re-estimated.
        let seen = (l > 0) as usize;
        match section {
            Section::Shape => shape::SIZE,
            Section::Settings => settings::SIZE,
            Section::PhoneVisemes => p,
            Section::PhoneNames => NAME_SIZE * p,
            Section::StartMean => 2 * N_STATIC,
            Section::ObservationCentre => 2 * N_OBSERVATION * linear,
            Section::ObservationGain => 4 * N_OBSERVATION * linear,
            Section::Densities => s * k * DENSITY_SIZE,
            Section::DensityConstants => 4 * s * k,
            Section::Transitions => 2 * p * N_CLASSES * 4,
            Section::Bigram => 2 * p * p,
            Section::VisemeBigram => 2 * p * N_VISEMES,
            Section::Initial => 2 * p,
            Section::Taps => t,
            Section::Projection => 2 * x * self.context(),
            Section::ProjectionShift => x,
            Section::ProjectionOffset => 4 * x,
            Section::GlobalMap => 2 * d * x * linear,
            Section::GlobalShift => d * linear,
            Section::GlobalBias => 4 * d * linear,
            Section::StateMaps => v * d * x * linear,
            Section::StateScale => 2 * v * d * linear,
            Section::StateBias => 2 * v * d * linear,
            Section::ParameterScale => 4 * d,
            Section::MeanShifts => m,
            Section::AudioWeights => rows_size(s, x) * recurrent,
            Section::AudioScale | Section::AudioBias => 4 * s * recurrent,
            Section::VisualWeights => rows_size(v, self.fed_back()),
            Section::VisualScale | Section::VisualBias => 4 * v * recurrent,
            Section::DriveWeights => blocks_size(h, x),
            Section::DriveScale => 4 * h,
            Section::OutputWeights => blocks_size(d, x) * recurrent,
            Section::OutputScale | Section::OutputBias => 4 * d * recurrent,
            Section::MemoryWeights => blocks_size(d, h),
            Section::MemoryScale => 4 * d * recurrent,
            Section::AudioGates => s * self.gate(owns::AUDIO_MAPS, owns::AUDIO_RATES),
            Section::AudioGateScale => 12 * s * recurrent,
            Section::VisualGates => v * self.gate(owns::VISUAL_MAPS, owns::VISUAL_RATES),
            Section::VisualGateScale => 12 * v * recurrent,
            Section::FirstMemory => 2 * h,
            Section::ParameterCentre => 2 * d * seen,
            Section::ParameterGain => 4 * d * seen,
            Section::VisualDensities => v * l * 2 * d,
            Section::VisualDensityConstants => 4 * v * l,
            Section::VisualCentres => 2 * v * d * seen,
        }
    }

    /// Numbers in a context: 13(T + M).
    pub const fn context(&self) -> usize {
        N_STATIC * (self.taps + self.means)
    }

    /// Whether the states of a chain own what `bit` of [`owns`] says.
    pub const fn owns(&self, bit: u16) -> bool {
        self.owns & bit != 0
    }

    /// Numbers that feed back into the visual emissions.
    pub const fn fed_back(&self) -> usize {
        if self.owns(owns::FEEDBACK) {
            self.parameters
        } else {
            0
        }
    }

    /// Bytes of one state's gate.
    pub const fn gate(&self, maps: u16, rates: u16) -> usize {
        let of_maps = if self.owns(maps) {
            2 * self.memory + self.parameters
        } else {
            0
        };
        of_maps + if self.owns(rates) { self.memory } else { 0 }
    }
}

static CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);

/// The checksum of models: the CRC-32 of zip and PNG.
pub fn checksum(bytes: &[u8]) -> u32 {
    CRC.checksum(bytes)
}
