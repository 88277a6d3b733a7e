//! The tables: what was written is what is read, and nothing that is damaged or crafted gets through to a panic.
mod common;

use common::tables::{hear_out, seal, section};
use lipstream::export::{ExportSettings, export};
use lipstream::synthetic::{Sizes, model};
use lipstream_core::model::field::{
    CRC_SIZE, FORMAT_VERSION, N_SECTIONS, Section, entry, header, limit, settings, shape,
};
use lipstream_core::model::{Model, ModelError, Size};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64;

fn tables(seed: u64) -> Vec<u8> {
    let float = model(&Sizes::small(), 2.0, &mut Pcg64::seed_from_u64(seed));
    let with = ExportSettings {
        visual_densities: true,
        ..ExportSettings::of(&float)
    };
    export(&float, &with).unwrap().bytes
}

/// Puts `value` at `at` of a section, seals, and gives what the check says.
fn with(bytes: &[u8], of: Section, at: usize, value: &[u8]) -> Result<(), ModelError> {
    let mut bytes = bytes.to_vec();
    let start = section(&bytes, of).start + at;
    bytes[start..start + value.len()].copy_from_slice(value);
    seal(&mut bytes);
    Model::new_checked(&bytes).map(|_| ())
}

#[test]
fn equal_models_give_equal_bytes() {
    assert_eq!(tables(1), tables(1));
    assert_ne!(tables(1), tables(2));
    let (a, b) = (tables(1), tables(2));
    assert_ne!(
        Model::new_checked(&a).unwrap().id(),
        Model::new_checked(&b).unwrap().id()
    );
}

#[test]
fn what_was_exported_is_read() {
    let float = model(&Sizes::small(), 2.0, &mut Pcg64::seed_from_u64(3));
    let with = ExportSettings {
        lag: 3,
        beam_bits: 12.5,
        acoustic_scale: 0.25,
        average: false,
        visual_densities: true,
    };
    let bytes = export(&float, &with).unwrap().bytes;
    let tables = Model::new_checked(&bytes).unwrap();
    assert_eq!(tables.lag(), 3);
    assert_eq!(tables.beam().q12(), 25 << 11);
    assert_eq!(tables.acoustic_scale(), 1 << 14);
    assert!(!tables.average());
    assert_eq!(tables.look_ahead(), 4);
    assert_eq!(
        tables.taps().map(i32::from).collect::<Vec<_>>(),
        float.context.taps
    );
    for (p, phone) in float.phones.iter().enumerate() {
        assert_eq!(tables.phone_name(p), phone.name());
        assert_eq!(tables.viseme(p), usize::from(phone.viseme().0));
        for (q, log) in tables.bigram(p).iter().enumerate() {
            let want = float.bigram[[p, q]] / std::f32::consts::LN_2;
            assert!((f32::from(log) / 1024.0 - want).abs() <= 0.51 / 1024.0);
        }
        let mut total = 0.0;
        for (m, log) in tables.viseme_bigram(p).iter().enumerate() {
            let is_there = float.phones.iter().any(|q| usize::from(q.viseme().0) == m);
            assert_eq!(log == i16::MIN, !is_there, "viseme {m}");
            if is_there {
                total += (f64::from(log) / 1024.0).exp2();
            }
        }
        assert!((total - 1.0).abs() < 1e-2, "{total}");
    }
    for (have, want) in tables.start_mean().iter().zip(&float.start_mean) {
        assert!((f32::from(*have) / 256.0 - want).abs() <= 0.5 / 256.0);
    }
    let visual = float.visual.mean.dim().1;
    // The full set of indices and some beyond: nothing panics.
    for index in 0..1000 {
        let _ = (
            tables.phone_name(index),
            tables.viseme(index),
            tables.choices(index, index),
        );
        assert_eq!(tables.mixture(index).count(), if index < 45 { 2 } else { 0 });
        assert_eq!(tables.state_map(index).count(), if index < 65 { 5 } else { 0 });
        assert_eq!(
            tables.visual_mixture(index).count(),
            if index < 65 { visual } else { 0 }
        );
        assert_eq!(
            tables.visual_centre(index).iter().count(),
            if index < 65 { 5 } else { 0 }
        );
    }
}

#[test]
fn the_wrong_kind_of_file_is_named() {
    assert_eq!(
        Model::new_checked(b"no model at all, just some text").err(),
        Some(ModelError::NoModel)
    );
    assert!(matches!(
        Model::new_checked(&[]),
        Err(ModelError::TooShort { have: 0, .. })
    ));
    let good = tables(1);
    let mut other = good.clone();
    other[header::VERSION] = 9;
    assert_eq!(
        Model::new_checked(&other).err(),
        Some(ModelError::Version {
            have: 9,
            want: FORMAT_VERSION
        })
    );
    let mut other = good.clone();
    other[header::FRONT_END] ^= 1;
    seal(&mut other);
    assert!(matches!(
        Model::new_checked(&other),
        Err(ModelError::FrontEnd { .. })
    ));
    let mut other = good.clone();
    other.push(0);
    assert!(matches!(
        Model::new_checked(&other),
        Err(ModelError::Length { .. })
    ));
}

#[test]
fn every_truncation_is_refused() {
    let good = tables(1);
    for length in (0..good.len()).step_by(7).chain(good.len() - 9..good.len()) {
        assert!(Model::new_checked(&good[..length]).is_err(), "{length}");
    }
}

#[test]
fn every_changed_byte_is_noticed() {
    let good = tables(1);
    let mut rng = Pcg64::seed_from_u64(5);
    for _ in 0..2000 {
        let mut bad = good.clone();
        let at = rng.random_range(0..bad.len());
        bad[at] ^= 1 << rng.random_range(0..8);
        assert!(Model::new_checked(&bad).is_err(), "byte {at}");
    }
}

#[test]
fn numbers_out_of_range_are_refused() {
    use Section::*;
    let good = tables(1);
    assert_eq!(with(&good, PhoneVisemes, 2, &[12]), Ok(()));
    let refused = [
        (PhoneVisemes, 2, vec![13]),
        (PhoneNames, 0, vec![0]),
        (PhoneNames, 1, vec![200]),
        (Bigram, 2, 1i16.to_le_bytes().to_vec()),
        (Transitions, 0, 1i16.to_le_bytes().to_vec()),
        (VisemeBigram, 0, i16::MAX.to_le_bytes().to_vec()),
        (Taps, 0, vec![0]),
        (Taps, 5, vec![17]),
        (ProjectionShift, 0, vec![limit::SHIFT + 1]),
        (GlobalShift, 1, vec![255]),
        (ProjectionOffset, 4, i32::MIN.to_le_bytes().to_vec()),
        (GlobalBias, 0, (limit::OFFSET + 1).to_le_bytes().to_vec()),
        (DensityConstants, 0, i32::MAX.to_le_bytes().to_vec()),
        (ObservationGain, 8, u32::MAX.to_le_bytes().to_vec()),
        (ParameterGain, 8, u32::MAX.to_le_bytes().to_vec()),
        (ParameterGain, 0, 0u32.to_le_bytes().to_vec()),
        (VisualDensityConstants, 4, i32::MAX.to_le_bytes().to_vec()),
        (ParameterScale, 0, f32::NAN.to_le_bytes().to_vec()),
        (ParameterScale, 0, (-1.0f32).to_le_bytes().to_vec()),
        (ParameterScale, 4, 0f32.to_le_bytes().to_vec()),
        (Settings, settings::BEAM, 0u32.to_le_bytes().to_vec()),
        (Settings, settings::BEAM, u32::MAX.to_le_bytes().to_vec()),
        (Settings, settings::AVERAGE, vec![2]),
        (
            Settings,
            settings::ACOUSTIC_SCALE,
            u32::MAX.to_le_bytes().to_vec(),
        ),
        (Settings, settings::DISTANCE_GAIN, u32::MAX.to_le_bytes().to_vec()),
        (
            Settings,
            settings::VISUAL_DISTANCE_GAIN,
            u32::MAX.to_le_bytes().to_vec(),
        ),
    ];
    for (of, at, value) in refused {
        let said = with(&good, of, at, &value);
        assert!(
            matches!(said, Err(ModelError::Value { section, .. }) if section == of),
            "{of:?} at {at}: {said:?}"
        );
    }
    let never = [0x00, 0x80].repeat(9);
    assert_eq!(
        with(&good, Initial, 0, &never),
        Err(ModelError::Value {
            section: Initial,
            index: 0
        })
    );
}

#[test]
fn sizes_that_do_not_fit_are_refused() {
    let good = tables(1);
    for (at, size) in [
        (shape::PHONES, Size::Phones),
        (shape::DENSITIES, Size::Densities),
        (shape::TAPS, Size::Taps),
        (shape::INPUTS, Size::Inputs),
        (shape::PARAMETERS, Size::Parameters),
        (shape::VISUAL_DENSITIES, Size::VisualDensities),
    ] {
        // Tables may be without visual densities, but then not with their sections.
        let least = usize::from(size == Size::VisualDensities);
        for value in &[0u16, 97, u16::MAX][least..] {
            let said = with(&good, Section::Shape, at, &value.to_le_bytes());
            assert!(
                matches!(said, Err(ModelError::Shape { size: s, .. }) if s == size),
                "{size:?} {value}: {said:?}"
            );
        }
        let said = with(&good, Section::Shape, at, &[7, 0]);
        assert!(
            matches!(said, Err(ModelError::SectionLength { .. })),
            "{size:?}: {said:?}"
        );
    }
}

#[test]
fn misplaced_sections_are_refused() {
    let good = tables(1);
    let at = |i: usize| header::SIZE + i * entry::SIZE;
    let tampered = |place: usize, value: &[u8]| {
        let mut bad = good.clone();
        bad[place..place + value.len()].copy_from_slice(value);
        seal(&mut bad);
        Model::new_checked(&bad).map(|_| ())
    };
    for i in 0..N_SECTIONS {
        for offset in [0u32, 31, 1 << 20, u32::MAX, u32::MAX - 3] {
            assert!(tampered(at(i) + entry::OFFSET, &offset.to_le_bytes()).is_err());
        }
        let own = u32::from_le_bytes(good[at(i) + entry::LENGTH..][..4].try_into().unwrap());
        for length in [0u32, 1, u32::MAX, u32::MAX - 3]
            .into_iter()
            .filter(|l| *l != own)
        {
            assert!(tampered(at(i) + entry::LENGTH, &length.to_le_bytes()).is_err());
        }
        let twice = ((i + 1) % N_SECTIONS) as u16;
        assert!(tampered(at(i) + entry::TAG, &twice.to_le_bytes()).is_err());
        assert!(tampered(at(i) + entry::TAG, &[99, 0]).is_err());
    }
    assert!(tampered(header::N_SECTIONS, &[3, 0]).is_err());
}

/// Crafted tables with a right checksum: either refused, or the stream runs through any sound without a panic (overflow
/// checks are on in test builds).
#[test]
fn crafted_tables_never_panic() {
    let good = tables(1);
    let mut rng = Pcg64::seed_from_u64(6);
    let (mut accepted, mut refused) = (0, 0);
    for round in 0..400 {
        let mut bad = good.clone();
        let body = header::SIZE + N_SECTIONS * entry::SIZE..bad.len() - CRC_SIZE;
        if round % 4 == 0 {
            // Everything random in one section.
            let of = Section::ALL[rng.random_range(0..N_SECTIONS)];
            let range = section(&bad, of);
            rng.fill_bytes(&mut bad[range]);
        } else {
            let extremes = [0x00, 0x7f, 0x80, 0xff];
            for _ in 0..rng.random_range(1..200) {
                let at = rng.random_range(body.clone());
                bad[at] = if rng.random() {
                    rng.random()
                } else {
                    extremes[rng.random_range(0..4)]
                };
            }
        }
        seal(&mut bad);
        let Ok(model) = Model::new_checked(&bad) else {
            refused += 1;
            continue;
        };
        accepted += 1;
        hear_out(&model, &noise(4000, &mut rng));
    }
    assert!(
        accepted > 20 && refused > 20,
        "{accepted} accepted, {refused} refused"
    );
}

fn noise(n: usize, rng: &mut impl Rng) -> Vec<i16> {
    let loud: i16 = rng.random_range(1..=i16::MAX);
    (0..n).map(|_| rng.random_range(-loud..=loud)).collect()
}
