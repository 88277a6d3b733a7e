//! A hierarchical model on the device against its floats, and damaged tables.
mod common;

use common::tables::seal;
use lipstream::engine::stream;
use lipstream::export::{ExportError, export_hierarchical};
use lipstream::kinds::hierarchical::drawn::Sizes;
use lipstream::kinds::hierarchical::{Choice, Hearing, HierarchicalModel, at_frames, drawn, speech};
use lipstream::time;
use lipstream_core::model::container;
use lipstream_core::wire::Profile;
use lipstream_core::{AnyModel, StreamSettings};
use ndarray::{Array1, Array2};
use rand::SeedableRng as _;
use rand_pcg::Pcg64;

fn model(seed: u64) -> HierarchicalModel {
    drawn::random(&Sizes::small(), &mut Pcg64::seed_from_u64(seed)).unwrap()
}

/// Noise through a moving resonance with pauses, as long as asked for.
fn sound(length: usize) -> Vec<i16> {
    let mut noise = common::sounds::noise(5);
    let mut before = [0.0; 2];
    (0..length)
        .map(|n| {
            let part = n / 1_280;
            let loud = [0.0, 300.0, 2_000.0, 60.0, 6_000.0][part % 5];
            let turn = [1.7, 0.9, -0.3, 1.5, 0.3, -1.2][part % 6];
            let y = loud * noise() + turn * before[0] - 0.9 * before[1];
            before = [y, before[0]];
            y.clamp(-32_768.0, 32_767.0) as i16
        })
        .collect()
}

/// What floats say of every frame, in deviations of each parameter.
fn floats(model: &HierarchicalModel, samples: &[i16]) -> Array2<f32> {
    let said = model.convert(samples, Choice::Mahalanobis).unwrap();
    at_frames(
        &said,
        speech::PICTURES_HZ as f32,
        time::frame_count(samples.len()),
    ) / &deviations(model)
}

fn deviations(model: &HierarchicalModel) -> Array1<f32> {
    let of = model
        .nodes
        .iter()
        .flat_map(|node| &node.appearance.joint.variances);
    of.map(|v| v.sqrt()).collect()
}

#[test]
fn the_device_says_what_floats_say() {
    let samples = sound(5 * 16_000);
    for seed in 0..4 {
        let model = model(seed);
        let bytes = export_hierarchical(&model).unwrap().bytes;
        let tables = AnyModel::new_checked(&bytes).unwrap();
        assert_eq!((tables.kind_name(), tables.n_visemes()), ("Hierarchical", 0));
        let said = stream(&tables, &samples, StreamSettings::default())
            .unwrap()
            .parameters;
        let off = (said / &deviations(&model) - floats(&model, &samples)).mapv(f32::abs);
        // Frames of another cluster, where two are as near to within the front end's rounding, are few.
        let other = off
            .outer_iter()
            .filter(|row| row.iter().any(|v| *v > 0.02))
            .count();
        assert!(
            other * 20 <= off.nrows(),
            "seed {seed}: {other} of {} frames",
            off.nrows()
        );
    }
}

/// As many frames as floats have, whatever the end cuts off a picture.
#[test]
fn every_length_ends_as_in_floats() {
    let model = model(0);
    let bytes = export_hierarchical(&model).unwrap().bytes;
    let tables = AnyModel::new_checked(&bytes).unwrap();
    for frames in 1..16 {
        let samples = sound(time::samples_covered(frames));
        let said = stream(&tables, &samples, StreamSettings::default())
            .unwrap()
            .parameters;
        let wanted = floats(&model, &samples);
        assert_eq!(said.dim(), wanted.dim(), "{frames} frames");
        let off = (said / &deviations(&model) - wanted).mapv(f32::abs);
        assert!(off.iter().all(|v| *v < 0.02), "{frames} frames: {off}");
    }
}

/// Without smoothing a picture earlier: frames on the lines between pictures as they are chosen.
#[test]
fn the_live_profile_does_not_smooth() {
    let samples = sound(16_000);
    let model = model(1);
    let bytes = export_hierarchical(&model).unwrap().bytes;
    let tables = AnyModel::new_checked(&bytes).unwrap();
    let delay = |profile| {
        let settings = StreamSettings::of(profile);
        lipstream_core::AnyStream::new(&tables, settings).delay_samples()
    };
    assert_eq!(
        (delay(Profile::Live), delay(Profile::Studio)),
        (5 * 160 + 200, 9 * 160 + 200)
    );
    let said = stream(&tables, &samples, StreamSettings::of(Profile::Live))
        .unwrap()
        .parameters;
    let heard = model.hear(&samples);
    let parts = model.nodes.iter().map(|node| node.map.convert(&heard));
    let parts: Vec<Array2<f32>> = parts.collect();
    let rows = ndarray::concatenate![ndarray::Axis(1), parts[0], parts[1]];
    let wanted = at_frames(&rows, 25.0, time::frame_count(samples.len()));
    let off = ((said - wanted) / deviations(&model)).mapv(f32::abs);
    let other = off
        .outer_iter()
        .filter(|row| row.iter().any(|v| *v > 0.02))
        .count();
    assert!(other * 20 <= off.nrows(), "{other} of {} frames", off.nrows());
}

#[test]
fn what_the_device_cannot_hear_or_name_is_refused() {
    let whole = model(2);
    let maps = [whole.nodes[0].map.clone(), whole.nodes[1].map.clone()];
    let mut windows = whole.speech.clone();
    windows.mean = Array1::zeros(12);
    windows.components = windows.components.slice(ndarray::s![.., ..12]).to_owned();
    let of_windows = drawn::model(Hearing::Window, windows, maps).unwrap();
    let Err(refused) = export_hierarchical(&of_windows) else {
        panic!("the device has no windows of 40 ms");
    };
    assert_eq!(refused, ExportError::Hearing);
    assert!(refused.to_string().contains("--for-device"));
}

/// Numbers anywhere in the tables may be anything: they are refused, or run without a panic.
#[test]
fn crafted_tables_are_refused_or_run() {
    let bytes = export_hierarchical(&model(3)).unwrap().bytes;
    let samples = sound(12_000);
    let mut refused = 0;
    for at in (container::header::SIZE..bytes.len() - container::CRC_SIZE).step_by(7) {
        for value in [0x00, 0x7f, 0x80, 0xff] {
            let mut damaged = bytes.clone();
            damaged[at] = value;
            seal(&mut damaged);
            match AnyModel::new_checked(&damaged) {
                Err(_) => refused += 1,
                Ok(tables) if at % 5 == 0 => {
                    let said = stream(&tables, &samples, StreamSettings::default()).unwrap();
                    assert_eq!(said.parameters.nrows(), time::frame_count(samples.len()));
                }
                Ok(_) => {}
            }
        }
    }
    assert!(refused > 50, "{refused} refused");
    let cut = AnyModel::new_checked(&bytes[..bytes.len() - 1]);
    assert!(cut.is_err());
}
