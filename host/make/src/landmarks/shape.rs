//! The point distribution model: which shapes there are, where they lie in a picture, and which points follow each other along a contour.
//!
//! Shapes are brought to one size, place and turn (Procrustes), and their principal components found: x ≈ x̄ + P·b, |b_i| ≤ 3·√λ_i. A shape's unit is 1 % of the mean face's
//! width, so that what is learnt from one picture size holds in any other.
use ndarray::{Array1, Array2, ArrayView1};

use crate::error::{Result, ensure};
use crate::hierarchical::principal::{Keep, components};
use crate::hierarchical::procrustes;
use lipstream::kinds::hierarchical::Linear;

/// Width of the mean shape, in its own units.
pub const WIDTH: f32 = 100.0;
/// A parameter's farthest, in standard deviations.
const LIMIT: f32 = 3.0;
/// Rounds of pose and parameters, each given the other; they settle within a few.
const ROUNDS: usize = 6;
/// A point is linked to the next in the list where the step is at most so many times the list's usual step.
const LONG_STEP: f32 = 3.0;

/// Where a shape lies in a picture: turned and sized by (a, b), then moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Size times the cosine of the turn: pixels a unit.
    pub a: f32,
    /// Size times the sine of the turn.
    pub b: f32,
    /// Place of the shape's origin, in pixels.
    pub at: [f32; 2],
}

impl Pose {
    /// Pixels a unit.
    pub fn scale(&self) -> f32 {
        self.a.hypot(self.b)
    }

    /// Points of the picture.
    pub fn put(&self, shape: ArrayView1<f32>) -> Array1<f32> {
        self.each(shape, |x, y| {
            [
                self.a * x - self.b * y + self.at[0],
                self.b * x + self.a * y + self.at[1],
            ]
        })
    }

    /// The shape that lies at points of the picture.
    pub fn back(&self, points: ArrayView1<f32>) -> Array1<f32> {
        let square = self.a * self.a + self.b * self.b;
        self.each(points, |x, y| {
            let (x, y) = (x - self.at[0], y - self.at[1]);
            [
                (self.a * x + self.b * y) / square,
                (self.a * y - self.b * x) / square,
            ]
        })
    }

    fn each(&self, points: ArrayView1<f32>, map: impl Fn(f32, f32) -> [f32; 2]) -> Array1<f32> {
        (0..points.len() / 2)
            .flat_map(|k| map(points[2 * k], points[2 * k + 1]))
            .collect()
    }

    /// The pose in which `shape` lies nearest to `points`, by least squares. A shape without extent is only moved.
    pub fn between(shape: ArrayView1<f32>, points: ArrayView1<f32>) -> Self {
        let (middle, onto) = (middle(shape), middle(points));
        let (mut along, mut across, mut square) = (0.0f64, 0.0f64, 0.0f64);
        for k in (0..shape.len()).step_by(2) {
            let (x, y) = (shape[k] - middle[0], shape[k + 1] - middle[1]);
            let (u, v) = (points[k] - onto[0], points[k + 1] - onto[1]);
            along += f64::from(x * u + y * v);
            across += f64::from(x * v - y * u);
            square += f64::from(x * x + y * y);
        }
        let (a, b) = match square > 0.0 {
            true => ((along / square) as f32, (across / square) as f32),
            false => (1.0, 0.0),
        };
        Self {
            a,
            b,
            at: [
                onto[0] - a * middle[0] + b * middle[1],
                onto[1] - b * middle[0] - a * middle[1],
            ],
        }
    }
}

/// The middle of points.
pub(super) fn middle(points: ArrayView1<f32>) -> [f32; 2] {
    let count = (points.len() / 2).max(1) as f32;
    [0, 1].map(|axis| points.iter().skip(axis).step_by(2).sum::<f32>() / count)
}

/// From the leftmost point to the rightmost: what errors are measured in.
pub fn width(points: ArrayView1<f32>) -> f32 {
    let xs = || points.iter().step_by(2).copied();
    xs().fold(f32::NEG_INFINITY, f32::max) - xs().fold(f32::INFINITY, f32::min)
}

/// Shapes, by their mean and how they vary.
#[derive(Clone, Debug)]
pub struct ShapeModel {
    /// Principal components of shapes x₀, y₀, x₁, … in units.
    pub linear: Linear,
    /// For each point the ones before and behind it on its contour.
    links: Vec<[usize; 2]>,
}

impl ShapeModel {
    /// Learns from labelled pictures' points, `[n, 2 × points]` in pixels. `starts` are points at which a run begins that has nothing to do with the point before; where they are not
    /// known, long steps in the mean shape separate runs.
    ///
    /// # Errors
    ///
    /// Shapes that have no extent, or fewer than three points.
    pub fn learn(points: &Array2<f32>, starts: &[usize], keep: Keep) -> Result<Self> {
        ensure!(
            points.nrows() > 0 && points.ncols() >= 6 && points.ncols().is_multiple_of(2),
            Data,
            "{} labelled pictures of {} points: one at least is needed, of three points at least",
            points.nrows(),
            points.ncols() / 2
        );
        let mut sized = points.clone();
        for mut shape in sized.outer_iter_mut() {
            let at = middle(shape.view());
            let spread = (0..shape.len())
                .map(|k| (shape[k] - at[k % 2]).powi(2))
                .sum::<f32>()
                .sqrt();
            ensure!(
                spread.is_finite() && spread > 0.0,
                Data,
                "in a labelled picture all points lie at one place"
            );
            shape /= spread;
        }
        let aligned = procrustes::align(&sized, sized.row(0))?;
        let unit = WIDTH / width(aligned.mean.view()).max(f32::MIN_POSITIVE);
        let linear = components(&(aligned.shapes * unit), keep)?;
        let links = links(linear.mean.view(), starts);
        Ok(Self { linear, links })
    }

    /// Number of points.
    pub fn count(&self) -> usize {
        self.links.len()
    }

    /// The nearest shape within the limits to points of a picture: its pose and its parameters.
    pub fn explain(&self, points: ArrayView1<f32>) -> (Pose, Array1<f32>) {
        let mut parameters = Array1::zeros(self.linear.modes());
        let mut pose = Pose::between(self.linear.mean.view(), points);
        for _ in 0..ROUNDS {
            parameters = self.linear.project(pose.back(points).view());
            self.linear.hold(&mut parameters, LIMIT);
            pose = Pose::between(self.linear.expand(parameters.view()).view(), points);
        }
        (pose, parameters)
    }

    /// The points of a shape in a picture.
    pub fn points(&self, pose: &Pose, parameters: ArrayView1<f32>) -> Array1<f32> {
        pose.put(self.linear.expand(parameters).view())
    }

    /// The direction across the contour at a point, of length 1.
    pub fn normal(&self, points: ArrayView1<f32>, point: usize) -> [f32; 2] {
        let [before, behind] = self.links[point];
        let (x, y) = (
            points[2 * behind] - points[2 * before],
            points[2 * behind + 1] - points[2 * before + 1],
        );
        let length = x.hypot(y);
        match length > 0.0 {
            true => [-y / length, x / length],
            false => [0.0, 1.0],
        }
    }
}

/// For each point its neighbours along its contour. Landmarks are listed contour by contour: two that follow each other are neighbours, unless the step between them is much longer
/// than the usual step or a run is known to begin there; the ends of a run are neighbours where the run comes back to its beginning. A point that is alone has the two points nearest to it.
fn links(mean: ArrayView1<f32>, starts: &[usize]) -> Vec<[usize; 2]> {
    let count = mean.len() / 2;
    let apart = |a: usize, b: usize| (mean[2 * a] - mean[2 * b]).hypot(mean[2 * a + 1] - mean[2 * b + 1]);
    let mut steps: Vec<f32> = (1..count).map(|k| apart(k - 1, k)).collect();
    steps.sort_by(f32::total_cmp);
    let long = LONG_STEP * steps[steps.len() / 2];
    let mut out = Vec::with_capacity(count);
    let mut begin = 0;
    while begin < count {
        let goes_on = |k: &usize| {
            *k < count && (!starts.contains(k)) && (!starts.is_empty() || apart(*k - 1, *k) <= long)
        };
        let end = (begin + 1..)
            .take_while(goes_on)
            .last()
            .map_or(begin + 1, |k| k + 1);
        let (last, longest) = (
            end - 1,
            (begin + 1..end).map(|k| apart(k - 1, k)).fold(0.0, f32::max),
        );
        let closed = end - begin > 3 && apart(begin, last) <= 2.0 * longest;
        for k in begin..end {
            out.push(match (end - begin, k) {
                (1, _) => two_nearest(count, |other| apart(k, other), k),
                (_, k) if k == begin && closed => [last, k + 1],
                (_, k) if k == last && closed => [k - 1, begin],
                (_, k) => [k.saturating_sub(1).max(begin), (k + 1).min(last)],
            });
        }
        begin = end;
    }
    out
}

fn two_nearest(count: usize, apart: impl Fn(usize) -> f32, point: usize) -> [usize; 2] {
    let mut others: Vec<usize> = (0..count).filter(|other| *other != point).collect();
    others.sort_by(|a, b| apart(*a).total_cmp(&apart(*b)));
    [others[0], others[1]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Axis, array, stack};

    const ALL: Keep = Keep {
        share: 1.0,
        most: usize::MAX,
    };

    #[test]
    fn a_pose_is_found_and_undone() {
        let shape = array![-50.0, -10.0, 50.0, -12.0, 3.0, 40.0, -7.0, 8.0];
        let pose = Pose {
            a: 0.8,
            b: -0.3,
            at: [120.0, 90.0],
        };
        let points = pose.put(shape.view());
        let found = Pose::between(shape.view(), points.view());
        assert!((found.a - pose.a).abs() < 1e-4 && (found.b - pose.b).abs() < 1e-4);
        assert!(
            (&found.back(points.view()) - &shape)
                .iter()
                .all(|d| d.abs() < 1e-3)
        );
        // Points without extent are only moved.
        let dot = Pose::between(
            array![2.0, 2.0, 2.0, 2.0].view(),
            array![5.0, 7.0, 5.0, 7.0].view(),
        );
        assert_eq!(dot.put(array![2.0, 2.0].view()), array![5.0, 7.0]);
    }

    #[test]
    fn shapes_of_any_size_place_and_turn_have_the_modes_they_were_made_of() {
        // A mouth that opens, seen from near and far.
        let open = |gap: f32| {
            array![
                -50.0, 0.0, 0.0, -gap, 50.0, 0.0, 0.0, gap, -40.0, -60.0, 40.0, -60.0
            ]
        };
        let shapes: Vec<Array1<f32>> = (0..12)
            .map(|n| {
                let turn = 0.1 * n as f32 - 0.5;
                let size = 0.5 + 0.2 * n as f32;
                let pose = Pose {
                    a: size * turn.cos(),
                    b: size * turn.sin(),
                    at: [10.0 * n as f32, 50.0],
                };
                pose.put(open(5.0 + n as f32).view())
            })
            .collect();
        let views: Vec<_> = shapes.iter().map(|s| s.view()).collect();
        let points = stack(Axis(0), &views).unwrap();
        let model = ShapeModel::learn(&points, &[], ALL).unwrap();
        assert!((width(model.linear.mean.view()) - WIDTH).abs() < 1e-2);
        // One motion, bent a little by the sizing.
        assert!(model.linear.variances[0] > 0.98 * model.linear.variances.sum());
        for shape in &shapes {
            let (pose, parameters) = model.explain(shape.view());
            let said = model.points(&pose, parameters.view());
            assert!((&said - shape).iter().all(|d| d.abs() < 0.2 * pose.scale()));
        }
        // A mouth wider open than any is held at the limit.
        let (_, parameters) = model.explain(open(60.0).view());
        let limit = LIMIT * model.linear.variances[0].sqrt();
        assert!((parameters[0].abs() - limit).abs() < 1e-3 * limit);
    }

    #[test]
    fn contours_are_found_in_the_list_of_points() {
        // A closed square of eight points, an open row of four, and one alone far away.
        let square = [
            [0.0, 0.0],
            [5.0, 0.0],
            [10.0, 0.0],
            [10.0, 5.0],
            [10.0, 10.0],
            [5.0, 10.0],
            [0.0, 10.0],
            [0.0, 5.0],
        ];
        let row = [[40.0, 0.0], [45.0, 0.0], [50.0, 0.0], [55.0, 0.0]];
        let mean: Array1<f32> = square
            .iter()
            .chain(&row)
            .chain(&[[100.0, 100.0]])
            .flatten()
            .copied()
            .collect();
        let found = links(mean.view(), &[]);
        assert_eq!(found[0], [7, 1]);
        assert_eq!(found[7], [6, 0]);
        assert_eq!((found[8], found[9], found[11]), ([8, 9], [8, 10], [10, 11]));
        assert_eq!(found[12], [11, 10]);
        // Where runs are named, their beginnings are what counts.
        let named = links(mean.view(), &[0, 4, 8, 12]);
        assert_eq!((named[3], named[4], named[8]), ([2, 3], [4, 5], [8, 9]));
    }

    #[test]
    fn what_has_no_extent_is_refused() {
        assert!(ShapeModel::learn(&Array2::zeros((0, 8)), &[], ALL).is_err());
        assert!(ShapeModel::learn(&Array2::zeros((1, 4)), &[], ALL).is_err());
        assert!(ShapeModel::learn(&Array2::from_elem((2, 8), 3.0), &[], ALL).is_err());
        let one = ShapeModel::learn(&array![[0.0, 0.0, 9.0, 0.0, 4.0, 6.0]], &[], ALL).unwrap();
        assert_eq!((one.count(), one.linear.modes()), (3, 0));
    }
}
