//! Training end to end on a made-up talker: features on disk to a model that moves the mouth rightly, twice the same.
use std::sync::Mutex;

use lipstream::engine::{Engine, Kind};
use lipstream::export::{ExportSettings, export};
use lipstream::hmm::system::System;
use lipstream::kinds::likelihood::Model;
use lipstream::kinds::likelihood::convert::{Lag, convert};
use lipstream::npy::write_npy;
use lipstream_make::evaluate::metrics::Score;
use lipstream_make::features::{FeatureFolder, Split};
use lipstream_make::train::adapt::adapt;
use lipstream_make::train::{TrainSettings, data, train};
use ndarray::arr2;

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
    let mut score = Score::new(folder.manifest.visual_size);
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
fn a_new_mouth_is_learnt_for_the_old_ears() {
    let scratch = tempfile::tempdir().unwrap();
    let old = made_up_talker(&scratch.path().join("old"), 12);
    let model = train(&old, &[], &small(), &()).unwrap();
    // Somebody with three eigenmouths, each a mixture of the old two, in four clips.
    let mut new = made_up_talker(&scratch.path().join("new"), 12);
    let mixture = arr2(&[[0.0f32, -1.0, 1.0], [1.0, 0.5, 1.0]]);
    for clip in &new.manifest.clips {
        let mouth = new.visual(clip).unwrap().dot(&mixture);
        write_npy(&new.root.join(format!("visual/{}.npy", clip.id)), &mouth).unwrap();
    }
    new.manifest.visual_size = 3;
    let few = TrainSettings {
        clips: Some(4),
        ..small()
    };
    let adapted = adapt(&new, &model, &few, &()).unwrap();
    let (own, other) = (score(&old, &model).acc(), score(&new, &adapted).acc());
    println!("ACC of the old mouth {own:.3}, of the new one {other:.3}");
    assert!(other > 0.8 && other > own - 0.1, "{own} {other}");
    // The ears are the old ones.
    assert_eq!(
        (
            &adapted.audio,
            &adapted.transition,
            &adapted.bigram,
            &adapted.initial
        ),
        (&model.audio, &model.transition, &model.bigram, &model.initial)
    );
    assert_eq!(
        (&adapted.start_mean, adapted.system),
        (&model.start_mean, model.system)
    );

    // Components of sound and mouth together cannot be parted.
    let joint = TrainSettings {
        system: System::from_name("ph-hmm").unwrap(),
        ..small()
    };
    let joint = train(&old, &[], &joint, &()).unwrap();
    let refused = adapt(&new, &joint, &few, &()).unwrap_err().to_string();
    assert!(
        refused.contains("ph-hmm is of sound and mouth together"),
        "{refused}"
    );
}

/// Nobody says how many components there are to be: the validation clips stop the growth of either chain, and what was grown in
/// vain is not kept. A start by the best path is as good here.
#[test]
fn validation_clips_stop_the_growth() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = made_up_talker(scratch.path(), 12);
    let system = System::from_name("ph-mshmm").unwrap();
    for viterbi_start in [false, true] {
        let settings = TrainSettings {
            audio_mixtures: TrainSettings::of(system).audio_mixtures,
            visual_mixtures: TrainSettings::of(system).visual_mixtures,
            system,
            viterbi_start,
            ..small()
        };
        let said = Mutex::new(Vec::new());
        let model = train(&folder, &[], &settings, &|line: &str| {
            said.lock().unwrap().push(line.to_owned());
        })
        .unwrap();
        let said = said.into_inner().unwrap();
        let judged: Vec<f64> = said
            .iter()
            .filter_map(|line| line.trim().strip_prefix("validation clips: "))
            .map(|rest| rest.split(' ').next().unwrap().parse().unwrap())
            .collect();
        // Every split that stayed has doubled a chain's components.
        let mut best = judged[0];
        let mut stayed = 0;
        for &unseen in &judged[1..] {
            if unseen > best {
                (best, stayed) = (unseen, stayed + 1);
            }
        }
        let (audio, visual) = (model.audio.mean.dim().1, model.visual.mean.dim().1);
        assert_eq!(audio * visual, 1 << stayed, "{judged:?}");
        assert!(audio < settings.audio_mixtures && visual < settings.visual_mixtures);
        assert_eq!(said.iter().any(|l| l.contains("by the best path")), viterbi_start);
        assert!(score(&folder, &model).acc() > 0.7);
    }
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
