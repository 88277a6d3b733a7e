//! Lips by landmarks, and how well the shipped model follows them, on a few GRID clips. Needs LIPSTREAM_RESEARCH and `ffmpeg`.
//!
//!     cargo test -p lipstream-make --test research_strangers -- --ignored --nocapture
use lipstream::engine::Engine;
use lipstream::opening::OpeningReader;
use lipstream_make::corpus::{self, PrepareSettings};
use lipstream_make::evaluate::strangers::strangers;
use lipstream_make::features::FeatureFolder;

mod common;

#[test]
#[ignore = "needs the research data: tests/run --research"]
fn a_mouth_follows_whom_it_knows_and_loudness_does_not() {
    let mut videos = common::videos(&common::data().join("grid-s1/test"));
    videos.truncate(3);
    // What is no video is left out and said; the others are measured.
    let scratch = tempfile::tempdir().unwrap();
    let broken = scratch.path().join("broken.mp4");
    std::fs::write(&broken, b"no video").unwrap();
    videos.push(broken);
    let reader = OpeningReader::shipped().unwrap().unwrap();
    let report = strangers(&videos, &Engine::shipped(), &reader, &()).unwrap();
    println!("{}", report.markdown());
    assert_eq!((report.videos.len(), report.left_out.len()), (3, 1));
    for one in &report.videos {
        assert!(one.gap > 0.75 && one.best_lag_ms.abs() <= 40, "{one:?}");
        assert!(one.gap > one.loudness + 0.1 && one.best >= one.gap, "{one:?}");
    }
}

#[test]
#[ignore = "needs the research data: tests/run --research"]
fn lips_are_prepared_in_place_of_mouths_and_once() {
    let scratch = tempfile::tempdir().unwrap();
    let corpus = scratch.path().join("others");
    std::fs::create_dir(&corpus).unwrap();
    for path in common::videos(&common::data().join("grid-others")).iter().take(2) {
        std::fs::copy(path, corpus.join(path.file_name().unwrap())).unwrap();
    }
    let settings = PrepareSettings {
        corpus,
        out: scratch.path().join("features"),
        lips: true,
        sync_offset_ms: Some(0.0),
        ..Default::default()
    };
    corpus::prepare(&settings, &()).unwrap();
    let folder = FeatureFolder::open(&settings.out).unwrap();
    assert!(folder.manifest.lips && !folder.mouth_path().exists() && folder.manifest.clips.len() == 2);
    let lips: Vec<_> = folder
        .manifest
        .clips
        .iter()
        .map(|clip| folder.visual(clip).unwrap())
        .collect();
    for lips in &lips {
        assert!(lips.nrows() >= 74 && lips.ncols() == 2);
        let (gap, width) = (lips.column(0), lips.column(1));
        assert!(
            gap.iter().all(|v| (0.0..0.6).contains(v)) && gap.std(0.0) > 0.01,
            "{gap}"
        );
        assert!(width.iter().all(|v| (0.15..0.7).contains(v)), "{width}");
    }
    let refused = folder.of_eigenmouths().unwrap_err().to_string();
    assert!(refused.contains("--watched"), "{refused}");
    // A second run looks at nothing again.
    let before = std::fs::metadata(settings.out.join("visual"))
        .unwrap()
        .modified()
        .unwrap();
    corpus::prepare(&settings, &()).unwrap();
    let after = std::fs::metadata(settings.out.join("visual"))
        .unwrap()
        .modified()
        .unwrap();
    assert_eq!(before, after);
}
