//! The landmarks of our own runner against those that MediaPipe itself made of GRID's pictures. Needs LIPSTREAM_RESEARCH and `ffmpeg`.
use std::path::PathBuf;

use lipstream_make::vision::{LandmarkFinder, Tracker};
use ndarray::Array4;
use ndarray_npy::ReadNpyExt;

mod common;

/// Outer lips, in the order of the file's first twenty points.
const LIPS: [usize; 20] = [
    61, 185, 40, 39, 37, 0, 267, 269, 270, 409, 291, 375, 321, 405, 314, 17, 84, 181, 91, 146,
];

/// GRID talker 1's folder, his landmarks and the clips that they are of.
fn grid() -> (PathBuf, Array4<i16>, Vec<String>) {
    let grid = common::data().join("grid-s1");
    let npz = grid.join("landmarks.npz");
    let points = Array4::<i16>::read_npy(&common::member(&npz, "points_x32.npy")[..]).unwrap();
    let names = common::names(&common::member(&npz, "clips.npy"));
    (grid, points, names)
}

#[test]
#[ignore = "needs the research data: tests/run --research"]
fn our_landmarks_are_mediapipes() {
    let (grid, points, names) = grid();
    let finder = LandmarkFinder::new().unwrap();
    let (mut distances, mut shifts) = (Vec::new(), [0.0f64; 2]);
    let began = std::time::Instant::now();
    let mut pictures = 0;
    for (index, name) in names.iter().enumerate().step_by(names.len() / 6) {
        let video = ["train", "val", "test"].map(|split| grid.join(split).join(format!("{name}.mpg")));
        let Some(video) = video.iter().find(|path| path.exists()) else {
            continue;
        };
        let frames = lipstream_media::video::decode(video).unwrap();
        pictures += frames.len();
        for (t, found) in finder.in_clip(&frames).unwrap().iter().enumerate().take(75) {
            let found = found.as_ref().expect("a face");
            for (k, place) in LIPS.iter().enumerate() {
                let [x, y] = [0, 1].map(|axis| f32::from(points[(index, t, k, axis)]) / 32.0);
                let (ours_x, ours_y) = found.points()[*place];
                shifts[0] += f64::from(ours_x - x);
                shifts[1] += f64::from(ours_y - y);
                distances.push((ours_x - x).hypot(ours_y - y));
            }
        }
    }
    let n = distances.len() as f64;
    println!(
        "mean shift {:.2} px across, {:.2} px down; {:.1} ms a picture",
        shifts[0] / n,
        shifts[1] / n,
        began.elapsed().as_secs_f64() * 1000.0 / f64::from(pictures as u32)
    );
    distances.sort_by(f32::total_cmp);
    let at = |share: f64| distances[(share * (distances.len() - 1) as f64) as usize];
    println!(
        "{} points: median {:.2} px, 95 % {:.2} px",
        distances.len(),
        at(0.5),
        at(0.95)
    );
    // MediaPipe follows a face with filters of its own, and its video decoder is another.
    assert!(at(0.5) < 1.3 && at(0.95) < 3.0);
}

/// How far the mouth's rectangle, and its scale, are from where landmarks say that they belong: the mouth's middle (its corners') and the lips' about the
/// middle of their own pictures, the distance of the eyes for the scale; as shares of the face's width. 95th percentiles.
#[test]
#[ignore = "needs the research data: tests/run --research"]
fn the_rectangle_stays_where_landmarks_say() {
    let (grid, points, names) = grid();
    let videos = |split: &str, count: usize| -> Vec<(usize, PathBuf)> {
        let of = (0..names.len()).map(|n| (n, grid.join(split).join(format!("{}.mpg", names[n]))));
        let all: Vec<_> = of.filter(|(_, path)| path.exists()).collect();
        let step = all.len() / count;
        all.into_iter().step_by(step).take(count).collect()
    };
    let thinned: Vec<_> = videos("train", 12)
        .iter()
        .map(|(_, path)| lipstream_media::video::decode(path).unwrap().thinned(5))
        .collect();
    let tracker = Tracker::reference(&thinned).unwrap();
    assert_eq!(tracker.mouth_size(), (64, 48));
    let (mut centres, mut lips, mut scales) = (Vec::new(), Vec::new(), Vec::new());
    let mut all = (0, 0);
    for (index, path) in videos("test", 10) {
        let frames = lipstream_media::video::decode(&path).unwrap();
        let track = tracker.track(&frames).unwrap();
        let seen = track.lips.unwrap();
        all = (all.0 + seen.whole, all.1 + seen.looked);
        let mut places = Vec::new();
        for t in 0..track.len().min(75) {
            let at = |k: usize| [0, 1].map(|axis| f32::from(points[(index, t, k, axis)]) / 32.0);
            let between = |a: [f32; 2], b: [f32; 2]| [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
            let inverse = track.transforms[t].inverse().unwrap();
            let corners = between(at(0), at(10));
            let middle = between(corners, between(at(5), at(15)));
            // The jaw's ends are the face's width; the eyes' outer corners its scale.
            let face = (at(65)[0] - at(81)[0]).hypot(at(65)[1] - at(81)[1]);
            let eyes = (at(46)[0] - at(52)[0]).hypot(at(46)[1] - at(52)[1]);
            let scale = track.transforms[t].0[0].hypot(track.transforms[t].0[3]);
            places.push((
                inverse.apply(corners[0], corners[1]),
                inverse.apply(middle[0], middle[1]),
                eyes / scale,
                face / scale,
            ));
        }
        let median = |of: &dyn Fn(usize) -> f32| {
            let mut values: Vec<f32> = (0..places.len()).map(of).collect();
            values.sort_by(f32::total_cmp);
            values[values.len() / 2]
        };
        let width = median(&|t| places[t].3);
        let (cx, cy) = (median(&|t| places[t].0.0), median(&|t| places[t].0.1));
        let (lx, ly) = (median(&|t| places[t].1.0), median(&|t| places[t].1.1));
        let eyes = median(&|t| places[t].2);
        for (corners, middle, apart, _) in &places {
            centres.push((corners.0 - cx).hypot(corners.1 - cy) / width);
            lips.push((middle.0 - lx).hypot(middle.1 - ly) / width);
            scales.push((apart / eyes - 1.0).abs());
        }
    }
    let percent = |mut values: Vec<f32>| {
        values.sort_by(f32::total_cmp);
        100.0 * values[values.len() * 19 / 20]
    };
    let (centres, lips, scales) = (percent(centres), percent(lips), percent(scales));
    println!("lips whole in {} of {} pictures", all.0, all.1);
    println!(
        "95th percentiles, of the face's width: corners' middle {centres:.2} %, lips' middle {lips:.2} %; scale {scales:.2} %"
    );
    assert!(centres < 3.0 && scales < 3.0 && all.0 * 100 >= all.1 * 99);
}
