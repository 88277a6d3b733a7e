//! The drawn person says something else.
use ndarray::{Array1, Array2, Axis};

use super::person::{SIZE, picture, place, pose, recording as swaying};
use super::*;
use crate::affine::Affine;
use crate::mouth::MouthSpace;
use crate::render::Scene as _;
use crate::render::drawn;
use crate::render::refine::Choice;

fn recording(count: usize, darker: f32) -> Footage {
    swaying(count, darker, 1.0)
}

/// Weights of the drawn mouths that the recording has in other pictures than they are shown in.
fn wanted(space: &MouthSpace, count: usize) -> Array2<f32> {
    let mut tracks = Array2::zeros((count, space.size()));
    for (n, mut row) in tracks.outer_iter_mut().enumerate() {
        row.assign(&space.project(drawn::draw(pose(3 * n + 20)).view()));
    }
    // From the mean of what the recording shows, as `prepare` gives them.
    let mut mean = Array1::<f32>::zeros(space.size());
    for n in 0..120 {
        mean += &(space.project(drawn::draw(pose(n)).view()) / 120.0);
    }
    tracks - mean
}

fn settings(whose: Option<Whose>) -> FaceSettings {
    FaceSettings {
        whose,
        noise: Some(0.0),
        jaw: None,
        ..FaceSettings::default()
    }
}

/// Mean difference in levels inside the mouth.
fn off(drawn: &[u8], wanted: &[u8], map: &Affine) -> f32 {
    let back = map.inverse().unwrap();
    let (mut sum, mut count) = (0.0, 0.0f32);
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let (u, v) = back.apply(x as f32, y as f32);
            if (u - 31.5).abs() < 24.0 && (v - 23.5).abs() < 16.0 {
                for c in 0..3 {
                    let at = 3 * (y * SIZE.0 + x) + c;
                    sum += f32::from(drawn[at].abs_diff(wanted[at]));
                    count += 1.0;
                }
            }
        }
    }
    sum / count
}

#[test]
fn a_recording_says_something_else() {
    let space = drawn::space(8);
    let mut footage = recording(120, 0.0);
    let tracks = wanted(&space, 30);
    let asked = Wanted {
        tracks: tracks.view(),
        energy: None,
    };
    let mut scene = FaceScene::new(&mut footage, &space, &asked, &settings(None)).unwrap();
    assert_eq!(scene.mouths().whose(), Whose::Trained);
    let fit = scene.mouths().fit();
    assert!(fit.likeness > 0.95, "{fit:?}");
    let (x, y) = fit.to_model.apply(31.5, 23.5);
    assert!((x - 31.5).abs() < 1.5 && (y - 23.5).abs() < 1.5, "{fit:?}");
    let mut before = 0.0;
    let mut after = 0.0;
    for (n, row) in tracks.outer_iter().enumerate() {
        let rgb = scene.draw(row).unwrap();
        let (plain, map) = scene.undrawn(n).unwrap();
        let truth = picture(&drawn::draw(pose(3 * n + 20)), &map, 0.0);
        before += off(&plain, &truth, &map) / 30.0;
        after += off(&rgb, &truth, &map) / 30.0;
        let back = map.inverse().unwrap();
        for at in 0..SIZE.0 * SIZE.1 {
            let (u, v) = back.apply((at % SIZE.0) as f32, (at / SIZE.0) as f32);
            if scene.opacity(u, v) == 0.0 {
                assert_eq!(rgb[3 * at..3 * at + 3], plain[3 * at..3 * at + 3]);
            }
        }
    }
    // Another mouth than the recording's, and the one that was asked for.
    assert!(before > 6.0 && after < 0.4 * before, "{before} {after}");
}

#[test]
fn other_light_stays_the_recordings() {
    let space = drawn::space(8);
    let mut footage = recording(120, 40.0);
    let tracks = wanted(&space, 10);
    let asked = Wanted {
        tracks: tracks.view(),
        energy: None,
    };
    for whose in [Whose::Trained, Whose::Models] {
        let mut scene = FaceScene::new(&mut footage, &space, &asked, &settings(Some(whose))).unwrap();
        for (n, row) in tracks.outer_iter().enumerate() {
            let rgb = scene.draw(row).unwrap();
            let (_, map) = scene.undrawn(n).unwrap();
            let truth = picture(&drawn::draw(pose(3 * n + 20)), &map, 40.0);
            let off = off(&rgb, &truth, &map);
            assert!(off < 6.0, "{whose:?} {n}: {off}");
        }
    }
}

/// A stranger's own mouths open as far as the model's.
#[test]
fn mouths_of_a_stranger_are_chosen_by_their_opening() {
    let space = drawn::space(8);
    let mut footage = recording(120, 0.0);
    let tracks = wanted(&space, 60);
    let asked = Wanted {
        tracks: tracks.view(),
        energy: None,
    };
    let mut scene = FaceScene::new(&mut footage, &space, &asked, &settings(Some(Whose::Opened))).unwrap();
    let (mut dark, mut open) = (Vec::new(), Vec::new());
    for (n, row) in tracks.outer_iter().enumerate() {
        let rgb = scene.draw(row).unwrap();
        let (_, map) = scene.undrawn(n).unwrap();
        let (x, y) = map.apply(31.5, 24.0);
        let from = Bytes {
            rgb: &rgb,
            width: SIZE.0,
            height: SIZE.1,
        };
        let column: f32 = (-6..=6i8).map(|dy| from.sample(x, y + f32::from(dy))[1]).sum();
        dark.push(-column);
        open.push(pose(3 * n + 20).open);
    }
    let mean = |v: &[f32]| v.iter().sum::<f32>() / v.len() as f32;
    let (md, mo) = (mean(&dark), mean(&open));
    let sum = |f: &dyn Fn(f32, f32) -> f32| {
        dark.iter()
            .zip(&open)
            .map(|(a, b)| f(a - md, b - mo))
            .sum::<f32>()
    };
    let correlation = sum(&|a, b| a * b) / (sum(&|a, _| a * a) * sum(&|_, b| b * b)).sqrt();
    assert!(correlation > 0.8, "{correlation}");
}

/// The lower face that is lent hangs as far as the mouth asks; the louder, the further, where the sound says it.
#[test]
fn jaws_follow_the_mouth_or_the_sound() {
    let space = drawn::space(8);
    let mut footage = recording(120, 0.0);
    let tracks = wanted(&space, 40);
    let opens: Vec<f32> = (0..40).map(|n| pose(3 * n + 20).open).collect();
    let turned = vec![0.0; 40];
    let mouths = Mouths::learn(&mut footage, &space, Some(Whose::Trained), 500).unwrap();
    let (keys, pictures) = mouths.seen();
    let jaws = jaw::Jaws::learn(&mut footage, keys, pictures).unwrap().unwrap();
    for by in [JawBy::Mouth, JawBy::Energy] {
        let asked = jaw::Asked {
            tracks: tracks.view(),
            energy: Some(&opens),
            turned: &turned,
            by,
        };
        let lent = jaws.choose(&asked);
        let off: f32 = lent
            .iter()
            .zip(&opens)
            .map(|(picture, open)| (pose(*picture).open - open).abs())
            .sum::<f32>()
            / 40.0;
        assert!(off < 0.25, "{by:?}: {off}");
    }
}

#[test]
fn impossible_settings_are_refused() {
    let space = drawn::space(8);
    let mut footage = recording(30, 0.0);
    let tracks = wanted(&space, 5);
    let asked = Wanted {
        tracks: tracks.view(),
        energy: None,
    };
    for wrong in [
        FaceSettings {
            fps: 0,
            ..FaceSettings::default()
        },
        FaceSettings {
            noise: Some(-1.0),
            ..FaceSettings::default()
        },
    ] {
        assert!(FaceScene::new(&mut footage, &space, &asked, &wrong).is_err());
    }
    let mut empty = recording(0, 0.0);
    assert!(FaceScene::new(&mut empty, &space, &asked, &FaceSettings::default()).is_err());
    // Without a jaw that is seen, the recording's lower face stays.
    footage.jaw = None;
    let mut scene = FaceScene::new(&mut footage, &space, &asked, &FaceSettings::default()).unwrap();
    for row in tracks.axis_iter(Axis(0)) {
        assert_eq!(scene.draw(row).unwrap().len(), SIZE.0 * SIZE.1 * 3);
    }
}

/// What is drawn live, picture by picture, 25 a second.
/// Pictures that an interrupted run has drawn need not be drawn again.
#[test]
fn a_second_begins_anew() {
    let space = drawn::space(8);
    let tracks = wanted(&space, 60);
    let asked = Wanted {
        tracks: tracks.view(),
        energy: None,
    };
    let settings = FaceSettings {
        noise: Some(2.0),
        jaw: Some(JawBy::Mouth),
        ..settings(None)
    };
    let film = |begun: usize| -> Vec<Vec<u8>> {
        let mut footage = recording(120, 20.0);
        let mut scene = FaceScene::new(&mut footage, &space, &asked, &settings).unwrap();
        scene.pass_over(begun);
        let rows = tracks.outer_iter().skip(begun);
        rows.map(|row| scene.draw(row).unwrap()).collect()
    };
    let whole = film(0);
    assert!(film(25) == whole[25..]);
    // In the middle of a second the light of the picture before is not known.
    assert!(film(30)[0] != whole[30] && film(30)[20..] == whole[50..]);
}

fn live(face: &mut LiveFace, tracks: &Array2<f32>) -> Vec<Vec<u8>> {
    tracks
        .outer_iter()
        .enumerate()
        .map(|(n, row)| face.draw((n as f64 + 0.5) / 25.0, row).unwrap())
        .collect()
}

/// A film of the same, which knew all of it beforehand.
fn film(tracks: &Array2<f32>, space: &MouthSpace, settings: &FaceSettings) -> Vec<Vec<u8>> {
    let mut footage = recording(120, 0.0);
    let asked = Wanted {
        tracks: tracks.view(),
        energy: None,
    };
    let mut scene = FaceScene::new(&mut footage, space, &asked, settings).unwrap();
    tracks.outer_iter().map(|row| scene.draw(row).unwrap()).collect()
}

/// Where there is nothing to look ahead for, a live face is the film's: with a mouth that stays, its jaw and noise included, and with details that are
/// chosen picture by picture. For a second it is so bit for bit; then the film finds the light anew, which rounds otherwise.
#[test]
fn live_is_the_film_where_the_future_says_nothing() {
    let space = drawn::space(8);
    let moving = wanted(&space, 30);
    let still = Array2::from_shape_fn(moving.dim(), |(_, d)| moving[(7, d)]);
    let noisy = FaceSettings {
        noise: Some(2.0),
        ..FaceSettings::default()
    };
    let nearest = FaceSettings {
        detail: Some(Choice::FrameWise),
        ..settings(None)
    };
    for (tracks, whose, settings) in [
        (&still, Whose::Trained, noisy),
        (&still, Whose::Opened, noisy),
        (&still, Whose::Models, noisy),
        (&moving, Whose::Trained, nearest),
        (&moving, Whose::Opened, nearest),
        (&moving, Whose::Models, nearest),
    ] {
        let settings = FaceSettings {
            whose: Some(whose),
            ..settings
        };
        let mut face = LiveFace::new(recording(120, 0.0), space.clone(), &settings).unwrap();
        assert_eq!(
            (face.size(), face.fps(), face.mouths().whose()),
            (SIZE, 25, whose)
        );
        let (live, film) = (live(&mut face, tracks), film(tracks, &space, &settings));
        assert!(live[..25] == film[..25], "{whose:?} {settings:?}");
        let off = std::iter::zip(live.concat(), film.concat()).map(|(a, b)| a.abs_diff(b));
        assert!(off.max() <= Some(1), "{whose:?} {settings:?}");
    }
}

/// A mouth that trembles between two others makes the face flicker less than its nearest pictures would; one that speaks is about as near to the film as a picture is to its next.
#[test]
fn live_neither_flickers_nor_lags() {
    let space = drawn::space(8);
    // Slower than the recording speaks elsewhere here, which is six syllables a second.
    let fast = wanted(&space, 21);
    let speaking = Array2::from_shape_fn((60, space.size()), |(n, d)| {
        let part = (n % 3) as f32 / 3.0;
        (1.0 - part) * fast[(n / 3, d)] + part * fast[(n / 3 + 1, d)]
    });
    let mut trembling = speaking.clone();
    for (n, mut row) in trembling.outer_iter_mut().enumerate() {
        let tremble = if n % 2 == 0 { 8.0 } else { -8.0 };
        row.mapv_inplace(|v| v + tremble);
    }
    let usual = settings(Some(Whose::Opened));
    let nearest = FaceSettings {
        detail: Some(Choice::FrameWise),
        ..usual
    };
    let draw = |tracks: &Array2<f32>, settings: &FaceSettings| {
        let mut face = LiveFace::new(recording(120, 0.0), space.clone(), settings).unwrap();
        live(&mut face, tracks)
    };
    let apart = |a: &[Vec<u8>], b: &[Vec<u8>]| -> f32 {
        let pairs = a.iter().zip(b).enumerate();
        pairs.map(|(n, (a, b))| off(a, b, &place(n, 1.0))).sum::<f32>() / a.len().min(b.len()) as f32
    };
    let change = |pictures: &[Vec<u8>]| apart(pictures, &pictures[1..]);
    let [film_trembles, live_trembles, jumps] = [
        change(&film(&trembling, &space, &usual)),
        change(&draw(&trembling, &usual)),
        change(&draw(&trembling, &nearest)),
    ];
    assert!(
        live_trembles < 1.8 * film_trembles && live_trembles < 0.95 * jumps,
        "from picture to picture: film {film_trembles}, live {live_trembles}, nearest {jumps} levels"
    );
    let planned = film(&speaking, &space, &usual);
    let (off, ordinary) = (apart(&planned, &draw(&speaking, &usual)), change(&planned));
    assert!(
        off < 1.5 * ordinary,
        "{off} levels from the film, whose pictures are {ordinary} from the next"
    );
}

#[test]
fn what_cannot_be_live_is_refused() {
    let space = drawn::space(8);
    let by_sound = FaceSettings {
        jaw: Some(JawBy::Energy),
        ..FaceSettings::default()
    };
    let refused = LiveFace::new(recording(30, 0.0), space.clone(), &by_sound)
        .err()
        .unwrap();
    assert!(refused.to_string().contains("follow the mouth"), "{refused}");
    assert!(LiveFace::new(recording(0, 0.0), space.clone(), &settings(None)).is_err());
    let mut face = LiveFace::new(recording(120, 0.0), space, &FaceSettings::default()).unwrap();
    let other = Array1::zeros(9);
    assert!(
        face.draw(0.0, other.view())
            .unwrap_err()
            .to_string()
            .contains("another model")
    );
    let none = Array1::from_elem(8, f32::NAN);
    assert_eq!(face.draw(1e6, none.view()).unwrap().len(), SIZE.0 * SIZE.1 * 3);
    for (own, live) in [
        (25.0, 25),
        (29.97, 30),
        (50.0, 25),
        (60.0, 30),
        (120.0, 30),
        (0.2, 1),
    ] {
        let mut footage = recording(1, 0.0);
        footage.rate_hz = own;
        assert_eq!(LiveFace::rate(&footage), live, "{own}");
    }
}
