//! What the tests of the firmware and of the program are given: the repository's files, a synthetic model, what the core makes of sound.
#![allow(dead_code)] // each test program uses its part

use std::path::{Path, PathBuf};

use lipstream::export::{ExportSettings, export};
use lipstream::render::drawn;
use lipstream::synthetic;
use lipstream_core::{AnyModel, AnyStream, ParameterFrame, StreamSettings};
use rand::SeedableRng;

/// The repository's top folder.
pub(crate) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .find(|folder| folder.join("memory.x").is_file())
        .expect("the tests lie in the repository")
}

/// A folder for this test's files, empty.
pub(crate) fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    if folder.exists() {
        std::fs::remove_dir_all(&folder).expect("remove an earlier run's files");
    }
    std::fs::create_dir_all(&folder).expect("make a folder");
    folder
}

/// The project's own speech, 16 kHz.
pub(crate) fn hello() -> Vec<i16> {
    let path = root().join("data/hello.wav");
    let mut reader = hound::WavReader::open(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    assert_eq!((reader.spec().sample_rate, reader.spec().channels), (16_000, 1));
    reader.samples().map(|sample| sample.expect("a sample")).collect()
}

/// A random model as large as a real one, with a drawn mouth.
pub(crate) fn synthetic_model() -> lipstream::kinds::likelihood::Model {
    let mut rng = rand_pcg::Pcg64::seed_from_u64(8);
    let sizes = synthetic::Sizes::full();
    let mut model = synthetic::model(&sizes, 1.0, &mut rng);
    model.mouth = Some(drawn::space(sizes.parameters));
    model
}

/// Its tables.
pub(crate) fn synthetic_tables() -> Vec<u8> {
    let model = synthetic_model();
    export(&model, &ExportSettings::of(&model))
        .expect("a synthetic model exports")
        .bytes
}

/// Tables of the shipped model.
pub(crate) fn shipped_tables() -> Vec<u8> {
    std::fs::read(root().join("models/grid-s1.tables")).expect("the shipped tables")
}

/// What the core gives on the host.
pub(crate) fn host_frames(
    model: &AnyModel,
    settings: StreamSettings,
    samples: &[i16],
) -> Vec<ParameterFrame> {
    host_run(model, settings, samples).0
}

/// The host's frames, and in how many of them the beam was narrowed.
pub(crate) fn host_run(
    model: &AnyModel,
    settings: StreamSettings,
    mut samples: &[i16],
) -> (Vec<ParameterFrame>, u32) {
    let mut stream = AnyStream::new(model, settings);
    let mut frames = Vec::new();
    while !samples.is_empty() {
        let (consumed, frame) = stream.push(samples);
        frames.extend(frame);
        samples = &samples[consumed..];
    }
    frames.extend(std::iter::from_fn(|| stream.finish()));
    (frames, stream.narrowed())
}
