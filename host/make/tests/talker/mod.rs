//! A talker whose sound and mouth are known functions of what is said, as a feature folder.
use std::path::Path;

use lipstream::npy::write_npy;
use lipstream_make::features::{Clip, FeatureFolder, MANIFEST_VERSION, Manifest, PhonesFrom, Split, Word};
use lipstream_make::train::data;
use ndarray::Array2;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const WORDS: [(&str, &[&str]); 3] = [
    ("bee", &["b", "iy"]),
    ("moo", &["m", "uw"]),
    ("eve", &["iy", "v"]),
];

/// A talker whose sound and mouth are known functions of phone and state, with noise; `train` + 3 + 3 clips.
pub(crate) fn made_up_talker(root: &Path, train: usize) -> FeatureFolder {
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
    for n in 0..train + 6 {
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
            split: if n < train {
                Split::Train
            } else if n < train + 3 {
                Split::Val
            } else {
                Split::Test
            },
            audio_frames: audio.nrows(),
            video_frames: visual.nrows(),
            phones_from: PhonesFrom::Labels,
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
        lips: false,
        clips,
        skipped: Vec::new(),
    };
    std::fs::write(root.join("manifest.json"), serde_json::to_vec(&manifest).unwrap()).unwrap();
    FeatureFolder::open(root).unwrap()
}
