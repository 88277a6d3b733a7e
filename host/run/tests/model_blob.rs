//! The tables: what was written is what is read, and nothing that is damaged or crafted gets through to a panic.
mod common;

use common::tables::{hear_out, n_sections, nth, replaced, seal, section};
use lipstream::export::{ExportSettings, export};
use lipstream::synthetic::{Sizes, model};
use lipstream_core::context::tables::{
    MAX_INPUTS, MAX_OFFSET, MAX_SHIFT, MAX_TAPS, PROJECTION_OFFSET, PROJECTION_SHIFT, TAPS,
};
use lipstream_core::frame::MAX_GROUPS;
use lipstream_core::hmm::tables::{BIGRAM, INITIAL, PHONE_NAMES, PHONE_VISEMES, TRANSITIONS, VISEME_BIGRAM};
use lipstream_core::hmm::transition::MAX_PHONES;
use lipstream_core::kinds::likelihood::tables::*;
use lipstream_core::logmath::LogProb;
use lipstream_core::model::common::{GROUPS, PARAMETER_SCALE, START_MEAN};
use lipstream_core::model::container::{CRC_SIZE, FORMAT_VERSION, entry, header};
use lipstream_core::model::{ModelError, Section};
use lipstream_core::{AnyModel, Likelihood};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64;

type Model<'a> = lipstream_core::Model<'a, Likelihood<'a>>;

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
        Model::new_checked(&a).unwrap().head().id(),
        Model::new_checked(&b).unwrap().head().id()
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
    let (head, own) = (tables.head(), tables.own());
    let settings = own.settings();
    assert_eq!(settings.lag, 3);
    assert_eq!(settings.beam, LogProb::from_q12(25 << 11));
    assert_eq!(settings.acoustic_scale, 1 << 14);
    assert!(!settings.average);
    assert_eq!(own.context().look_ahead(), 4);
    assert_eq!(
        own.context().taps().map(i32::from).collect::<Vec<_>>(),
        float.context.taps
    );
    let groups: Vec<_> = head.groups().map(|group| (group.name, group.place)).collect();
    assert_eq!(groups, [("mouth", 0..5)]);
    let hmm = own.hmm();
    for (p, phone) in float.phones.iter().enumerate() {
        assert_eq!(hmm.phone_name(p), phone.name());
        assert_eq!(hmm.viseme(p), usize::from(phone.viseme().0));
        for (q, log) in hmm.bigram(p).iter().enumerate() {
            let want = float.bigram[[p, q]] / std::f32::consts::LN_2;
            assert!((f32::from(log) / 1024.0 - want).abs() <= 0.51 / 1024.0);
        }
        let mut total = 0.0;
        for (m, log) in hmm.viseme_bigram(p).iter().enumerate() {
            let is_there = float.phones.iter().any(|q| usize::from(q.viseme().0) == m);
            assert_eq!(log == i16::MIN, !is_there, "viseme {m}");
            if is_there {
                total += (f64::from(log) / 1024.0).exp2();
            }
        }
        assert!((total - 1.0).abs() < 1e-2, "{total}");
    }
    for (have, want) in head.start_mean().iter().zip(&float.start_mean) {
        assert!((f32::from(*have) / 256.0 - want).abs() <= 0.5 / 256.0);
    }
    let visual = float.visual.mean.dim().1;
    // The full set of indices and some beyond: nothing panics.
    for index in 0..1000 {
        let _ = (
            hmm.phone_name(index),
            hmm.viseme(index),
            hmm.choices(index, index),
        );
        assert_eq!(own.audio().of(index).count(), if index < 45 { 2 } else { 0 });
        assert_eq!(own.state_map(index).count(), if index < 65 { 5 } else { 0 });
        assert_eq!(
            own.visual().of(index).count(),
            if index < 65 { visual } else { 0 }
        );
        assert_eq!(
            own.visual_centre(index).iter().count(),
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
    let good = tables(1);
    assert_eq!(with(&good, PHONE_VISEMES, 2, &[12]), Ok(()));
    let refused = [
        (PHONE_VISEMES, 2, vec![13]),
        (PHONE_NAMES, 0, vec![0]),
        (PHONE_NAMES, 1, vec![200]),
        (BIGRAM, 2, 1i16.to_le_bytes().to_vec()),
        (TRANSITIONS, 0, 1i16.to_le_bytes().to_vec()),
        (VISEME_BIGRAM, 0, i16::MAX.to_le_bytes().to_vec()),
        (TAPS, 0, vec![0]),
        (TAPS, 5, vec![17]),
        (PROJECTION_SHIFT, 0, vec![MAX_SHIFT + 1]),
        (GLOBAL_SHIFT, 1, vec![255]),
        (PROJECTION_OFFSET, 4, i32::MIN.to_le_bytes().to_vec()),
        (GLOBAL_BIAS, 0, (MAX_OFFSET + 1).to_le_bytes().to_vec()),
        (DENSITY_CONSTANTS, 0, i32::MAX.to_le_bytes().to_vec()),
        (OBSERVATION_GAIN, 8, u32::MAX.to_le_bytes().to_vec()),
        (PARAMETER_GAIN, 8, u32::MAX.to_le_bytes().to_vec()),
        (PARAMETER_GAIN, 0, 0u32.to_le_bytes().to_vec()),
        (VISUAL_DENSITY_CONSTANTS, 4, i32::MAX.to_le_bytes().to_vec()),
        (PARAMETER_SCALE, 0, f32::NAN.to_le_bytes().to_vec()),
        (PARAMETER_SCALE, 0, (-1.0f32).to_le_bytes().to_vec()),
        (PARAMETER_SCALE, 4, 0f32.to_le_bytes().to_vec()),
        (GROUPS, 0, vec![b'M']),
        (GROUPS, 0, vec![0]),
        (GROUPS, 7, vec![b'x']),
        (GROUPS, 8, vec![0, 0]),
        (GROUPS, 8, vec![97, 0]),
        (SETTINGS, settings::BEAM, 0u32.to_le_bytes().to_vec()),
        (SETTINGS, settings::BEAM, u32::MAX.to_le_bytes().to_vec()),
        (SETTINGS, settings::AVERAGE, vec![2]),
        (
            SETTINGS,
            settings::ACOUSTIC_SCALE,
            u32::MAX.to_le_bytes().to_vec(),
        ),
        (SETTINGS, settings::DISTANCE_GAIN, u32::MAX.to_le_bytes().to_vec()),
        (
            SETTINGS,
            settings::VISUAL_DISTANCE_GAIN,
            u32::MAX.to_le_bytes().to_vec(),
        ),
    ];
    for (of, at, value) in refused {
        let said = with(&good, of, at, &value);
        assert!(
            matches!(said, Err(ModelError::Value { section, .. }) if section == of),
            "{} at {at}: {said:?}",
            of.name
        );
    }
    let never = [0x00, 0x80].repeat(9);
    assert_eq!(
        with(&good, INITIAL, 0, &never),
        Err(ModelError::Value {
            section: INITIAL,
            index: 0
        })
    );
}

#[test]
fn sizes_that_do_not_fit_are_refused() {
    let good = tables(1);
    // The sections that give the sizes: bytes of an item, and most of them.
    let states = section(&good, PHONE_VISEMES).len() * 5;
    for (of, item, most) in [
        (GROUPS, 10, MAX_GROUPS),
        (PHONE_VISEMES, 1, MAX_PHONES),
        (TAPS, 1, MAX_TAPS),
        (PROJECTION_SHIFT, 1, MAX_INPUTS),
        (DENSITY_CONSTANTS, 4 * states, MAX_DENSITIES),
        (VISUAL_DENSITY_CONSTANTS, 4 * 65, MAX_DENSITIES),
    ] {
        let own = &good[section(&good, of)];
        for items in [0, most + 1] {
            let content: Vec<u8> = own.iter().copied().cycle().take(item * items).collect();
            let bad = replaced(&good, of, Some(&content));
            let said = Model::new_checked(&bad).err();
            let want = ModelError::Size {
                section: of,
                have: items,
                most,
            };
            assert_eq!(said, Some(want), "{}", of.name);
        }
        // Another size than that of the sections that depend on it.
        let content: Vec<u8> = own.iter().copied().take(own.len() - item).collect();
        let other = replaced(&good, of, Some(&content));
        assert!(Model::new_checked(&other).is_err(), "{}", of.name);
    }
    let mut long = good[section(&good, PARAMETER_SCALE)].to_vec();
    long.extend([0; 4]);
    for of in [PARAMETER_SCALE, START_MEAN, SETTINGS] {
        assert!(matches!(
            Model::new_checked(&replaced(&good, of, Some(&long))).err(),
            Some(ModelError::SectionLength { section, .. }) if section == of
        ));
    }
}

/// A kind's tables hold its sections and no others.
#[test]
fn missing_and_foreign_sections_are_refused() {
    let good = tables(1);
    for n in 0..n_sections(&good) {
        let of = Section::new(nth(&good, n).0, "");
        let said = Model::new_checked(&replaced(&good, of, None)).map(|_| ());
        assert!(
            matches!(said, Err(ModelError::Missing { section }) if section.tag == of.tag)
                || matches!(said, Err(ModelError::Foreign { .. })),
            "{}: {said:?}",
            of.tag
        );
    }
    // One more, of a tag that no section has.
    let mut parts: Vec<(Section, &[u8])> = (0..n_sections(&good))
        .map(|n| nth(&good, n))
        .map(|(tag, place)| (Section::new(tag, ""), &good[place]))
        .collect();
    parts.push((Section::new(0x7000, ""), &[1, 2, 3]));
    let mut more = Vec::new();
    lipstream_core::model::container::write(1, &parts, &mut more);
    assert_eq!(
        Model::new_checked(&more).err(),
        Some(ModelError::Foreign { sections: 1 })
    );
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
    let n = n_sections(&good);
    for i in 0..n {
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
        let twice = nth(&good, (i + 1) % n).0;
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
        let body = header::SIZE + n_sections(&bad) * entry::SIZE..bad.len() - CRC_SIZE;
        if round % 4 == 0 {
            // Everything random in one section.
            let range = nth(&bad, rng.random_range(0..n_sections(&bad))).1;
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
        let Ok(model) = AnyModel::new_checked(&bad) else {
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
