//! Training end to end on a made-up talker: features on disk to a model that moves the mouth rightly, twice the same.
use std::path::Path;

use lipstream::engine::{Engine, Kind};
use lipstream::evaluate::metrics::Score;
use lipstream::export::{ExportSettings, export};
use lipstream::features::{Clip, FeatureFolder, MANIFEST_VERSION, Manifest, Split, Word, write_npy};
use lipstream::hmm::convert::{Lag, convert};
use lipstream::model::Model;
use lipstream::train::{Settings, data, train};
use ndarray::Array2;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const WORDS: [(&str, &[&str]); 3] = [
    ("bee", &["b", "iy"]),
    ("moo", &["m", "uw"]),
    ("eve", &["iy", "v"]),
];

/// A talker whose sound and mouth are known functions of phone and state, with noise; 12 + 3 + 3 clips.
fn made_up_talker(root: &Path) -> FeatureFolder {
    let mut rng = Pcg64::seed_from_u64(3);
    let phones = ["sil", "b", "iy", "m", "uw", "v"];
    let look = |phone: &str| match phone {
        "b" | "m" => [-2.0, 0.0],
        "iy" => [1.0, 2.0],
        "uw" => [0.5, -2.0],
        "v" => [-1.0, 0.5],
        _ => [0.0, 0.0],
    };
    let sound: Vec<Vec<f32>> = phones
        .iter()
        .map(|_| (0..39).map(|_| rng.random_range(-8.0f32..8.0)).collect())
        .collect();
    let mut clips = Vec::new();
    for n in 0..18 {
        let order: Vec<usize> = (0..4).map(|_| rng.random_range(0..WORDS.len())).collect();
        let mut said = vec![0usize];
        for &w in &order {
            said.extend(
                WORDS[w]
                    .1
                    .iter()
                    .map(|p| phones.iter().position(|q| q == p).unwrap()),
            );
        }
        said.push(0);
        let mut rows: Vec<usize> = Vec::new();
        let mut words = Vec::new();
        let mut begun = 0.0;
        for (place, &phone) in said.iter().enumerate() {
            // A whole number of video frames, so that the mouth is where the sound is.
            let frames = 4 * rng.random_range(2..5);
            rows.extend(std::iter::repeat_n(phone, frames));
            let end = data::frame_time(rows.len());
            if place > 0 && place % 2 == 0 && place < said.len() - 1 {
                let (text, pronunciation) = WORDS[order[place / 2 - 1]];
                words.push(Word {
                    text: text.to_owned(),
                    pronunciations: vec![pronunciation.iter().map(|p| (*p).to_owned()).collect()],
                    time: Some((begun, end)),
                });
                begun = end;
            } else if place == 0 {
                begun = end;
            }
        }
        let audio = Array2::from_shape_fn((rows.len(), 39), |(t, i)| {
            sound[rows[t]][i] + rng.random_range(-2.0..2.0)
        });
        let visual = Array2::from_shape_fn((rows.len() / 4, 2), |(t, i)| {
            look(phones[rows[4 * t + 2]])[i] + rng.random_range(-0.2..0.2)
        });
        let id = format!("clip{n:02}");
        let clip = Clip {
            id: id.clone(),
            speaker: "made-up".to_owned(),
            split: if n < 12 {
                Split::Train
            } else if n < 15 {
                Split::Val
            } else {
                Split::Test
            },
            audio_frames: audio.nrows(),
            video_frames: visual.nrows(),
            video_hz: 25.0,
            words,
            phones: Vec::new(),
        };
        write_npy(&root.join("audio").join(format!("{id}.npy")), &audio).unwrap();
        write_npy(&root.join("visual").join(format!("{id}.npy")), &visual).unwrap();
        clips.push(clip);
    }
    let manifest = Manifest {
        version: MANIFEST_VERSION,
        corpus: "made-up".to_owned(),
        start_mean: vec![0.0; 13],
        visual_size: 2,
        clips,
        skipped: Vec::new(),
    };
    std::fs::write(root.join("manifest.json"), serde_json::to_vec(&manifest).unwrap()).unwrap();
    FeatureFolder::open(root).unwrap()
}

fn small() -> Settings {
    Settings {
        audio_mixtures: 2,
        visual_mixtures: 1,
        iterations: 3,
        taps: vec![-4, 0, 4],
        context: 6,
        acoustic_scales: vec![0.2],
        penalties: vec![10.0],
        ..Settings::default()
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
    let folder = made_up_talker(scratch.path());
    let model = train(&folder, &[], &small(), &|_| ()).unwrap();
    let acc = score(&folder, &model).acc();
    assert!(acc > 0.8, "ACC {acc} on clips that were not trained on");

    let paths = [
        scratch.path().join("a.safetensors"),
        scratch.path().join("b.safetensors"),
    ];
    model.write(&paths[0]).unwrap();
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    one_thread
        .install(|| train(&folder, &[], &small(), &|_| ()))
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
    let mut folder = made_up_talker(scratch.path());
    let odd = Settings {
        audio_mixtures: 3,
        ..small()
    };
    assert!(
        train(&folder, &[], &odd, &|_| ())
            .unwrap_err()
            .to_string()
            .contains("power of two")
    );
    folder.manifest.clips.retain(|c| c.split != Split::Train);
    assert!(
        train(&folder, &[], &small(), &|_| ())
            .unwrap_err()
            .to_string()
            .contains("no training clip")
    );
    folder.manifest.visual_size = 0;
    assert!(
        train(&folder, &[], &small(), &|_| ())
            .unwrap_err()
            .to_string()
            .contains("no video")
    );
}
