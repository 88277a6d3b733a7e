//! The lip gap and the distance of the corners, measured by colour and read out of parameters, against landmarks of another program, on GRID videos. Needs LIPSTREAM_RESEARCH and
//! `ffmpeg`.
use std::collections::HashMap;
use std::path::Path;

use lipstream::lips::Lips;
use lipstream::mouth::MouthSpace;
use lipstream::opening::OpeningReader;
use lipstream::tensors::Tensors;
use lipstream_make::corpus::{self, PrepareSettings};
use lipstream_make::evaluate::closure::Gaps;
use lipstream_make::features::{FeatureFolder, Split, read_mouths};
use ndarray::{Array4, Axis, s};
use ndarray_npy::ReadNpyExt;

mod common;

use common::{member, names};

/// Gap between the inner lips, and distance of their corners, in pixels of the video for each picture; NaN where there is no face.
fn landmark_openings(npz: &Path) -> HashMap<String, Vec<[f32; 2]>> {
    let points = Array4::<i16>::read_npy(&member(npz, "points_x32.npy")[..]).unwrap();
    // The inner lips are points 20..36: 0 and 7 the corners, 2..5 above and 10..13 below the middle.
    let mean = |lips: ndarray::ArrayView1<i16>| {
        if lips.iter().any(|y| *y == i16::MIN) {
            return f32::NAN;
        }
        lips.iter().map(|y| f32::from(*y) / 32.0).sum::<f32>() / lips.len() as f32
    };
    names(&member(npz, "clips.npy"))
        .into_iter()
        .zip(points.outer_iter())
        .map(|(name, clip)| {
            let openings = clip.outer_iter().map(|face| {
                let gap = mean(face.slice(s![30..33, 1])) - mean(face.slice(s![22..25, 1]));
                let width = mean(face.slice(s![27..28, 0])) - mean(face.slice(s![20..21, 0]));
                [gap, width]
            });
            (name, openings.collect())
        })
        .collect()
}

fn correlation(pairs: &[(f32, f32)]) -> f64 {
    let n = pairs.len() as f64;
    let mean = |f: fn(&(f32, f32)) -> f32| pairs.iter().map(|p| f64::from(f(p))).sum::<f64>() / n;
    let (a, b) = (mean(|p| p.0), mean(|p| p.1));
    let sum = |f: &dyn Fn(f64, f64) -> f64| {
        pairs
            .iter()
            .map(|p| f(f64::from(p.0) - a, f64::from(p.1) - b))
            .sum::<f64>()
    };
    sum(&|x, y| x * y) / (sum(&|x, _| x * x) * sum(&|_, y| y * y)).sqrt()
}

/// Precision and recall of "closed" against landmarks less than a pixel apart.
fn closed(pairs: &[(f32, f32)], below: f32) -> (f64, f64) {
    let count =
        |f: &dyn Fn(bool, bool) -> bool| pairs.iter().filter(|p| f(p.0 < below, p.1 < 1.0)).count() as f64;
    let both = count(&|x, y| x && y);
    (both / count(&|x, _| x), both / count(&|_, y| y))
}

#[test]
#[ignore = "needs the research data: tests/run --research"]
fn colour_agrees_with_landmarks() {
    let grid = common::data().join("grid-s1");
    let folder = tempfile::tempdir().unwrap();
    let corpus_path = folder.path().join("grid");
    for (split, count) in [("train", 10), ("test", 4)] {
        let mut stems: Vec<String> = std::fs::read_dir(grid.join(split))
            .unwrap()
            .filter_map(|e| e.unwrap().file_name().into_string().ok())
            .filter_map(|n| n.strip_suffix(".mpg").map(str::to_owned))
            .collect();
        stems.sort();
        std::fs::create_dir_all(corpus_path.join(split)).unwrap();
        let step = stems.len() / count;
        for stem in stems.iter().step_by(step).take(count) {
            for file in [format!("{stem}.mpg"), format!("{stem}.align")] {
                std::fs::copy(grid.join(split).join(&file), corpus_path.join(split).join(&file)).unwrap();
            }
        }
    }
    let settings = PrepareSettings {
        corpus: corpus_path,
        out: folder.path().join("features"),
        ..Default::default()
    };
    corpus::prepare(&settings, &()).unwrap();
    let features = FeatureFolder::open(&settings.out).unwrap();
    let landmarks = landmark_openings(&grid.join("landmarks.npz"));
    let images = |split: Split| -> Vec<(String, Array4<u8>)> {
        let clips = features.split(split);
        clips
            .map(|c| (c.id.clone(), read_mouths(&features.mouths_path(&c.id)).unwrap()))
            .collect()
    };
    let train = images(Split::Train);
    let views: Vec<_> = train.iter().map(|(_, i)| i.slice(s![..;3, .., .., ..])).collect();
    let lips = Lips::learn(ndarray::concatenate(Axis(0), &views).unwrap().view()).unwrap();
    let gaps = Gaps::learn(&features).unwrap();

    let space = MouthSpace::load(&Tensors::read(&features.mouth_path()).unwrap()).unwrap();
    let reader = OpeningReader::of(&space).unwrap();
    let (mut measured, mut read) = (Vec::new(), Vec::new());
    let (mut corners, mut openings) = (Vec::new(), [Vec::new(), Vec::new()]);
    for ((id, images), clip) in images(Split::Test).iter().zip(features.split(Split::Test)) {
        let real = &landmarks[id];
        let pair = |own: Vec<f32>| {
            let pairs = own.into_iter().zip(real.iter().map(|[gap, _]| *gap));
            pairs.filter(|p| p.1.is_finite()).collect::<Vec<_>>()
        };
        let wide = |own: Vec<f32>| {
            let pairs = own.into_iter().zip(real.iter().map(|[_, width]| *width));
            pairs.filter(|p| p.1.is_finite()).collect::<Vec<_>>()
        };
        measured.extend(pair(lips.gaps(images.view()).unwrap()));
        let weights = features.visual(clip).unwrap();
        read.extend(pair(gaps.read_out(weights.view())));
        corners.extend(wide(
            images.outer_iter().map(|image| lips.corners(image)).collect(),
        ));
        let opening = |row: ndarray::ArrayView1<f32>| reader.read(&row.to_vec());
        openings[0].extend(pair(weights.outer_iter().map(|row| opening(row).gap).collect()));
        openings[1].extend(wide(weights.outer_iter().map(|row| opening(row).width).collect()));
    }
    // Closed by the reader: at 0 of its scale, or a twentieth of it.
    let (precision, recall) = closed(&openings[0], 0.05);
    let [gap, width] = [&openings[0], &openings[1]].map(|pairs| correlation(pairs));
    let corners = correlation(&corners);
    println!(
        "without images, by the eigenmouths alone: gap {gap:.3}, closed: precision {precision:.3}, recall {recall:.3}"
    );
    println!("corners: images {corners:.3}, by the eigenmouths alone {width:.3}");
    assert!(gap > 0.93 && width > 0.25 && corners > 0.5);
    assert!(measured.len() > 250);
    for (what, pairs, least) in [("images", &measured, 0.94), ("eigenmouth weights", &read, 0.92)] {
        let (r, (precision, recall)) = (correlation(pairs), closed(pairs, lips.closed_below()));
        println!("{what}: correlation {r:.3}, closed frames: precision {precision:.3}, recall {recall:.3}");
        assert!(r > least && precision > 0.85 && recall > 0.8, "{what}");
    }
}
