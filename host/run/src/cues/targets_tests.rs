//! The tables in themselves, and against the document.
use super::*;

/// `docs/visemes.md` says what the tables here and beside it say.
#[test]
fn the_documents_table_is_the_codes() {
    use crate::cues::SHAPE_OF_VISEME;
    use crate::phones::PHONES;
    let document = include_str!("../../../../docs/visemes.md");
    let number = |x: f32| x.to_string().trim_start_matches('0').to_owned();
    let rows = document.lines().filter_map(|line| line.strip_prefix("| "));
    let rows: Vec<Vec<&str>> = rows.map(|row| row.split('|').map(str::trim).collect()).collect();
    for (v, name) in VISEMES.iter().enumerate() {
        let row = rows.iter().find(|row| row[0] == *name);
        let row = row.unwrap_or_else(|| panic!("{name} has no row"));
        let mut said: Vec<&str> = row[1].split(' ').collect();
        let mut phones: Vec<&str> = PHONES
            .iter()
            .filter(|(_, viseme)| usize::from(viseme.0) == v)
            .map(|(phone, _)| *phone)
            .collect();
        said.sort_unstable();
        phones.sort_unstable();
        assert_eq!(said, phones, "{name}");
        let shape = SHAPE_OF_VISEME[v];
        assert_eq!(
            (row[3], row[4]),
            (&*shape.letter().to_string(), shape.preston_blair()),
            "{name}"
        );
        let shares: Vec<String> = TO_OCULUS[v]
            .iter()
            .map(|&(k, share)| match share == 1.0 {
                true => OCULUS[k].to_owned(),
                false => format!("{} {}", OCULUS[k], number(share)),
            })
            .collect();
        assert_eq!(row[5], shares.join(", "), "{name}");
        let effects: Vec<String> = TO_ARKIT[v]
            .iter()
            .map(|(shape, amount)| format!("{shape} {}", number(*amount)))
            .collect();
        assert_eq!(row[6], effects.join(", "), "{name}");
    }
    for ((phone, _), spoken) in PHONES.iter().zip(SPOKEN) {
        let said = [
            *phone,
            &spoken.count.to_string(),
            &spoken.azure.to_string(),
            spoken.polly,
        ];
        assert!(
            rows.iter().any(|row| row[..row.len() - 1] == said),
            "{phone} has no row {said:?}"
        );
    }
    for said in FACS.iter().zip(FACS_OF_ARKIT) {
        assert!(
            rows.iter()
                .any(|row| row.len() == 3 && (row[0], row[1]) == (*said.0, said.1)),
            "{said:?}"
        );
    }
}

#[test]
fn every_effect_names_a_blend_shape() {
    let all = TO_ARKIT.iter().flat_map(|e| e.iter()).chain(&OPENS);
    for (name, amount) in all {
        let found = sides(name).count();
        assert!(found == 1 || found == 2, "{name}");
        assert!((0.0..=1.0).contains(amount));
    }
}

#[test]
fn every_row_of_a_set_of_shares_adds_up_to_one_and_every_name_is_reached() {
    for set in [BlendSet::Oculus, BlendSet::Azure, BlendSet::Polly] {
        let rows = set.rows();
        for (row, viseme) in rows.iter().zip(VISEMES) {
            assert!((row.iter().sum::<f32>() - 1.0).abs() < 1e-6, "{set:?} {viseme}");
        }
        for (k, name) in set.names().iter().enumerate() {
            assert!(rows.iter().any(|row| row[k] > 0.0), "{set:?}: nothing is {name}");
        }
    }
}

#[test]
fn every_name_that_is_looked_up_is_there() {
    assert!(
        SPOKEN
            .iter()
            .all(|spoken| POLLY.contains(&spoken.polly) && spoken.azure < AZURE.len())
    );
    assert!(VRM_OF_OCULUS.iter().all(|name| OCULUS.contains(name)));
    for name in FACS_OF_ARKIT.into_iter().filter(|name| *name != LIPS_PART) {
        assert!((1..=2).contains(&sides(name).count()), "{name}");
    }
    for (k, id) in AZURE.iter().enumerate() {
        assert_eq!(id.parse(), Ok(k));
    }
}

/// What the device says of how far the mouth is open is what the table here does.
#[test]
fn the_devices_openness_is_the_tables() {
    let rows = BlendSet::Arkit.rows();
    for ((row, device), viseme) in rows
        .iter()
        .zip(lipstream_core::frame::VISEME_OPENNESS)
        .zip(VISEMES)
    {
        let open = effect(row, &OPENS) / OPEN;
        assert_eq!((255.0 * open).round() as u8, device, "{viseme}");
    }
}
