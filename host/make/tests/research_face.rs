//! A face drawn onto another recording of the same person, against how he himself said the sentence. Needs LIPSTREAM_RESEARCH and `ffmpeg`.
use lipstream::engine::{Engine, RunSettings};
use lipstream::mouth::MouthSpace;
use lipstream::render::face::{FaceScene, FaceSettings, Wanted, Whose};
use lipstream::render::{self, Scene as _};
use lipstream::shipped;
use lipstream::tensors::Tensors;
use lipstream_make::vision::{self, LandmarkFinder};
use lipstream_media::sound;
use lipstream_media::video::{self, Frames};

mod common;

use common::{data, videos};

fn correlation(pairs: &[(f32, f32)]) -> f32 {
    let n = pairs.len() as f32;
    let (ma, mb) = (
        pairs.iter().map(|p| p.0).sum::<f32>() / n,
        pairs.iter().map(|p| p.1).sum::<f32>() / n,
    );
    let sum = |of: fn(f32, f32) -> f32| pairs.iter().map(|p| of(p.0 - ma, p.1 - mb)).sum::<f32>();
    sum(|a, b| a * b) / (sum(|a, _| a * a) * sum(|_, b| b * b)).sqrt()
}

/// The shipped model's own speaker, and a stranger's recording: both say a sentence that neither said there, with their lips apart when he had his apart.
#[test]
#[ignore = "needs the research data: tests/run --research"]
fn a_face_says_what_it_never_said() {
    let own = videos(&data().join("grid-s1/val"));
    let (own, sentence) = (&own[0], &own[2]);
    // The first of them is the shipped model's speaker himself.
    let stranger = &videos(&data().join("grid-others"))[1];
    let space = MouthSpace::load(&Tensors::parse(shipped::MODEL, "the shipped model").unwrap()).unwrap();
    let samples = sound::decode(&video::decode_sound(sentence).unwrap())
        .unwrap()
        .samples;
    let said = Engine::shipped()
        .convert(&samples, &RunSettings::default())
        .unwrap()
        .parameters;
    let tracks = render::at_pictures(said.view(), 25, Some(samples.len())).unwrap();
    let finder = LandmarkFinder::new().unwrap();
    let truth = finder.in_clip(&video::decode(sentence).unwrap()).unwrap();
    for (background, whose) in [(own, Whose::Trained), (stranger, Whose::Opened)] {
        let mut footage = vision::footage(background, 60.0, &()).unwrap();
        let wanted = Wanted {
            tracks: tracks.view(),
            energy: None,
        };
        let mut scene = FaceScene::new(&mut footage, &space, &wanted, &FaceSettings::default()).unwrap();
        assert_eq!(
            scene.mouths().whose(),
            whose,
            "{background:?}: {}",
            scene.mouths().explained()
        );
        let mut rgb = Vec::new();
        for row in tracks.outer_iter() {
            rgb.extend(scene.draw(row).unwrap());
        }
        let (width, height) = scene.size();
        let drawn = Frames {
            width,
            height,
            rate_hz: 25.0,
            rgb,
        };
        let pairs: Vec<(f32, f32)> = finder
            .in_clip(&drawn)
            .unwrap()
            .iter()
            .zip(&truth)
            .filter_map(|(a, b)| Some((a.as_ref()?.opening().0, b.as_ref()?.opening().0)))
            .collect();
        assert!(pairs.len() > 70, "a face is seen in {} pictures", pairs.len());
        let follows = correlation(&pairs);
        println!("{background:?}: gap of drawn and recorded lips correlate by {follows:.3}");
        assert!(follows > 0.5, "{background:?}: {follows}");
    }
}
