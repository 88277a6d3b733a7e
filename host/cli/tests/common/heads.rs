//! Heads with the drawn mouth, their landmarks, and films of them.
use std::fmt::Write as _;
use std::path::Path;

use lipstream::render::drawn::{self, HEIGHT, Pose, WIDTH};
use lipstream_media::sink::{Film, Mp4, Sink as _};
use ndarray::{Array3, ArrayView3};

/// Side of a head.
pub(crate) const HEAD: usize = 96;
/// Where the mouth's picture lies in the head's.
pub(crate) const PLACE: (usize, usize) = (16, 40);

/// Left corner, top, right corner, bottom of the outer lips and of the inner ones, then the head's corners and its chin: as `drawn::draw` has them.
pub(crate) fn landmarks(pose: &Pose) -> [[f32; 2]; 13] {
    let half = 20.0 - 9.0 * pose.round + 4.0 * pose.spread;
    let gap = 0.4 + 11.0 * pose.open * (1.0 - 0.35 * pose.round);
    let lip = 3.6 + 2.2 * pose.round - 0.8 * pose.spread;
    let x = PLACE.0 as f32 + WIDTH as f32 / 2.0 - 0.5;
    let y = PLACE.1 as f32 + HEIGHT as f32 * 0.46 - 0.5;
    let (up, down) = (y - 0.4 * gap, y + 0.6 * gap);
    let end = (HEAD - 3) as f32;
    [
        [x - half, y],
        [x, up - 0.8 * lip],
        [x + half, y],
        [x, down + 1.25 * lip],
        [x - half + 3.0, y],
        [x, up],
        [x + half - 3.0, y],
        [x, down],
        [2.0, 2.0],
        [end, 2.0],
        [end, end],
        [2.0, end],
        [x, end - 5.0 + 0.4 * gap],
    ]
}

/// A head with a pattern around the mouth.
pub(crate) fn head(mouth: ArrayView3<u8>) -> Vec<u8> {
    let mut rgb = Vec::with_capacity(HEAD * HEAD * 3);
    for y in 0..HEAD {
        for x in 0..HEAD {
            let inside = (PLACE.0..PLACE.0 + WIDTH).contains(&x) && (PLACE.1..PLACE.1 + HEIGHT).contains(&y);
            match inside {
                true => rgb.extend((0..3).map(|c| mouth[(y - PLACE.1, x - PLACE.0, c)])),
                false => rgb.extend([180 + (x % 16) as u8, 130 + (y / 4) as u8, 110]),
            }
        }
    }
    rgb
}

/// Runs of landmarks, and their sizes.
pub(crate) const GROUPS: [(&str, usize); 3] = [("lips_outer", 4), ("lips_inner", 4), ("head", 5)];

/// The first cells of a table of landmarks.
pub(crate) fn columns() -> String {
    let mut columns = "clip,picture".to_owned();
    for (run, size) in GROUPS {
        (0..size).for_each(|k| columns += &format!(",x_{run}_{k},y_{run}_{k}"));
    }
    columns
}

/// A film of heads with these mouths.
pub(crate) fn film<'m>(path: &Path, fps: u32, mouths: impl IntoIterator<Item = ArrayView3<'m, u8>>) {
    let film = Film {
        width: HEAD,
        height: HEAD,
        fps,
        sound: None,
        comment: None,
    };
    let mut video = Mp4::new(path, &film).unwrap();
    for mouth in mouths {
        video.picture(&head(mouth)).unwrap();
    }
    Box::new(video).finish().unwrap();
}

/// A film `talker.mp4` of 24 heads, and `some.csv`, which labels every fourth; gives the landmarks of all of them.
pub(crate) fn talker(folder: &Path) -> Vec<[[f32; 2]; 13]> {
    let pose = |n: usize| Pose {
        open: 0.5 - 0.5 * (0.9 * n as f32).cos(),
        round: 0.5 + 0.5 * (0.37 * n as f32).sin(),
        spread: 0.3,
    };
    let poses: Vec<Pose> = (0..24).map(pose).collect();
    let mouths: Vec<Array3<u8>> = poses
        .iter()
        .map(|pose| {
            let levels = drawn::draw(*pose).mapv(|v| v as u8);
            levels.into_shape_with_order((HEIGHT, WIDTH, 3)).unwrap()
        })
        .collect();
    film(
        &folder.join("talker.mp4"),
        25,
        mouths.iter().map(|mouth| mouth.view()),
    );
    let truth: Vec<[[f32; 2]; 13]> = poses.iter().map(landmarks).collect();
    let mut table = columns();
    for (picture, points) in truth.iter().enumerate().step_by(4) {
        let _ = write!(table, "\ntalker,{picture}");
        for [x, y] in points {
            let _ = write!(table, ",{x},{y}");
        }
    }
    std::fs::write(folder.join("some.csv"), table + "\n").unwrap();
    truth
}
