//! The active shape model: finds a face's points in a picture by what lies across their contours, within what shapes there are.
//!
//! From coarse to fine, each point goes along its normal to where the picture is most like its profile, and the nearest shape within the limits is taken; until the points stay
//! (Cootes, Taylor, Cooper and Graham 1995; many resolutions: Cootes, Taylor and Lanitis 1994). It starts from the points of the picture before, or from the face detector's square;
//! where that sees a face in no labelled picture, as of a drawn one, from where faces lie in these.
use ndarray::{Array1, Array2, ArrayView1, Axis, stack};

use super::profile::{Line, Profile};
use super::shape::{Pose, ShapeModel, width};
use crate::error::{Result, ensure};
use crate::hierarchical::principal::Keep;
use crate::vision::{Detector, FaceBox, Pyramid, colour_planes, luminance};
use lipstream_media::video::Frames;

/// Resolutions; the steps along a normal are 2ˡ units at level l.
const LEVELS: usize = 4;
/// The coarsest level when the points of the picture before are known.
const NEAR: usize = 2;
/// Steps to each side that a point looks.
const SEARCH: usize = 3;
/// Rounds at a level, at most.
const ROUNDS: usize = 8;
/// A level is done when so many of the points stay within half of the search.
const STAY: f32 = 0.9;
/// How much of the shapes' variance the components carry.
const KEEP: Keep = Keep {
    share: 0.98,
    most: 40,
};

/// A picture made ready to be searched.
#[derive(Clone)]
pub struct Look {
    pub(super) pyramid: Pyramid,
    face: Option<FaceBox>,
}

impl Look {
    /// Picture `index` of a clip; the face in it is looked for.
    pub fn new(frames: &Frames, index: usize, detector: &mut FaceFinder) -> Self {
        let mut look = Self::without_face(frames, index);
        look.face = detector.0.find(frames, index);
        look
    }

    /// Picture `index` of a clip, where the face is known to be near points that are known.
    pub fn without_face(frames: &Frames, index: usize) -> Self {
        Self {
            pyramid: Pyramid::new(luminance(&colour_planes(frames, index, 1)), LEVELS + 2),
            face: None,
        }
    }

    /// Whether the detector sees a face.
    pub fn has_face(&self) -> bool {
        self.face.is_some()
    }
}

/// The face detector; it is not for several threads at a time.
pub struct FaceFinder(Detector);

impl FaceFinder {
    /// Reads the detector's model.
    ///
    /// # Errors
    ///
    /// None, as long as the program is whole.
    pub fn new() -> Result<Self> {
        Ok(Self(Detector::new()?))
    }
}

/// A labelled picture.
pub struct Example {
    /// The picture.
    pub look: Look,
    /// Its points x₀, y₀, x₁, …, in pixels.
    pub points: Array1<f32>,
}

/// Points that were found.
#[derive(Clone, Debug)]
pub struct Fit {
    /// x₀, y₀, x₁, …, in pixels.
    pub points: Array1<f32>,
    /// How unlike the labelled pictures it looks across the contours: the mean over points of the Mahalanobis distance of a dimension; about 1 where it looks like them.
    pub unlike: f32,
}

/// Where shapes lie in the detector's square, in sides of it from its middle.
#[derive(Clone, Copy, Debug)]
struct Place {
    a: f32,
    b: f32,
    at: [f32; 2],
}

impl Place {
    fn of(pose: &Pose, face: &FaceBox) -> Self {
        let middle = [face.left, face.top].map(|edge| edge + 0.5 * face.side);
        Self {
            a: pose.a / face.side,
            b: pose.b / face.side,
            at: [0, 1].map(|axis| (pose.at[axis] - middle[axis]) / face.side),
        }
    }

    fn pose(&self, face: &FaceBox) -> Pose {
        let middle = [face.left, face.top].map(|edge| edge + 0.5 * face.side);
        Pose {
            a: self.a * face.side,
            b: self.b * face.side,
            at: [0, 1].map(|axis| middle[axis] + self.at[axis] * face.side),
        }
    }
}

/// A model that finds points.
pub struct ActiveShape {
    shape: ShapeModel,
    /// `[level][point]`.
    profiles: Vec<Vec<Profile>>,
    start: Start,
}

/// Where the search begins in a picture whose neighbours are unknown.
enum Start {
    /// In the detector's square.
    Square(Place),
    /// At the same place of every picture.
    Here(Pose),
}

impl ActiveShape {
    /// Learns from labelled pictures. `starts` are points at which a run of points begins, where that is known.
    ///
    /// # Errors
    ///
    /// No picture, pictures of different numbers of points, or points without extent.
    pub fn learn(examples: &[&Example], starts: &[usize]) -> Result<Self> {
        let count = examples.first().map_or(0, |example| example.points.len());
        ensure!(
            examples.iter().all(|example| example.points.len() == count),
            Data,
            "labelled pictures have different numbers of points"
        );
        let views: Vec<ArrayView1<f32>> = examples.iter().map(|example| example.points.view()).collect();
        let points = match views.is_empty() {
            true => Array2::zeros((0, 0)),
            false => stack(Axis(0), &views)?,
        };
        let shape = ShapeModel::learn(&points, starts, KEEP)?;
        let poses: Vec<Pose> = views.iter().map(|points| shape.explain(*points).0).collect();
        let profiles = (0..LEVELS)
            .map(|level| {
                let of_point = |point: usize| {
                    let lines: Vec<Line<'_>> = examples
                        .iter()
                        .zip(&poses)
                        .map(|(example, pose)| {
                            line(&shape, &example.look, example.points.view(), point, pose, level)
                        })
                        .collect();
                    Profile::learn(&lines)
                };
                (0..shape.count()).map(of_point).collect()
            })
            .collect();
        let places: Vec<Place> = examples
            .iter()
            .zip(&poses)
            .filter_map(|(example, pose)| Some(Place::of(pose, example.look.face.as_ref()?)))
            .collect();
        Ok(Self {
            start: match mean(&places) {
                Some(place) => Start::Square(place),
                None => Start::Here(Pose::between(
                    shape.linear.mean.view(),
                    points.mean_axis(Axis(0)).unwrap_or_default().view(),
                )),
            },
            shape,
            profiles,
        })
    }

    /// The shapes it knows.
    pub fn shape(&self) -> &ShapeModel {
        &self.shape
    }

    /// Finds the points: near those of a picture just before it, else where the detector sees a face; None where it sees none and should.
    pub fn find(&self, look: &Look, before: Option<ArrayView1<f32>>) -> Option<Fit> {
        let (pose, parameters, coarsest) = match before {
            Some(points) => {
                let (pose, parameters) = self.shape.explain(points);
                (pose, parameters, NEAR)
            }
            None => {
                let pose = match &self.start {
                    Start::Square(place) => place.pose(look.face.as_ref()?),
                    Start::Here(pose) => *pose,
                };
                (pose, Array1::zeros(self.shape.linear.modes()), LEVELS - 1)
            }
        };
        Some(self.search(look, pose, parameters, coarsest))
    }

    fn search(&self, look: &Look, mut pose: Pose, mut parameters: Array1<f32>, coarsest: usize) -> Fit {
        for level in (0..=coarsest).rev() {
            for _ in 0..ROUNDS {
                let points = self.shape.points(&pose, parameters.view());
                let (moved, stayed) = self.moved(look, points, &pose, level);
                (pose, parameters) = self.shape.explain(moved.view());
                if stayed >= STAY {
                    break;
                }
            }
        }
        let points = self.shape.points(&pose, parameters.view());
        let unlike = self.unlike(look, points.view(), &pose);
        Fit { points, unlike }
    }

    /// Each point where the picture is most like its profile, and what share of them stayed.
    fn moved(&self, look: &Look, points: Array1<f32>, pose: &Pose, level: usize) -> (Array1<f32>, f32) {
        let mut moved = points.clone();
        let mut stayed = 0;
        let spacing = spacing(pose, level);
        for (point, profile) in self.profiles[level].iter().enumerate() {
            let line = line(&self.shape, look, points.view(), point, pose, level);
            let distances = profile.distances(&line, SEARCH);
            // Of equals the nearest.
            let best = (0..distances.len())
                .min_by(|a, b| {
                    (distances[*a].total_cmp(&distances[*b]))
                        .then(a.abs_diff(SEARCH).cmp(&b.abs_diff(SEARCH)))
                })
                .unwrap_or(SEARCH);
            let normal = self.shape.normal(points.view(), point);
            for axis in 0..2 {
                moved[2 * point + axis] += normal[axis] * spacing * (best as f32 - SEARCH as f32);
            }
            stayed += usize::from(best.abs_diff(SEARCH) <= SEARCH / 2);
        }
        (moved, stayed as f32 / self.shape.count() as f32)
    }

    fn unlike(&self, look: &Look, points: ArrayView1<f32>, pose: &Pose) -> f32 {
        let distances = self.profiles[0].iter().enumerate().map(|(point, profile)| {
            let line = line(&self.shape, look, points, point, pose, 0);
            profile.distances(&line, 0)[0].sqrt()
        });
        distances.sum::<f32>() / self.shape.count() as f32
    }
}

/// Steps along a normal, in pixels.
fn spacing(pose: &Pose, level: usize) -> f32 {
    pose.scale() * (1u32 << level) as f32
}

/// The line through a point, across its contour.
fn line<'a>(
    shape: &ShapeModel,
    look: &'a Look,
    points: ArrayView1<f32>,
    point: usize,
    pose: &Pose,
    level: usize,
) -> Line<'a> {
    let at = [points[2 * point], points[2 * point + 1]];
    Line::new(
        &look.pyramid,
        at,
        shape.normal(points, point),
        spacing(pose, level),
    )
}

fn mean(places: &[Place]) -> Option<Place> {
    let count = places.len() as f32;
    let over = |of: &dyn Fn(&Place) -> f32| places.iter().map(of).sum::<f32>() / count;
    (!places.is_empty()).then(|| Place {
        a: over(&|p| p.a),
        b: over(&|p| p.b),
        at: [over(&|p| p.at[0]), over(&|p| p.at[1])],
    })
}

/// How far found points are from the true ones, each in shares of the face's width.
pub fn errors(found: ArrayView1<f32>, truth: ArrayView1<f32>) -> Vec<f32> {
    let width = width(truth);
    (0..truth.len() / 2)
        .map(|k| (found[2 * k] - truth[2 * k]).hypot(found[2 * k + 1] - truth[2 * k + 1]) / width)
        .collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A light disc on a dark ground with a dark mouth that is open by `gap`, both moved by `at`: 16 points around the disc, 12 around the mouth, and clips of one picture of it.
    pub(in super::super) fn drawn(gap: f32, at: [f32; 2]) -> (Frames, Array1<f32>) {
        let (width, height) = (160, 144);
        let inside = |x: f32, y: f32, wide: f32, high: f32| {
            let far = (x / wide).hypot(y / high);
            ((1.0 - far) * wide.min(high) + 0.5).clamp(0.0, 1.0)
        };
        let middle = [78.0 + at[0], 70.0 + at[1]];
        let lips = [middle[0], middle[1] + 18.0];
        let mut rgb = Vec::with_capacity(width * height * 3);
        for y in 0..height {
            for x in 0..width {
                let (x, y) = (x as f32, y as f32);
                let face = inside(x - middle[0], y - middle[1], 50.0, 56.0);
                let mouth = inside(x - lips[0], y - lips[1], 18.0, gap);
                let level =
                    (40.0 + 150.0 * face) * (1.0 - mouth) + 30.0 * mouth + 3.0 * (0.7 * x + 0.3 * y).sin();
                rgb.extend([level as u8; 3]);
            }
        }
        let around = |count: usize, centre: [f32; 2], wide: f32, high: f32| {
            (0..count).flat_map(move |k| {
                let (sin, cos) = (std::f32::consts::TAU * k as f32 / count as f32).sin_cos();
                [centre[0] + wide * cos, centre[1] + high * sin]
            })
        };
        let points = around(16, middle, 50.0, 56.0).chain(around(12, lips, 18.0, gap));
        let frames = Frames {
            width,
            height,
            rate_hz: 25.0,
            rgb,
        };
        (frames, points.collect())
    }

    fn example(gap: f32, at: [f32; 2]) -> Example {
        let (frames, points) = drawn(gap, at);
        Example {
            look: Look::without_face(&frames, 0),
            points,
        }
    }

    fn mean_error(fit: &Fit, truth: &Array1<f32>) -> f32 {
        let errors = errors(fit.points.view(), truth.view());
        errors.iter().sum::<f32>() / errors.len() as f32
    }

    #[test]
    fn faces_that_it_has_not_seen_are_found_from_afar_and_from_the_picture_before() {
        let examples: Vec<Example> = (0..8)
            .map(|n| example(4.0 + 1.5 * n as f32, [(n % 3) as f32, (n % 2) as f32]))
            .collect();
        let model = ActiveShape::learn(&examples.iter().collect::<Vec<_>>(), &[]).unwrap();
        for (gap, at) in [(6.3, [8.0, -5.0]), (10.0, [-7.0, 6.0]), (14.0, [3.0, 9.0])] {
            let (frames, truth) = drawn(gap, at);
            let look = Look::without_face(&frames, 0);
            let fit = model.find(&look, None).unwrap();
            let error = mean_error(&fit, &truth);
            assert!(error < 0.01, "{error} of the width, gap {gap} at {at:?}");
            // What looks like the labelled pictures is told from a place without a face.
            let (_, before) = drawn(gap + 2.0, [at[0] + 2.0, at[1] - 2.0]);
            let near = model.find(&look, Some(before.view())).unwrap();
            assert!(mean_error(&near, &truth) < 0.01);
            let (empty, _) = drawn(gap, [4000.0, 0.0]);
            let lost = model
                .find(&Look::without_face(&empty, 0), Some(truth.view()))
                .unwrap();
            assert!(lost.unlike > 1.5 * fit.unlike, "{} {}", lost.unlike, fit.unlike);
        }
    }

    #[test]
    fn one_labelled_picture_is_enough_to_begin_with() {
        let only = example(8.0, [0.0, 0.0]);
        let model = ActiveShape::learn(&[&only], &[0, 16]).unwrap();
        let (frames, truth) = drawn(8.0, [3.0, -2.0]);
        let fit = model.find(&Look::without_face(&frames, 0), None).unwrap();
        assert!(mean_error(&fit, &truth) < 0.01);
    }

    #[test]
    fn pictures_that_do_not_fit_each_other_are_refused() {
        assert!(ActiveShape::learn(&[], &[]).is_err());
        let (a, mut b) = (example(8.0, [0.0, 0.0]), example(8.0, [0.0, 0.0]));
        b.points = b.points.slice(ndarray::s![..20]).to_owned();
        assert!(ActiveShape::learn(&[&a, &b], &[]).is_err());
    }
}
