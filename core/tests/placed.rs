//! A model whose sections lie in several places speaks as the one whose bytes lie together.
use lipstream_core::kinds::recurrent::tables::AUDIO_GATES;
use lipstream_core::model::common::PARAMETER_SCALE;
use lipstream_core::model::{ModelError, Section};
use lipstream_core::{Model, ParameterFrame, Recurrent, Stream, StreamSettings};

static TABLES: &[u8] = include_bytes!("../../models/grid-s1.tables");

type Recurring = Model<'static, Recurrent<'static>>;

/// Two seconds of a hoarse buzz that rises.
fn frames(model: &Recurring) -> Vec<ParameterFrame> {
    let mut noise = 1_u32;
    let samples: Vec<i16> = (0..32_000_i32)
        .map(|i| {
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let buzz = i % (160 - i / 400) * 60;
            (buzz + (noise >> 22) as i32) as i16
        })
        .collect();
    let mut stream = Stream::new(model, StreamSettings::default());
    let (mut rest, mut frames) = (&samples[..], Vec::new());
    while !rest.is_empty() {
        let (taken, frame) = stream.push(rest);
        rest = &rest[taken..];
        frames.extend(frame);
    }
    frames
}

#[test]
fn copies_of_sections_give_the_same_frames() {
    let together = Recurring::new_checked(TABLES).unwrap();
    // As a device does that has no room for the largest one.
    let apart = Recurring::new_placed(TABLES, |section, bytes| {
        if section == AUDIO_GATES {
            bytes
        } else {
            Vec::leak(bytes.to_vec())
        }
    });
    let apart = apart.unwrap();
    assert_eq!(apart.head().id(), together.head().id());
    let said = frames(&together);
    assert!(said.len() > 150 && said[50].values != said[150].values);
    assert_eq!(frames(&apart), said);
}

/// What is checked is the copy: one that came to harm on its way is refused as damaged tables are.
#[test]
fn a_damaged_copy_is_refused() {
    let damage = |section: Section, bytes: &'static [u8]| -> &'static [u8] {
        if section == PARAMETER_SCALE {
            Vec::leak(vec![0; bytes.len()])
        } else {
            bytes
        }
    };
    let refused = Recurring::new_placed(TABLES, damage).unwrap_err();
    let (section, index) = (PARAMETER_SCALE, 0);
    assert_eq!(refused, ModelError::Value { section, index });
}
