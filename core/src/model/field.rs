//! Layout of the model's tables (format version 1). Every offset and every length is here and only here.
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
pub const FORMAT_VERSION: u16 = 1;
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

/// The sections, by tag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
    /// i16 `[X][13T]`, mantissas.
    Projection = 14,
    /// u8 `[X]`: the sum of a row is shifted down by this to x in Q5.11.
    ProjectionShift = 15,
    /// i32 `[X]`, Q5.11: then taken off.
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
}

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
    ];
}

pub const N_SECTIONS: usize = 24;

/// Offsets in [`Section::Shape`], all u16.
pub mod shape {
    /// P
    pub const PHONES: usize = 0;
    /// K, densities of a mixture
    pub const DENSITIES: usize = 2;
    /// T, context taps
    pub const TAPS: usize = 4;
    /// X, numbers that the maps read
    pub const INPUTS: usize = 6;
    /// D
    pub const PARAMETERS: usize = 8;
    /// zero
    pub const RESERVED: usize = 10;
    pub const SIZE: usize = 12;
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
    pub const SIZE: usize = 16;
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
    /// Largest gain on an observation, Q16.16.
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
    /// X, numbers that the maps read
    pub inputs: usize,
    /// D
    pub parameters: usize,
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
        } = *self;
        let (s, v) = (N_EMITTING * p, N_VISUAL_STATES);
        match section {
            Section::Shape => shape::SIZE,
            Section::Settings => settings::SIZE,
            Section::PhoneVisemes => p,
            Section::PhoneNames => NAME_SIZE * p,
            Section::StartMean => 2 * N_STATIC,
            Section::ObservationCentre => 2 * N_OBSERVATION,
            Section::ObservationGain => 4 * N_OBSERVATION,
            Section::Densities => s * k * DENSITY_SIZE,
            Section::DensityConstants => 4 * s * k,
            Section::Transitions => 2 * p * N_CLASSES * 4,
            Section::Bigram => 2 * p * p,
            Section::VisemeBigram => 2 * p * N_VISEMES,
            Section::Initial => 2 * p,
            Section::Taps => t,
            Section::Projection => 2 * x * t * N_STATIC,
            Section::ProjectionShift => x,
            Section::ProjectionOffset => 4 * x,
            Section::GlobalMap => 2 * d * x,
            Section::GlobalShift => d,
            Section::GlobalBias => 4 * d,
            Section::StateMaps => v * d * x,
            Section::StateScale => 2 * v * d,
            Section::StateBias => 2 * v * d,
            Section::ParameterScale => 4 * d,
        }
    }
}

static CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);

/// The checksum of models: the CRC-32 of zip and PNG.
pub fn checksum(bytes: &[u8]) -> u32 {
    CRC.checksum(bytes)
}
