//! What one picture of a take shows of its face: lips, framing, light, sharpness.
use lipstream_media::video::Frames;

use crate::vision::{CHIN, EYES, Landmarks};

/// Points of the face, by their numbers in MediaPipe's mesh; left and right are the picture's.
const CHEEKS: [usize; 2] = [234, 454];
const FOREHEAD: usize = 10;
const NOSE_TIP: usize = 1;
const LIP_CORNERS: [usize; 2] = [61, 291];
/// Inner edges of the upper and the lower lip, in the middle of the mouth.
const UPPER_LIP: [usize; 3] = [82, 13, 312];
const LOWER_LIP: [usize; 3] = [87, 14, 317];

/// Samples across the face, and down.
const FACE_GRID: usize = 48;
/// The face's ellipse, of the width between its cheeks and the height from forehead to chin: inside hair and background.
const FACE_SHARE: f32 = 0.8;
/// Levels that are as light or as dark as a video can show.
const WHITE: f32 = 250.0;
const BLACK: f32 = 5.0;
/// The mouth's patch in samples, and how many of them are as long as the face is wide: `prepare` works on faces of about this width.
const MOUTH_GRID: (usize, usize) = (64, 48);
const SAMPLES_ACROSS_FACE: f32 = 160.0;

/// What one picture shows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Look {
    /// Between the inner lips, as a share of the distance of the eyes' outer corners.
    pub(crate) gap: f32,
    /// Between the cheeks, and between the lips' corners, in pixels of the decoded picture.
    pub(crate) face_width: f32,
    pub(crate) mouth_width: f32,
    /// Where the tip of the nose is between the cheeks: −1 left, 0 in the middle, 1 right.
    pub(crate) turn: f32,
    /// Whether all of the face is inside the picture.
    pub(crate) inside: bool,
    pub(crate) light: Light,
    /// Variance of the Laplacian over the variance, of the mouth's luminance.
    pub(crate) sharpness: f32,
}

/// Luminance (0..255) of the face.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Light {
    pub(crate) mean: f32,
    /// Means of its halves, left and right in the picture.
    pub(crate) halves: [f32; 2],
    /// Shares of it that are white and black.
    pub(crate) white: f32,
    pub(crate) black: f32,
}

type Point = (f32, f32);

fn between(a: Point, b: Point) -> Point {
    (0.5 * (a.0 + b.0), 0.5 * (a.1 + b.1))
}

fn apart(a: Point, b: Point) -> f32 {
    (a.0 - b.0).hypot(a.1 - b.1)
}

/// What picture `index` shows, whose landmarks are known.
pub(crate) fn look(frames: &Frames, index: usize, landmarks: &Landmarks) -> Look {
    let points = landmarks.points();
    let at = |index: usize| points[index];
    let mean = |lips: [usize; 3]| {
        let (x, y) = lips
            .map(at)
            .iter()
            .fold((0.0, 0.0), |s, p| (s.0 + p.0, s.1 + p.1));
        (x / 3.0, y / 3.0)
    };
    let [left, right] = CHEEKS.map(at);
    let face_width = apart(left, right).max(1.0);
    // How far along the line between the cheeks the nose is.
    let along = |p: Point| {
        let (dx, dy) = (right.0 - left.0, right.1 - left.1);
        ((p.0 - left.0) * dx + (p.1 - left.1) * dy) / (face_width * face_width)
    };
    let (width, height) = (frames.width as f32 - 1.0, frames.height as f32 - 1.0);
    let is_inside = |p: &Point| (0.0..=width).contains(&p.0) && (0.0..=height).contains(&p.1);
    let [corner, other] = LIP_CORNERS.map(at);
    Look {
        gap: apart(mean(UPPER_LIP), mean(LOWER_LIP)) / apart(at(EYES[0]), at(EYES[1])).max(1.0),
        face_width,
        mouth_width: apart(corner, other),
        turn: 2.0 * along(at(NOSE_TIP)) - 1.0,
        inside: [FOREHEAD, CHIN, CHEEKS[0], CHEEKS[1]]
            .map(at)
            .iter()
            .all(is_inside),
        light: light(
            frames,
            index,
            &CHEEKS.map(at),
            at(FOREHEAD),
            at(CHIN),
            at(NOSE_TIP),
        ),
        sharpness: sharpness(frames, index, between(corner, other), [left, right]),
    }
}

/// Luminance between pixels; None outside the picture.
fn luminance(frames: &Frames, index: usize, (x, y): Point) -> Option<f32> {
    let (wide, high) = (frames.width, frames.height);
    if !(x >= 0.0 && y >= 0.0 && x <= wide as f32 - 1.0 && y <= high as f32 - 1.0) {
        return None;
    }
    let rgb = frames.frame(index);
    let level = |x: usize, y: usize| {
        let at = 3 * (y.min(high - 1) * wide + x.min(wide - 1));
        0.299 * f32::from(rgb[at]) + 0.587 * f32::from(rgb[at + 1]) + 0.114 * f32::from(rgb[at + 2])
    };
    let (left, top) = (x as usize, y as usize);
    let (u, v) = (x.fract(), y.fract());
    let upper = level(left, top) * (1.0 - u) + level(left + 1, top) * u;
    let lower = level(left, top + 1) * (1.0 - u) + level(left + 1, top + 1) * u;
    Some(upper * (1.0 - v) + lower * v)
}

/// The light on the face's ellipse, whose halves meet at the nose.
fn light(frames: &Frames, index: usize, cheeks: &[Point; 2], top: Point, chin: Point, nose: Point) -> Light {
    let middle = between(between(cheeks[0], cheeks[1]), between(top, chin));
    let across = (
        0.5 * (cheeks[1].0 - cheeks[0].0),
        0.5 * (cheeks[1].1 - cheeks[0].1),
    );
    let down = (0.5 * (chin.0 - top.0), 0.5 * (chin.1 - top.1));
    let length = across.0.hypot(across.1).max(1.0);
    let nose = ((nose.0 - middle.0) * across.0 + (nose.1 - middle.1) * across.1) / (length * length);
    let (mut sums, mut counts) = ([0.0f32; 2], [0.0f32; 2]);
    let (mut white, mut black) = (0.0f32, 0.0f32);
    let place = |k: usize| FACE_SHARE * ((2 * k + 1) as f32 / FACE_GRID as f32 - 1.0);
    for (u, v) in (0..FACE_GRID * FACE_GRID).map(|k| (place(k % FACE_GRID), place(k / FACE_GRID))) {
        if u.hypot(v) > FACE_SHARE {
            continue;
        }
        let point = (
            middle.0 + u * across.0 + v * down.0,
            middle.1 + u * across.1 + v * down.1,
        );
        let Some(level) = luminance(frames, index, point) else {
            continue;
        };
        let half = usize::from(u > nose);
        sums[half] += level;
        counts[half] += 1.0;
        white += f32::from(u8::from(level >= WHITE));
        black += f32::from(u8::from(level <= BLACK));
    }
    let count = (counts[0] + counts[1]).max(1.0);
    Light {
        mean: (sums[0] + sums[1]) / count,
        halves: [sums[0] / counts[0].max(1.0), sums[1] / counts[1].max(1.0)],
        white: white / count,
        black: black / count,
    }
}

/// Variance of the Laplacian over the variance, of the luminance about the mouth at the width at which `prepare` works: a picture that is
/// larger is averaged down to it first, one that is smaller has no detail between its pixels.
fn sharpness(frames: &Frames, index: usize, mouth: Point, cheeks: [Point; 2]) -> f32 {
    let step = (
        (cheeks[1].0 - cheeks[0].0) / SAMPLES_ACROSS_FACE,
        (cheeks[1].1 - cheeks[0].1) / SAMPLES_ACROSS_FACE,
    );
    let parts = (step.0.hypot(step.1).round() as usize).clamp(1, 8);
    let (width, height) = MOUTH_GRID;
    let mut levels = Vec::with_capacity(width * height);
    for k in 0..width * height {
        let (x, y) = ((k % width) as f32, (k / width) as f32);
        let mut sum = 0.0;
        for part in 0..parts * parts {
            let inside = |n: usize| (n as f32 + 0.5) / parts as f32 - 0.5;
            let u = x + inside(part % parts) - 0.5 * (width - 1) as f32;
            let v = y + inside(part / parts) - 0.5 * (height - 1) as f32;
            let point = (
                mouth.0 + u * step.0 - v * step.1,
                mouth.1 + u * step.1 + v * step.0,
            );
            sum += luminance(frames, index, point).unwrap_or(0.0);
        }
        levels.push(sum / (parts * parts) as f32);
    }
    let edges = (1..height - 1).flat_map(|y| (1..width - 1).map(move |x| y * width + x));
    let laplacian: Vec<f32> = edges
        .map(|k| levels[k - 1] + levels[k + 1] + levels[k - width] + levels[k + width] - 4.0 * levels[k])
        .collect();
    variance(&laplacian) / variance(&levels).max(1.0)
}

pub(crate) fn variance(values: &[f32]) -> f32 {
    let n = values.len().max(1) as f32;
    let mean = values.iter().sum::<f32>() / n;
    values.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / n
}
