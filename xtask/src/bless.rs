//! Writes the vectors of `tests/src/stream.rs` anew: `cargo xtask bless`.
use std::path::Path;

use lipstream::export::{ExportSettings, MgeSettings, export, export_hierarchical, export_mge};
use lipstream::kinds::hierarchical::drawn;
use lipstream::kinds::recurrent::model::RecurrentModel;
use lipstream::kinds::recurrent::parameters::{Feedback, Gate};
use lipstream::synthetic::{self, Sizes, model};
use lipstream_core::kinds::Kind;
use lipstream_core::wire::Profile;
use lipstream_core::{Hierarchical, Likelihood, Model, Recurrent, Stream, StreamSettings};
use lipstream_tests::stream::{self, Sound, with_feedback, write};
use rand::SeedableRng;
use rand_pcg::Pcg64;

/// What a model says of the sound, as the vectors hold it.
fn said<'m, K: Kind<'m>>(model: &'m Model<'m, K>, settings: StreamSettings) -> Vec<u8> {
    let mut frames = Vec::new();
    stream::run(&mut Stream::new(model, settings), Sound::new(), 160, |frame| {
        write(frame, |byte| frames.push(byte));
    });
    frames
}

/// A recurrent model of random numbers, both of whose chains own everything that they can, with a second memory.
fn recurrent(rng: &mut Pcg64) -> RecurrentModel {
    let mut parent = model(&Sizes::small(), 2.0, rng);
    parent.start_mean.fill(0.0);
    let mut model = synthetic::recurrent(parent, 5, Feedback::Output, Gate::Both, Gate::Visual, rng);
    model.gated = Some(synthetic::second_memory(&model, 10, rng));
    model
}

pub(crate) fn run(_: &[String]) -> anyhow::Result<()> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/vectors");
    let mut float = model(&Sizes::small(), 2.0, &mut Pcg64::seed_from_u64(2026));
    float.following.acoustic_scale = 0.2;
    float.start_mean.fill(0.0);
    let with = ExportSettings {
        visual_densities: true,
        ..ExportSettings::of(&float)
    };
    let bytes = export(&float, &with)
        .expect("a random model can be exported")
        .bytes;
    let tables = Model::<Likelihood>::new_checked(&bytes).expect("what was exported is a model");
    // Of a few seeds the one whose visemes change most.
    let float = recurrent(&mut Pcg64::seed_from_u64(1));
    let recurrent_bytes = export_mge(&float, &MgeSettings::default())
        .expect("a random model can be exported")
        .bytes;
    let recurrent = Model::<Recurrent>::new_checked(&recurrent_bytes).expect("what was exported is a model");
    let face = drawn::random(&drawn::Sizes::small(), &mut Pcg64::seed_from_u64(4))?;
    let hierarchical_bytes = export_hierarchical(&face)?.bytes;
    let hierarchical =
        Model::<Hierarchical>::new_checked(&hierarchical_bytes).expect("what was exported is a model");
    for (name, bytes) in [
        ("model/small.tables", &bytes),
        ("stream/small.frames", &said(&tables, StreamSettings::default())),
        ("stream/feedback.frames", &said(&tables, with_feedback())),
        ("model/small-recurrent.tables", &recurrent_bytes),
        (
            "stream/small-recurrent.frames",
            &said(&recurrent, StreamSettings::default()),
        ),
        ("model/small-hierarchical.tables", &hierarchical_bytes),
        (
            "stream/small-hierarchical.frames",
            &said(&hierarchical, StreamSettings::default()),
        ),
        (
            "stream/small-hierarchical-live.frames",
            &said(&hierarchical, StreamSettings::of(Profile::Live)),
        ),
    ] {
        let path = folder.join(name);
        lipstream_media::files::write_bytes(&path, bytes)?;
        println!("tests/vectors/{name}: {} bytes", bytes.len());
    }
    Ok(())
}
