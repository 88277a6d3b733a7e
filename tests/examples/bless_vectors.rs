//! Writes the vectors of `tests/src/stream.rs` anew: `cargo run -p lipstream-tests --example bless_vectors`.
use std::path::Path;

use lipstream::export::{ExportSettings, export};
use lipstream::synthetic::{Sizes, model};
use lipstream_core::model::Model;
use lipstream_core::stream::{Settings, Stream};
use lipstream_tests::stream::{Sound, run, with_feedback, write};
use rand::SeedableRng;

fn main() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("vectors");
    let mut float = model(&Sizes::small(), 2.0, &mut rand_pcg::Pcg64::seed_from_u64(2026));
    float.following.acoustic_scale = 0.2;
    float.start_mean.fill(0.0);
    let with = ExportSettings {
        visual_densities: true,
        ..ExportSettings::of(&float)
    };
    let bytes = export(&float, &with)
        .expect("a random model can be exported")
        .bytes;
    let tables = Model::new_checked(&bytes).expect("what was exported is a model");
    let said = |settings: Settings| {
        let mut frames = Vec::new();
        run(&mut Stream::new(&tables, settings), Sound::new(), 160, |frame| {
            write(frame, |byte| frames.push(byte));
        });
        frames
    };
    for (name, bytes) in [
        ("model/small.tables", &bytes),
        ("stream/small.frames", &said(Settings::default())),
        ("stream/feedback.frames", &said(with_feedback())),
    ] {
        let path = folder.join(name);
        lipstream_media::files::write_bytes(&path, bytes).expect("the vectors' folder can be written");
        println!("{}: {} bytes", path.display(), bytes.len());
    }
}
