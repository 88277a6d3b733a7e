//! Points of a face, and above all its lips: MediaPipe's face-landmark network, carried inside the program.
//!
//! 468 points of a face that looks about into the camera, from a square of 192 × 192 pixels around it, turned so that the eyes are level. Only
//! points that are needed have names here. The network and its licence (Apache-2.0) are in `host/make/assets/face/`.
use std::sync::OnceLock;

use ndarray::Array3;

use super::face::{Detector, FaceBox};
use super::network::Network;
use crate::error::{Error, Result};
use lipstream::affine::Affine;
use lipstream_media::video::Frames;

/// The file as it lies in the npm package `@mediapipe/face_mesh` 0.4.1657299874.
const MODEL: &[u8] = include_bytes!("../../assets/face/face_landmark.tflite");
/// Points of a face.
const POINTS: usize = 468;
/// Points of the outer lips, around; the corners are the first and the eleventh.
const OUTER_LIPS: [usize; 20] = [
    61, 185, 40, 39, 37, 0, 267, 269, 270, 409, 291, 375, 321, 405, 314, 17, 84, 181, 91, 146,
];
/// Outer corners of the eyes, left in the picture first.
pub(crate) const EYES: [usize; 2] = [33, 263];
/// In the middle, inner edges of the upper and the lower lip.
const INNER_LIPS: [usize; 2] = [13, 14];
/// Tip of the nose's base, above the upper lip.
const NOSE_BASE: usize = 2;
/// Tip of the chin.
pub(crate) const CHIN: usize = 152;
/// Edges of the face at the height of the lips, left in the picture first.
const SIDES: [usize; 2] = [58, 288];
/// The square is so much larger than what it holds.
const MARGIN: f32 = 1.5;
/// Times that a square is laid anew around the points that were found in it.
const ROUNDS: usize = 2;
/// Of the network's own certainty that there is a face, before its logistic curve.
const LEAST_SCORE: f32 = 0.0;

/// A face's points in pixels of its picture.
#[derive(Clone, Debug)]
pub struct Landmarks(Vec<(f32, f32)>);

impl Landmarks {
    /// All points, in pixels of the picture, whose centres lie at whole numbers.
    pub fn points(&self) -> &[(f32, f32)] {
        &self.0
    }
}

/// Where the lips are, in any coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lips {
    /// Left, top, right, bottom of the outer lips.
    pub(crate) extent: [f32; 4],
    /// Between the corners.
    pub(crate) middle: (f32, f32),
    /// What speech moves least: half-way from the middle of the corners to the base of the nose.
    pub(crate) anchor: (f32, f32),
    /// Between the inner edges.
    pub(crate) gap: f32,
}

/// The outer lips, around; the corners are the first and the eleventh.
pub type Outline = [(f32, f32); OUTER_LIPS.len()];

impl Landmarks {
    /// The outer lips.
    pub fn outline(&self) -> Outline {
        OUTER_LIPS.map(|index| self.0[index])
    }

    /// The lips' place, each point through `map`.
    pub(crate) fn lips(&self, map: &Affine) -> Lips {
        let at = |index: usize| {
            let (x, y) = self.0[index];
            map.apply(x, y)
        };
        let mut extent = [f32::INFINITY, f32::INFINITY, f32::NEG_INFINITY, f32::NEG_INFINITY];
        for (x, y) in self.outline().map(|(x, y)| map.apply(x, y)) {
            extent = [
                extent[0].min(x),
                extent[1].min(y),
                extent[2].max(x),
                extent[3].max(y),
            ];
        }
        let between = |a: (f32, f32), b: (f32, f32)| (0.5 * (a.0 + b.0), 0.5 * (a.1 + b.1));
        let middle = between(at(OUTER_LIPS[0]), at(OUTER_LIPS[10]));
        let [upper, lower] = INNER_LIPS.map(at);
        Lips {
            extent,
            middle,
            anchor: between(middle, at(NOSE_BASE)),
            gap: (lower.0 - upper.0).hypot(lower.1 - upper.1),
        }
    }

    /// Distance of two points.
    fn apart(&self, a: usize, b: usize) -> f32 {
        (self.0[a].0 - self.0[b].0).hypot(self.0[a].1 - self.0[b].1)
    }

    /// Base of the nose, chin, left and right edge of the face at the height of the lips, each through `map`.
    pub(crate) fn lower_face(&self, map: &Affine) -> [(f32, f32); 4] {
        [NOSE_BASE, CHIN, SIDES[0], SIDES[1]].map(|index| {
            let (x, y) = self.0[index];
            map.apply(x, y)
        })
    }

    /// How far the jaw hangs: from the nose's base to the chin, over the distance between the outer corners of the eyes.
    pub fn jaw(&self) -> f32 {
        self.apart(NOSE_BASE, CHIN) / self.apart(EYES[0], EYES[1]).max(1e-3)
    }

    /// Gap between the inner lips and distance of the lips' corners, over the distance between the outer corners of the eyes.
    pub fn opening(&self) -> (f32, f32) {
        let eyes = self.apart(EYES[0], EYES[1]).max(1e-3);
        let gap = self.apart(INNER_LIPS[0], INNER_LIPS[1]);
        (gap / eyes, self.apart(OUTER_LIPS[0], OUTER_LIPS[10]) / eyes)
    }

    /// The outer lips in the face's own coordinates: from the base of the nose, along the line of the eyes, over their distance.
    pub fn lips_in_face(&self) -> Vec<(f32, f32)> {
        let [(ax, ay), (bx, by)] = EYES.map(|index| self.0[index]);
        let (dx, dy) = (bx - ax, by - ay);
        let square = (dx * dx + dy * dy).max(1e-3);
        let nose = self.0[NOSE_BASE];
        let of = |index: usize| {
            let (x, y) = (self.0[index].0 - nose.0, self.0[index].1 - nose.1);
            ((x * dx + y * dy) / square, (y * dx - x * dy) / square)
        };
        OUTER_LIPS.map(of).into()
    }

    /// How far the head is turned: where the nose's base lies between the outer corners of the eyes, -1 at the left one in the picture, 1 at the right one.
    pub fn turned(&self) -> f32 {
        let [(ax, ay), (bx, by)] = EYES.map(|index| self.0[index]);
        let (x, y) = self.0[NOSE_BASE];
        let (dx, dy) = (bx - ax, by - ay);
        let along = ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy).max(1e-3);
        2.0 * along - 1.0
    }

    /// The square to look in for the next picture.
    fn square(&self) -> Square {
        let (mut left, mut top, mut right, mut bottom) =
            (f32::INFINITY, f32::INFINITY, f32::NEG_INFINITY, f32::NEG_INFINITY);
        for (x, y) in &self.0 {
            (left, top, right, bottom) = (left.min(*x), top.min(*y), right.max(*x), bottom.max(*y));
        }
        let [a, b] = EYES.map(|index| self.0[index]);
        Square {
            centre: (0.5 * (left + right) + 0.5, 0.5 * (top + bottom) + 0.5),
            side: MARGIN * (right - left).max(bottom - top),
            angle: (b.1 - a.1).atan2(b.0 - a.0),
        }
    }
}

/// A turned square of a picture, in pixels from the picture's corner.
#[derive(Clone, Copy)]
struct Square {
    centre: (f32, f32),
    side: f32,
    angle: f32,
}

impl Square {
    /// Around a detector's box, which ends at the chin.
    fn of_box(face: FaceBox) -> Self {
        let half = 0.5 * face.side;
        Self {
            centre: (face.left + half, face.top + half),
            side: MARGIN * face.side,
            angle: 0.0,
        }
    }

    /// From pixels of a square of `size` to the picture's.
    fn map(&self, size: f32) -> Affine {
        let scale = self.side / size;
        let (sin, cos) = self.angle.sin_cos();
        let (a, b) = (scale * cos, -scale * sin);
        let (c, d) = (scale * sin, scale * cos);
        let middle = 0.5 * size;
        Affine([
            a,
            b,
            self.centre.0 - a * middle - b * middle,
            c,
            d,
            self.centre.1 - c * middle - d * middle,
        ])
    }
}

/// Finds landmarks.
#[derive(Clone, Copy)]
pub struct LandmarkFinder {
    network: &'static Network,
}

impl LandmarkFinder {
    /// The landmarks in every picture; None where there is no face. The face is looked for where it was in the picture before.
    ///
    /// # Errors
    ///
    /// That no picture has a face.
    pub fn in_clip(&self, frames: &Frames) -> Result<Vec<Option<Landmarks>>> {
        let face = Detector::new()?.find_in_clip(frames)?;
        let mut walk = Walk::new(*self, frames);
        Ok((0..frames.len()).map(|index| walk.at(index, [face])).collect())
    }

    /// Reads the network, the first time.
    ///
    /// # Errors
    ///
    /// None, as long as the program is whole.
    pub fn new() -> Result<Self> {
        static NETWORK: OnceLock<Result<Network, String>> = OnceLock::new();
        let network = NETWORK.get_or_init(|| Network::of_tflite(MODEL).map_err(|e| e.to_string()));
        match network {
            Ok(network) => Ok(Self { network }),
            Err(what) => Err(Error::File(what.clone())),
        }
    }

    /// The landmarks of the face about `face`, in pixels of picture `index`; None where the network sees none.
    fn near_box(&self, frames: &Frames, index: usize, face: FaceBox) -> Option<Landmarks> {
        self.rounds(frames, index, Square::of_box(face), ROUNDS)
    }

    /// The landmarks of the face that `before` found in a picture near this one.
    fn near(&self, frames: &Frames, index: usize, before: &Landmarks) -> Option<Landmarks> {
        self.rounds(frames, index, before.square(), 1)
    }

    fn rounds(&self, frames: &Frames, index: usize, mut square: Square, rounds: usize) -> Option<Landmarks> {
        let mut found = None;
        for _ in 0..rounds {
            let landmarks = self.look(frames, index, &square)?;
            square = landmarks.square();
            found = Some(landmarks);
        }
        found
    }

    fn look(&self, frames: &Frames, index: usize, square: &Square) -> Option<Landmarks> {
        let (height, width) = self.network.size();
        let map = square.map(width as f32);
        let picture = sampled(frames, index, &map, (height, width));
        let outputs = self.network.run(picture).ok()?;
        let points = outputs.iter().find(|o| o.len() == 3 * POINTS)?;
        let score = outputs.iter().find(|o| o.len() == 1)?.first().copied()?;
        if score.is_nan() || score < LEAST_SCORE {
            return None;
        }
        let points: Vec<f32> = points.iter().copied().collect();
        let (triples, _) = points.as_chunks::<3>();
        // The network counts from the square's corner, we from the middle of the first pixel.
        let in_picture = |[x, y, _]: &[f32; 3]| {
            let (x, y) = map.apply(*x, *y);
            (x - 0.5, y - 0.5)
        };
        let in_picture: Vec<(f32, f32)> = triples.iter().map(in_picture).collect();
        let finite = in_picture.iter().all(|(x, y)| x.is_finite() && y.is_finite());
        finite.then_some(Landmarks(in_picture))
    }
}

/// Goes through pictures of a clip, each looked at where the face was in the one before.
pub(crate) struct Walk<'f> {
    finder: LandmarkFinder,
    frames: &'f Frames,
    before: Option<Landmarks>,
}

impl<'f> Walk<'f> {
    pub(crate) fn new(finder: LandmarkFinder, frames: &'f Frames) -> Self {
        Self {
            finder,
            frames,
            before: None,
        }
    }

    /// The landmarks of a picture; where there are none beside those before, `faces` say one after another where else to look.
    pub(crate) fn at(&mut self, index: usize, faces: impl IntoIterator<Item = FaceBox>) -> Option<Landmarks> {
        let near = self
            .before
            .as_ref()
            .and_then(|before| self.finder.near(self.frames, index, before));
        let found = near.or_else(|| {
            faces
                .into_iter()
                .find_map(|face| self.finder.near_box(self.frames, index, face))
        });
        self.before.clone_from(&found);
        found
    }
}

/// A square of a picture, red, green, blue in 0..1; outside it is black. Where the square is larger than the network's picture, pixels are means of
/// what they cover.
fn sampled(frames: &Frames, index: usize, map: &Affine, (height, width): (usize, usize)) -> Array3<f32> {
    let rgb = frames.frame(index);
    let (wide, high) = (frames.width as i64, frames.height as i64);
    const BLACK: &[u8; 3] = &[0; 3];
    let pixel = |x: i64, y: i64| -> &[u8; 3] {
        if x < 0 || y < 0 || x >= wide || y >= high {
            return BLACK;
        }
        rgb[((y * wide + x) * 3) as usize..]
            .first_chunk()
            .unwrap_or(BLACK)
    };
    let scale = map.0[0].hypot(map.0[3]);
    let parts = (scale.round() as usize).clamp(1, 8);
    let inside: Vec<f32> = (0..parts).map(|k| (k as f32 + 0.5) / parts as f32).collect();
    let share = 1.0 / (255 * parts * parts) as f32;
    let mut levels = Vec::with_capacity(height * width * 3);
    for y in 0..height {
        for x in 0..width {
            let mut sums = [0.0f32; 3];
            for (down, across) in inside.iter().flat_map(|v| inside.iter().map(move |u| (v, u))) {
                let (fx, fy) = map.apply(x as f32 + across, y as f32 + down);
                // Pixel centres are at halves.
                let (left, top) = ((fx - 0.5).floor(), (fy - 0.5).floor());
                let (u, v) = (fx - 0.5 - left, fy - 0.5 - top);
                let (left, top) = (left as i64, top as i64);
                let near = [
                    (pixel(left, top), (1.0 - u) * (1.0 - v)),
                    (pixel(left + 1, top), u * (1.0 - v)),
                    (pixel(left, top + 1), (1.0 - u) * v),
                    (pixel(left + 1, top + 1), u * v),
                ];
                for (levels, weight) in near {
                    sums.iter_mut()
                        .zip(levels)
                        .for_each(|(sum, level)| *sum += weight * f32::from(*level));
                }
            }
            levels.extend(sums.map(|sum| sum * share));
        }
    }
    Array3::from_shape_vec((height, width, 3), levels).unwrap_or_default()
}
