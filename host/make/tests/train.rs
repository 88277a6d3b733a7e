//! Training end to end on a made-up talker: features on disk to a model that moves the mouth rightly, twice the same.
use lipstream::engine::{Engine, Kind};
use lipstream::export::{ExportSettings, export};
use lipstream::kinds::likelihood::Model;
use lipstream::kinds::likelihood::convert::{Lag, convert};
use lipstream_make::evaluate::metrics::Score;
use lipstream_make::features::{FeatureFolder, Split};
use lipstream_make::train::{TrainSettings, data, train};
mod talker;

use talker::made_up_talker;

fn small() -> TrainSettings {
    TrainSettings {
        audio_mixtures: 2,
        visual_mixtures: 1,
        iterations: 3,
        taps: vec![-4, 0, 4],
        context: 6,
        acoustic_scales: vec![0.2],
        penalties: vec![10.0],
        ..TrainSettings::default()
    }
}

fn score(folder: &FeatureFolder, model: &Model) -> Score {
    let mut score = Score::new(2);
    for clip in folder.split(Split::Test) {
        let truth = data::to_audio_rate(
            folder.visual(clip).unwrap().view(),
            clip.video_hz,
            clip.audio_frames,
        );
        let (said, _) = convert(
            model,
            &folder.audio(clip).unwrap(),
            Lag::Frames(model.following.lag),
        )
        .unwrap();
        score.add(&truth, &said);
    }
    score
}

#[test]
fn a_made_up_talker_is_learnt_and_again_the_same() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = made_up_talker(scratch.path(), 12);
    let model = train(&folder, &[], &small(), &()).unwrap();
    let acc = score(&folder, &model).acc();
    assert!(acc > 0.8, "ACC {acc} on clips that were not trained on");

    let paths = [
        scratch.path().join("a.safetensors"),
        scratch.path().join("b.safetensors"),
    ];
    model.write(&paths[0]).unwrap();
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    one_thread
        .install(|| train(&folder, &[], &small(), &()))
        .unwrap()
        .write(&paths[1])
        .unwrap();
    assert_eq!(
        std::fs::read(&paths[0]).unwrap(),
        std::fs::read(&paths[1]).unwrap(),
        "two runs differ"
    );

    // What was written is what was trained, and the device's tables can be made of it.
    assert_eq!(Model::read(&paths[0]).unwrap(), model);
    let tables = export(&model, &ExportSettings::of(&model)).unwrap().bytes;
    assert!(Engine::fixed(tables).is_ok());
    assert!(Engine::open(&paths[0], Kind::Float).is_ok());
}

#[test]
fn what_cannot_be_trained_is_said() {
    let scratch = tempfile::tempdir().unwrap();
    let mut folder = made_up_talker(scratch.path(), 12);
    let odd = TrainSettings {
        audio_mixtures: 3,
        ..small()
    };
    assert!(
        train(&folder, &[], &odd, &())
            .unwrap_err()
            .to_string()
            .contains("power of two")
    );
    folder.manifest.clips.retain(|c| c.split != Split::Train);
    assert!(
        train(&folder, &[], &small(), &())
            .unwrap_err()
            .to_string()
            .contains("no training clip")
    );
    folder.manifest.visual_size = 0;
    assert!(
        train(&folder, &[], &small(), &())
            .unwrap_err()
            .to_string()
            .contains("no video")
    );
}
