//! The check of a model's bytes: layout first, then every number that could lead the converter astray.
use super::error::{ModelError, Size};
use super::field::{
    self, ALIGNMENT, CRC_SIZE, FORMAT_VERSION, FRONT_END_FINGERPRINT, MAGIC, N_SECTIONS, NAME_SIZE, Section,
    Shape, entry, header, limit, owns, settings, shape,
};
use super::view::{Model, is_never, is_probability, u16_at, u32_at};
use crate::parameters::N_VISEMES;

/// Header, checksum, section table, sizes; gives the sections by tag.
pub(super) fn layout(bytes: &[u8]) -> Result<(Shape, [&[u8]; N_SECTIONS]), ModelError> {
    let have = bytes.len();
    if bytes.get(..MAGIC.len()).is_some_and(|b| b != MAGIC) {
        return Err(ModelError::NoModel);
    }
    let need = header::SIZE + N_SECTIONS * entry::SIZE + CRC_SIZE;
    if have < need {
        return Err(ModelError::TooShort { have, need });
    }
    let version = u16_at(bytes, header::VERSION);
    if version != FORMAT_VERSION {
        return Err(ModelError::Version {
            have: version,
            want: FORMAT_VERSION,
        });
    }
    let stated = u32_at(bytes, header::LENGTH) as usize;
    if stated > have {
        return Err(ModelError::TooShort { have, need: stated });
    }
    if stated != have {
        return Err(ModelError::Length { stated, have });
    }
    let (body, _) = bytes.split_at(have - CRC_SIZE);
    let stated = u32_at(bytes, have - CRC_SIZE);
    let computed = field::checksum(body);
    if stated != computed {
        return Err(ModelError::Checksum { stated, computed });
    }
    let front_end = u32_at(bytes, header::FRONT_END);
    if front_end != FRONT_END_FINGERPRINT {
        return Err(ModelError::FrontEnd {
            have: front_end,
            want: FRONT_END_FINGERPRINT,
        });
    }
    let sections = sections(body)?;
    let shape = sizes(sections[Section::Shape as usize])?;
    for section in Section::ALL {
        let (have, want) = (sections[section as usize].len(), shape.length(section));
        if have != want {
            return Err(ModelError::SectionLength { section, have, want });
        }
    }
    Ok((shape, sections))
}

fn sections(body: &[u8]) -> Result<[&[u8]; N_SECTIONS], ModelError> {
    if usize::from(u16_at(body, header::N_SECTIONS)) != N_SECTIONS {
        return Err(ModelError::SectionTable { entry: N_SECTIONS });
    }
    let start = header::SIZE + N_SECTIONS * entry::SIZE;
    let mut found: [Option<&[u8]>; N_SECTIONS] = [None; N_SECTIONS];
    for at in 0..N_SECTIONS {
        let base = header::SIZE + at * entry::SIZE;
        let tag = usize::from(u16_at(body, base + entry::TAG));
        let Some(&section) = Section::ALL.get(tag) else {
            return Err(ModelError::SectionTable { entry: at });
        };
        let offset = u32_at(body, base + entry::OFFSET) as usize;
        let length = u32_at(body, base + entry::LENGTH) as usize;
        let bytes = offset
            .checked_add(length)
            .and_then(|end| body.get(offset..end))
            .filter(|_| offset >= start && offset.is_multiple_of(ALIGNMENT) && found[tag].is_none());
        if bytes.is_none() {
            return Err(ModelError::Place { section });
        }
        found[tag] = bytes;
    }
    let mut sections: [&[u8]; N_SECTIONS] = [&[]; N_SECTIONS];
    for (section, bytes) in Section::ALL.into_iter().zip(found) {
        sections[section as usize] = bytes.ok_or(ModelError::Place { section })?;
    }
    Ok(sections)
}

fn sizes(bytes: &[u8]) -> Result<Shape, ModelError> {
    if bytes.len() != shape::SIZE {
        return Err(ModelError::SectionLength {
            section: Section::Shape,
            have: bytes.len(),
            want: shape::SIZE,
        });
    }
    let size = |size: Size, at: usize, least: usize, limit: usize| {
        let have = usize::from(u16_at(bytes, at));
        if have < least || have > limit {
            return Err(ModelError::Shape { size, have, limit });
        }
        Ok(have)
    };
    let memory = size(Size::Memory, shape::MEMORY, 0, limit::MEMORY)?;
    // A model has densities or a memory.
    let (least, densities, means, owns) = match memory {
        0 => (1, limit::DENSITIES, 0, 0),
        _ => (0, 0, limit::MEANS, owns::ALL),
    };
    let visual_densities = size(Size::VisualDensities, shape::VISUAL_DENSITIES, 0, densities)?;
    Ok(Shape {
        phones: size(Size::Phones, shape::PHONES, 1, limit::PHONES)?,
        densities: size(Size::Densities, shape::DENSITIES, least, densities)?,
        taps: size(Size::Taps, shape::TAPS, 1, limit::TAPS)?,
        inputs: size(Size::Inputs, shape::INPUTS, 1, limit::INPUTS)?,
        parameters: size(Size::Parameters, shape::PARAMETERS, 1, limit::PARAMETERS)?,
        memory,
        means: size(Size::Means, shape::MEANS, 0, means)?,
        owns: size(Size::Owns, shape::OWNS, 0, usize::from(owns))? as u16,
        visual_densities,
    })
}

/// Every number that must lie in a range lies in it.
pub(super) fn values(model: &Model) -> Result<(), ModelError> {
    use Section::*;
    all(Settings, setting_flags(model.section(Settings)))?;
    all(
        PhoneVisemes,
        model.visemes().iter().map(|v| usize::from(*v) < N_VISEMES),
    )?;
    all(
        PhoneNames,
        model
            .section(PhoneNames)
            .chunks_exact(NAME_SIZE)
            .map(|name| name[0] != 0 && name.iter().all(|b| *b == 0 || b.is_ascii_graphic())),
    )?;
    all(
        ObservationGain,
        model
            .observation_scaling()
            .map(|(_, gain)| gain <= limit::OBSERVATION_GAIN),
    )?;
    all(
        ParameterGain,
        model
            .parameter_scaling()
            .map(|(_, gain)| (1..=limit::OBSERVATION_GAIN).contains(&gain)),
    )?;
    for section in [DensityConstants, VisualDensityConstants] {
        all(
            section,
            i32s(model.section(section))
                .map(|c| c == field::NO_DENSITY || (-limit::CONSTANT..=limit::CONSTANT).contains(&c)),
        )?;
    }
    for section in [Transitions, Bigram, VisemeBigram, Initial] {
        all(section, model.i16s(section).iter().map(is_probability))?;
    }
    // A stream must be able to begin.
    if model.initial().iter().all(is_never) {
        return Err(ModelError::Value {
            section: Initial,
            index: 0,
        });
    }
    let mut last = i16::from(limit::FIRST_TAP) - 1;
    all(
        Taps,
        model.taps().map(|tap| {
            let good = i16::from(tap) > last && tap <= limit::LAST_TAP;
            last = i16::from(tap);
            good
        }),
    )?;
    // Sums in 32 bits: 2¹⁵ times less than 2¹⁶.
    all(
        Projection,
        model.projection().map(|row| {
            let sizes = row.weights.iter().map(|w| u32::from(w.unsigned_abs()));
            sizes.sum::<u32>() < 1 << 16
        }),
    )?;
    for section in [DriveScale, OutputScale, MemoryScale] {
        all(
            section,
            i32s(model.section(section)).map(|s| (0..limit::BLOCK_SCALE).contains(&s)),
        )?;
    }
    for section in [ProjectionShift, GlobalShift] {
        all(section, model.section(section).iter().map(|s| *s <= limit::SHIFT))?;
    }
    all(
        MeanShifts,
        model
            .section(MeanShifts)
            .iter()
            .map(|s| (1..=limit::MEAN_SHIFT).contains(s)),
    )?;
    for section in [AudioBias, VisualBias, OutputBias] {
        all(
            section,
            i32s(model.section(section)).map(|v| (-limit::OFFSET..=limit::OFFSET).contains(&v)),
        )?;
    }
    for section in [ProjectionOffset, GlobalBias] {
        all(
            section,
            i32s(model.section(section)).map(|v| (-limit::OFFSET..=limit::OFFSET).contains(&v)),
        )?;
    }
    all(
        ParameterScale,
        i32s(model.section(ParameterScale)).map(is_positive_f32),
    )
}

fn all(section: Section, good: impl IntoIterator<Item = bool>) -> Result<(), ModelError> {
    match good.into_iter().position(|good| !good) {
        Some(index) => Err(ModelError::Value { section, index }),
        None => Ok(()),
    }
}

fn setting_flags(bytes: &[u8]) -> [bool; 5] {
    let beam = u32_at(bytes, settings::BEAM);
    [
        u16_at(bytes, settings::AVERAGE) <= 1,
        beam > 0 && beam <= limit::BEAM as u32,
        u32_at(bytes, settings::ACOUSTIC_SCALE) <= limit::ACOUSTIC_SCALE,
        u32_at(bytes, settings::DISTANCE_GAIN) <= limit::DISTANCE_GAIN,
        u32_at(bytes, settings::VISUAL_DISTANCE_GAIN) <= limit::DISTANCE_GAIN,
    ]
}

fn i32s(bytes: &[u8]) -> impl Iterator<Item = i32> + '_ {
    bytes.as_chunks().0.iter().map(|b| i32::from_le_bytes(*b))
}

/// Whether these are the bits of a normal, positive f32.
fn is_positive_f32(bits: i32) -> bool {
    (0x0080_0000..0x7f80_0000).contains(&bits)
}
