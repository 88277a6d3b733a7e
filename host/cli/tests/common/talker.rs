//! A drawn mouth that speaks in tones: a feature folder small enough for any test.
use std::path::Path;

use lipstream::npy::write_npy;
use lipstream::reference::{self, Normalisation};
use lipstream::render::drawn::{self, HEIGHT, Pose, WIDTH};
use lipstream::tensors::TensorsBuilder;
use lipstream_make::features::{
    Clip, FeatureFolder, MANIFEST_VERSION, Manifest, PhoneLabel, PhonesFrom, Split,
};
use lipstream_media::sound;
use ndarray::Array4;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

pub(crate) const SECONDS: f32 = 2.6;
pub(crate) const VIDEO_HZ: f32 = 25.0;

/// Syllables of random length: how open the mouth is at each moment, and the closures between them.
struct Speech {
    borders: Vec<f32>,
}

impl Speech {
    fn new(rng: &mut Pcg64) -> Self {
        let mut borders = vec![0.2];
        while borders[borders.len() - 1] < SECONDS - 0.4 {
            borders.push(borders[borders.len() - 1] + rng.random_range(0.2..0.4));
        }
        Self { borders }
    }

    /// 0 closed, 1 wide.
    fn open(&self, time: f32) -> f32 {
        let after = self.borders.partition_point(|b| *b <= time);
        if after == 0 || after == self.borders.len() {
            return 0.0;
        }
        let (from, to) = (self.borders[after - 1], self.borders[after]);
        (((time - from) / (to - from) * std::f32::consts::PI).sin() * 1.3 - 0.25).clamp(0.0, 1.0)
    }
}

/// 10 + 3 + 5 clips of a tone whose loudness and pitch follow the mouth, with noise.
pub(crate) fn talker(root: &Path) -> FeatureFolder {
    talker_seen(root, |_, _, _| ())
}

/// [`talker`]; `seen` is told the name of each clip, what the mouth does in each of its pictures, and the pictures `[n, height, width, 3]`.
pub(crate) fn talker_seen(root: &Path, mut seen: impl FnMut(&str, &[Pose], &Array4<u8>)) -> FeatureFolder {
    let mut rng = Pcg64::seed_from_u64(5);
    let space = drawn::space(6);
    let mut out = TensorsBuilder::default();
    space.store(&mut out);
    out.write(&root.join("mouth.safetensors")).unwrap();
    let mut clips = Vec::new();
    let start_mean = [0.0; 13];
    for n in 0..18 {
        let speech = Speech::new(&mut rng);
        let id = format!("clip{n:02}");
        let samples: Vec<i16> = (0..(SECONDS * 16000.0) as usize)
            .map(|k| {
                let time = k as f32 / 16000.0;
                let open = speech.open(time);
                let tone = (std::f32::consts::TAU * 200.0 * time).sin()
                    + (std::f32::consts::TAU * 900.0 * time).sin() * open;
                (4000.0 * open * tone + rng.random_range(-20.0..20.0)) as i16
            })
            .collect();
        sound::write(&root.join(format!("wav/{id}.wav")), &samples).unwrap();
        let observations = reference::observations(&samples, Normalisation::Causal { start_mean });
        write_npy(&root.join(format!("audio/{id}.npy")), &observations).unwrap();
        let frames = (SECONDS * VIDEO_HZ) as usize;
        let mut images = Array4::<u8>::zeros((frames, HEIGHT, WIDTH, 3));
        let pose = |t: usize| Pose {
            open: speech.open((t as f32 + 0.5) / VIDEO_HZ),
            round: 0.2,
            spread: 0.3,
        };
        let poses: Vec<Pose> = (0..frames).map(pose).collect();
        for (pose, mut image) in poses.iter().zip(images.outer_iter_mut()) {
            let pixels = drawn::draw(*pose);
            image
                .iter_mut()
                .zip(&pixels)
                .for_each(|(to, from)| *to = *from as u8);
        }
        seen(&id, &poses, &images);
        let weights = space.project_clip(images.as_slice().unwrap(), true).unwrap();
        write_npy(&root.join(format!("visual/{id}.npy")), &weights).unwrap();
        std::fs::create_dir_all(root.join("mouths")).unwrap();
        ndarray_npy::write_npy(root.join(format!("mouths/{id}.npy")), &images).unwrap();
        let phones = speech.borders.windows(2).flat_map(|pair| {
            let label = |phone: &str, start, end| PhoneLabel {
                phone: phone.into(),
                start,
                end,
            };
            [
                label("m", pair[0] - 0.03, pair[0] + 0.03),
                label("aa", pair[0] + 0.03, pair[1] - 0.03),
            ]
        });
        clips.push(Clip {
            id,
            speaker: "drawn".into(),
            split: match n {
                0..10 => Split::Train,
                10..13 => Split::Val,
                _ => Split::Test,
            },
            audio_frames: observations.nrows(),
            video_frames: frames,
            phones_from: PhonesFrom::Labels,
            video_hz: VIDEO_HZ,
            words: Vec::new(),
            phones: phones.collect(),
        });
    }
    let manifest = Manifest {
        version: MANIFEST_VERSION,
        corpus: "drawn".into(),
        start_mean: start_mean.to_vec(),
        visual_size: space.size(),
        lips: false,
        clips,
        skipped: Vec::new(),
    };
    std::fs::write(
        root.join("manifest.json"),
        serde_json::to_string(&manifest).unwrap(),
    )
    .unwrap();
    FeatureFolder::open(root).unwrap()
}
