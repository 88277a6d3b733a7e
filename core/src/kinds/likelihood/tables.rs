//! The sections of a likelihood-trained model, and their writers.
use super::Likelihood;
use crate::N_OBSERVATION;
use crate::context::ContextTables;
use crate::context::tables::SumRows;
use crate::hmm::HmmTables;
use crate::hmm::search::MAX_BEAM;
use crate::hmm::transition::{N_EMITTING, N_VISUAL_STATES};
use crate::logmath::LogProb;
use crate::model::container::{Section, Sections, check};
use crate::model::{
    Head, I16s, ModelError, U16s, i32s, put_i16s, put_i32s, put_u16s, put_u32s, u16_at, u32_at,
};

/// Run-time settings, see [`put_settings`].
pub const SETTINGS: Section = Section::new(0x1000, "LikelihoodSettings");
/// i16 `[39]`, Q7.8: taken off an observation before the densities see it.
pub const OBSERVATION_CENTRE: Section = Section::new(0x1001, "ObservationCentre");
/// u32 `[39]`, Q16.16: then multiplied by this, which gives sixteenths of a density's mean LSB.
pub const OBSERVATION_GAIN: Section = Section::new(0x1002, "ObservationGain");
/// `[5P][K]` of (i8 `[39]` means, u8 `[39]` inverse deviations).
pub const DENSITIES: Section = Section::new(0x1003, "Densities");
/// i32 `[5P][K]`, LSB 2⁻¹² bit: log2 of weight and normaliser; [`NO_DENSITY`] for one that is not used.
pub const DENSITY_CONSTANTS: Section = Section::new(0x1004, "DensityConstants");
/// i16 `[D][X]`, mantissas.
pub const GLOBAL_MAP: Section = Section::new(0x1005, "GlobalMap");
/// u8 `[D]`: the sum of a row is shifted down by this to parameter LSBs in Q8.
pub const GLOBAL_SHIFT: Section = Section::new(0x1006, "GlobalShift");
/// i32 `[D]`, parameter LSBs in Q8.
pub const GLOBAL_BIAS: Section = Section::new(0x1007, "GlobalBias");
/// i8 `[65][D][X]`.
pub const STATE_MAPS: Section = Section::new(0x1008, "StateMaps");
/// u16 `[65][D]`, Q8.8: parameter LSBs per unit of x and LSB of the map.
pub const STATE_SCALE: Section = Section::new(0x1009, "StateScale");
/// i16 `[65][D]`, parameter LSBs.
pub const STATE_BIAS: Section = Section::new(0x100a, "StateBias");
/// i16 `[D]`, parameter LSBs: taken off a mouth before the visual densities see it. This and what follows is what
/// [`feedback`](super::feedback) needs; models without have none of these sections.
pub const PARAMETER_CENTRE: Section = Section::new(0x100b, "ParameterCentre");
/// u32 `[D]`, Q16.16: then multiplied by this, which gives sixteenths of a visual density's mean LSB.
pub const PARAMETER_GAIN: Section = Section::new(0x100c, "ParameterGain");
/// `[65][L]` of (i8 `[D]` means, u8 `[D]` inverse deviations).
pub const VISUAL_DENSITIES: Section = Section::new(0x100d, "VisualDensities");
/// i32 `[65][L]`, as [`DENSITY_CONSTANTS`].
pub const VISUAL_DENSITY_CONSTANTS: Section = Section::new(0x100e, "VisualDensityConstants");
/// i16 `[65][D]`, parameter LSBs: mean of each visual state's mixture.
pub const VISUAL_CENTRES: Section = Section::new(0x100f, "VisualCentres");

/// Most densities of a mixture.
pub const MAX_DENSITIES: usize = 32;
/// Largest |constant| of a density, LSBs of 2⁻¹²: 16384 bits.
pub const MAX_CONSTANT: i32 = 1 << 26;
/// Largest gain on a squared distance.
pub const MAX_DISTANCE_GAIN: u32 = 1 << 28;
/// Largest acoustic scale, Q16.16: 4.
pub const MAX_ACOUSTIC_SCALE: u32 = 4 << 16;
/// Largest gain on an observation or on a mouth, Q16.16.
pub const MAX_GAIN: u32 = 1 << 30;

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

/// Offsets in [`SETTINGS`].
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
    /// Bytes of the section.
    pub const SIZE: usize = 20;
}

/// The run-time settings that a likelihood-trained model was made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OwnSettings {
    /// Hops of fixed-lag smoothing.
    pub lag: u16,
    /// Whether three frames are averaged.
    pub average: bool,
    /// Width of the beam.
    pub beam: LogProb,
    /// Exponent on the audio likelihood, Q16.16.
    pub acoustic_scale: u32,
    /// LSB 2⁻²⁰: log2 units of 2⁻¹² for one unit of a density's squared distance.
    pub distance_gain: u32,
    /// The same of the visual densities.
    pub visual_distance_gain: u32,
}

impl OwnSettings {
    fn read(sections: &mut Sections) -> Result<Self, ModelError> {
        let bytes = sections.take_sized(SETTINGS, settings::SIZE)?;
        let beam = u32_at(bytes, settings::BEAM);
        let out = Self {
            lag: u16_at(bytes, settings::LAG),
            average: u16_at(bytes, settings::AVERAGE) == 1,
            beam: LogProb::from_q12(beam as i32),
            acoustic_scale: u32_at(bytes, settings::ACOUSTIC_SCALE),
            distance_gain: u32_at(bytes, settings::DISTANCE_GAIN),
            visual_distance_gain: u32_at(bytes, settings::VISUAL_DISTANCE_GAIN),
        };
        check(
            SETTINGS,
            [
                u16_at(bytes, settings::AVERAGE) <= 1,
                beam > 0 && beam <= MAX_BEAM as u32,
                out.acoustic_scale <= MAX_ACOUSTIC_SCALE,
                out.distance_gain <= MAX_DISTANCE_GAIN,
                out.visual_distance_gain <= MAX_DISTANCE_GAIN,
            ],
        )?;
        Ok(out)
    }
}

/// Writes [`SETTINGS`]; the fields in the order of the offsets in [`settings`].
pub fn put_settings(to: &mut impl Extend<u8>, own: &OwnSettings) {
    put_u16s(to, [own.lag, u16::from(own.average)]);
    put_i32s(to, [own.beam.q12()]);
    put_u32s(
        to,
        [own.acoustic_scale, own.distance_gain, own.visual_distance_gain],
    );
}

/// Mixtures of Gaussians with diagonal covariances over vectors of N numbers, one mixture a state.
#[derive(Clone, Copy, Debug)]
pub struct MixtureTables<'a> {
    centre: I16s<'a>,
    gain: &'a [u8],
    densities: &'a [u8],
    constants: &'a [u8],
    /// Densities of a state.
    count: usize,
    /// N
    size: usize,
    distance_gain: u32,
}

/// One density of a mixture, as it lies in the tables.
#[derive(Clone, Copy, Debug)]
pub struct Density<'a> {
    /// log2 of weight and normaliser; None for one that is not used.
    pub constant: Option<LogProb>,
    /// Means, i8 two's complement, as many as the mixture's numbers.
    pub mean: &'a [u8],
    /// Inverse deviations, as many.
    pub inverse_deviation: &'a [u8],
}

impl<'a> MixtureTables<'a> {
    const NONE: Self = Self {
        centre: I16s(&[]),
        gain: &[],
        densities: &[],
        constants: &[],
        count: 0,
        size: 0,
        distance_gain: 0,
    };

    /// Takes the four sections of `states` mixtures over `size` numbers: centre, gain, densities, constants.
    fn read(
        sections: &mut Sections<'a>,
        [centre, gain, densities, constants]: [Section; 4],
        [states, size]: [usize; 2],
        least_gain: u32,
        distance_gain: u32,
    ) -> Result<Self, ModelError> {
        let (constant_bytes, count) = sections.take_items(constants, 4 * states, MAX_DENSITIES)?;
        let out = Self {
            centre: I16s(sections.take_sized(centre, 2 * size)?),
            gain: sections.take_sized(gain, 4 * size)?,
            densities: sections.take_sized(densities, states * count * 2 * size)?,
            constants: constant_bytes,
            count,
            size,
            distance_gain,
        };
        check(
            gain,
            out.scaling()
                .map(|(_, gain)| (least_gain..=MAX_GAIN).contains(&gain)),
        )?;
        check(
            constants,
            i32s(constant_bytes).map(|c| c == NO_DENSITY || (-MAX_CONSTANT..=MAX_CONSTANT).contains(&c)),
        )?;
        Ok(out)
    }

    /// Centre and gain (Q16.16) of each of the N numbers.
    #[inline(always)]
    pub fn scaling(&self) -> impl Iterator<Item = (i16, u32)> + use<'a> {
        let gains = self.gain.as_chunks().0;
        self.centre
            .iter()
            .zip(gains.iter().map(|b| u32::from_le_bytes(*b)))
    }

    /// LSB 2⁻²⁰: log2 units of 2⁻¹² for one unit of a density's squared distance.
    #[inline]
    pub fn distance_gain(&self) -> u32 {
        self.distance_gain
    }

    /// The densities of a state.
    #[inline(always)]
    pub fn of(&self, state: usize) -> impl Iterator<Item = Density<'a>> + use<'a> {
        let size = self.size;
        let of_state =
            |bytes: &'a [u8], each: usize| bytes.get(state * each..(state + 1) * each).unwrap_or(&[]);
        // At least one byte, so that mixtures that are not there have no densities.
        let halves = of_state(self.densities, self.count * 2 * size).chunks_exact((2 * size).max(1));
        let constants = of_state(self.constants, self.count * 4).as_chunks().0;
        constants.iter().zip(halves).map(move |(constant, both)| {
            let constant = i32::from_le_bytes(*constant);
            let (mean, inverse_deviation) = both.split_at_checked(size).unwrap_or((&[], &[]));
            Density {
                constant: (constant != NO_DENSITY).then_some(LogProb::from_q12(constant)),
                mean,
                inverse_deviation,
            }
        })
    }
}

/// Writes centre and gain of one number into [`OBSERVATION_CENTRE`] and [`OBSERVATION_GAIN`], or those of parameters.
pub fn put_scaling<E: Extend<u8>>(centres: &mut E, gains: &mut E, centre: i16, gain: u32) {
    put_i16s(centres, [centre]);
    put_u32s(gains, [gain]);
}

/// Writes one density into [`DENSITIES`] and [`DENSITY_CONSTANTS`], or the visual ones: as many means as inverse deviations.
pub fn put_density<E: Extend<u8>>(
    densities: &mut E,
    constants: &mut E,
    means: impl IntoIterator<Item = i8>,
    inverse_deviations: impl IntoIterator<Item = u8>,
    constant: i32,
) {
    densities.extend(means.into_iter().map(|mean| mean as u8));
    densities.extend(inverse_deviations);
    put_i32s(constants, [constant]);
}

/// The residual maps of the visual states.
#[derive(Clone, Copy, Debug)]
pub(super) struct StateMaps<'a> {
    weights: &'a [u8],
    scale: U16s<'a>,
    bias: I16s<'a>,
    n_inputs: usize,
    n_parameters: usize,
}

/// One row of a residual map.
#[derive(Clone, Copy, Debug)]
pub struct StateRow<'a> {
    /// i8 two's complement, `[X]`
    pub weights: &'a [u8],
    /// Q8.8: parameter LSBs per unit of x and LSB of the weights.
    pub scale: u16,
    /// Parameter LSBs.
    pub bias: i16,
}

impl<'a> StateMaps<'a> {
    fn read(sections: &mut Sections<'a>, d: usize, x: usize) -> Result<Self, ModelError> {
        let v = N_VISUAL_STATES;
        Ok(Self {
            weights: sections.take_sized(STATE_MAPS, v * d * x)?,
            scale: U16s(sections.take_sized(STATE_SCALE, 2 * v * d)?),
            bias: I16s(sections.take_sized(STATE_BIAS, 2 * v * d)?),
            n_inputs: x,
            n_parameters: d,
        })
    }

    #[inline]
    pub(super) fn rows(&self, visual_state: usize) -> impl Iterator<Item = StateRow<'a>> + use<'a> {
        let (x, d) = (self.n_inputs, self.n_parameters);
        let size = d * x;
        let weights = self
            .weights
            .get(visual_state * size..(visual_state + 1) * size)
            .unwrap_or(&[]);
        weights
            .chunks_exact(x)
            .zip(self.scale.row(visual_state, d).iter())
            .zip(self.bias.row(visual_state, d).iter())
            .map(|((weights, scale), bias)| StateRow { weights, scale, bias })
    }
}

/// Writes one row of a residual map into [`STATE_MAPS`], [`STATE_SCALE`] and [`STATE_BIAS`].
pub fn put_state_row<E: Extend<u8>>(
    [maps, scales, biases]: [&mut E; 3],
    weights: impl IntoIterator<Item = i8>,
    scale: u16,
    bias: i16,
) {
    maps.extend(weights.into_iter().map(|w| w as u8));
    put_u16s(scales, [scale]);
    put_i16s(biases, [bias]);
}

/// Writes the mean of one visual state's mixture into [`VISUAL_CENTRES`], parameter LSBs.
pub fn put_visual_centre(to: &mut impl Extend<u8>, centre: impl IntoIterator<Item = i16>) {
    put_i16s(to, centre);
}

pub(super) fn read<'a>(sections: &mut Sections<'a>, head: &Head<'a>) -> Result<Likelihood<'a>, ModelError> {
    let settings = OwnSettings::read(sections)?;
    let hmm = HmmTables::read(sections)?;
    let context = ContextTables::read(sections, 0)?;
    let (d, x) = (head.n_parameters(), context.n_inputs());
    let audio = MixtureTables::read(
        sections,
        [OBSERVATION_CENTRE, OBSERVATION_GAIN, DENSITIES, DENSITY_CONSTANTS],
        [N_EMITTING * hmm.n_phones(), N_OBSERVATION],
        0,
        settings.distance_gain,
    )?;
    let global_map = SumRows::read(sections, [GLOBAL_MAP, GLOBAL_SHIFT, GLOBAL_BIAS], Some(d), x)?;
    let state_maps = StateMaps::read(sections, d, x)?;
    let centres = sections.take_if_there(VISUAL_CENTRES);
    let visual = match centres {
        None => MixtureTables::NONE,
        Some(_) => MixtureTables::read(
            sections,
            [
                PARAMETER_CENTRE,
                PARAMETER_GAIN,
                VISUAL_DENSITIES,
                VISUAL_DENSITY_CONSTANTS,
            ],
            [N_VISUAL_STATES, d],
            1,
            settings.visual_distance_gain,
        )?,
    };
    let centres = centres.unwrap_or(&[]);
    let want = if visual.count > 0 {
        2 * N_VISUAL_STATES * d
    } else {
        0
    };
    if centres.len() != want {
        return Err(ModelError::SectionLength {
            section: VISUAL_CENTRES,
            have: centres.len(),
            want,
        });
    }
    Ok(Likelihood {
        hmm,
        context,
        settings,
        audio,
        global_map,
        state_maps,
        visual,
        visual_centres: I16s(centres),
        n_parameters: d,
    })
}
