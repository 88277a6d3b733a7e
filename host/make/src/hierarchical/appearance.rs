//! The appearance model of each area (COS section 4.1, eq. 1 to 3): mean shape and triangles first, then, when the pictures have been seen through them, the components.
//!
//! Every texture is brought to the whole face's mean and deviation in its picture, so that light is no appearance; an area's textures then have the mean
//! and deviation of all its training pictures taken off. A mouth that opens may so be darker than one that is closed.
use delaunator::{Point, triangulate};
use lipstream::kinds::hierarchical::mesh::{Patch, Triangles, points};
use lipstream::kinds::hierarchical::{Appearance, Area, Tree, appearance};
use ndarray::{Array1, Array2, ArrayView1, Axis, concatenate};

use super::principal::{Keep, components};
use super::procrustes::{Aligned, align, laid};
use crate::error::{Error, Result, ensure};

/// Where the grid of a mean shape begins left of it and above, pixels.
const BORDER: f32 = 1.0;

/// How many components the parts of an appearance model keep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Components {
    /// Of shapes.
    pub shape: Keep,
    /// Of textures.
    pub texture: Keep,
    /// Of both together.
    pub joint: Keep,
}

impl Default for Components {
    /// 98 % of the shapes' variance is usual for appearance models; of a compressed video's textures much is noise, and more components than these are seen in no picture.
    fn default() -> Self {
        Self {
            shape: Keep {
                share: 0.98,
                most: 40,
            },
            texture: Keep {
                share: 0.95,
                most: 60,
            },
            joint: Keep {
                share: 0.98,
                most: 40,
            },
        }
    }
}

/// What pictures are seen through: an area's mean shape and its pixels.
#[derive(Clone, Debug)]
pub struct Geometry {
    /// The area's landmarks among all.
    landmarks: Vec<usize>,
    /// Mean shape around the origin, and how far its grid's origin is from there.
    centred: Array1<f32>,
    offset: [f32; 2],
    /// Between the area's landmarks.
    triangles: Triangles,
    /// The pixels of a texture.
    pub patch: Patch,
}

/// The geometries of a tree's areas and all shapes in each area's mean frame, from landmarks `[n, 2 × landmarks]` of pictures.
///
/// # Errors
///
/// No picture, landmarks on one line, or a face of no size.
pub fn geometries(shapes: &Array2<f32>, tree: &Tree) -> Result<Vec<(Geometry, Array2<f32>)>> {
    let mut out: Vec<(Geometry, Array2<f32>)> = Vec::new();
    for area in &tree.areas {
        let own = of_area(shapes, area);
        let parent = area.parent.as_ref().and_then(|name| {
            let at = tree.areas.iter().position(|area| area.name == *name)?;
            out.get(at)
        });
        // A part stands in its parent's mean as it will be seen in it; the root as it stands in the pictures on average.
        let reference = match parent {
            Some((parent, _)) => {
                let places = area
                    .landmarks
                    .iter()
                    .filter_map(|k| parent.landmarks.iter().position(|p| p == k));
                places
                    .flat_map(|k| [parent.centred[2 * k], parent.centred[2 * k + 1]])
                    .collect()
            }
            None => average(&own)?,
        };
        let aligned = align(&own, reference.view())?;
        out.push(Geometry::new(area, aligned)?);
    }
    Ok(out)
}

/// An area's landmarks of every picture.
fn of_area(shapes: &Array2<f32>, area: &Area) -> Array2<f32> {
    let columns: Vec<usize> = area.landmarks.iter().flat_map(|k| [2 * k, 2 * k + 1]).collect();
    shapes.select(Axis(1), &columns)
}

fn average(shapes: &Array2<f32>) -> Result<Array1<f32>> {
    shapes
        .mean_axis(Axis(0))
        .ok_or_else(|| Error::Data("there is no picture with landmarks to train on".to_owned()))
}

impl Geometry {
    fn new(area: &Area, aligned: Aligned) -> Result<(Self, Array2<f32>)> {
        let least = |axis: usize| {
            let values = aligned.mean.iter().skip(axis).step_by(2);
            values.copied().fold(f32::INFINITY, f32::min)
        };
        let offset = [BORDER - least(0), BORDER - least(1)];
        let mut geometry = Self {
            landmarks: area.landmarks.clone(),
            centred: aligned.mean,
            offset,
            triangles: Vec::new(),
            patch: Patch::new(&[], &[], (1, 1)),
        };
        let mean = geometry.mean();
        let corners: Vec<Point> = points(mean.view())
            .into_iter()
            .map(|[x, y]| Point {
                x: f64::from(x),
                y: f64::from(y),
            })
            .collect();
        geometry.triangles = triangulate(&corners)
            .triangles
            .chunks_exact(3)
            .map(|t| [t[0], t[1], t[2]])
            .collect();
        geometry.patch = appearance::patch(mean.view(), &geometry.triangles)
            .map_err(|error| Error::Data(format!("area {}: {error}", area.name)))?;
        let mut shapes = aligned.shapes;
        for mut shape in shapes.outer_iter_mut() {
            let moved = geometry.in_grid(shape.view());
            shape.assign(&moved);
        }
        Ok((geometry, shapes))
    }

    /// The geometry that an area's model was trained with.
    pub fn of(area: &Area, model: &Appearance) -> Self {
        let mean = &model.shape.mean;
        let count = (mean.len() / 2).max(1) as f32;
        let offset = [0, 1].map(|axis| mean.iter().skip(axis).step_by(2).sum::<f32>() / count);
        let mut centred = mean.clone();
        centred
            .iter_mut()
            .enumerate()
            .for_each(|(k, v)| *v -= offset[k % 2]);
        Self {
            landmarks: area.landmarks.clone(),
            centred,
            offset,
            triangles: model.triangles.clone(),
            patch: model.patch.clone(),
        }
    }

    /// The mean shape on its grid.
    pub fn mean(&self) -> Array1<f32> {
        self.in_grid(self.centred.view())
    }

    fn in_grid(&self, centred: ArrayView1<f32>) -> Array1<f32> {
        let mut shape = centred.to_owned();
        shape
            .iter_mut()
            .enumerate()
            .for_each(|(k, v)| *v += self.offset[k % 2]);
        shape
    }

    /// The area's landmarks among all landmarks x₀, y₀, x₁, … of a picture.
    pub fn of_picture(&self, landmarks: ArrayView1<f32>) -> Array1<f32> {
        self.landmarks
            .iter()
            .flat_map(|k| [landmarks[2 * k], landmarks[2 * k + 1]])
            .collect()
    }

    /// The shape x of the area in a picture: laid onto the mean, on its grid.
    pub fn shape(&self, landmarks: ArrayView1<f32>) -> Array1<f32> {
        self.in_grid(laid(self.of_picture(landmarks).view(), self.centred.view()).view())
    }

    /// [`Geometry::shape`] of each row of landmarks.
    pub fn shapes(&self, landmarks: &Array2<f32>) -> Array2<f32> {
        let mut out = Array2::zeros((landmarks.nrows(), self.centred.len()));
        for (picture, mut shape) in landmarks.outer_iter().zip(out.outer_iter_mut()) {
            shape.assign(&self.shape(picture));
        }
        out
    }

    /// The pixels of the mean shape at half its size, in which colour is kept.
    ///
    /// # Errors
    ///
    /// As [`appearance::patch`].
    pub fn half(&self) -> Result<Patch> {
        appearance::patch((&self.mean() * 0.5).view(), &self.triangles).map_err(Error::other)
    }
}

/// Mean and standard deviation of a picture's luminances; a deviation of no picture is 0.
pub fn level(luminances: ArrayView1<f32>) -> (f32, f32) {
    let mean = luminances.mean().unwrap_or(0.0);
    (mean, luminances.std(0.0).max(1e-3))
}

/// Brings the textures of all areas, as luminances `[n, pixels]` with the root's first, to common levels; the levels that each area's [`Appearance::level`] says.
pub fn normalise(textures: &mut [Array2<f32>], tree: &Tree) -> Vec<(f32, f32)> {
    let Some(root) = textures.first() else {
        return Vec::new();
    };
    let of_pictures: Vec<(f32, f32)> = root.outer_iter().map(level).collect();
    let count = of_pictures.len().max(1) as f32;
    let sum = of_pictures
        .iter()
        .fold((0.0, 0.0), |sum, l| (sum.0 + l.0, sum.1 + l.1));
    let mut levels = vec![(sum.0 / count, sum.1 / count)];
    // Mean and deviation of each area in the units of the root.
    let mut own = vec![(0.0, 1.0)];
    for (index, texture) in textures.iter_mut().enumerate() {
        for (mut row, (mean, deviation)) in texture.outer_iter_mut().zip(&of_pictures) {
            row.mapv_inplace(|v| (v - mean) / deviation);
        }
        if index == 0 {
            continue;
        }
        let (mean, deviation) = level(texture.flatten().view());
        texture.mapv_inplace(|v| (v - mean) / deviation);
        let parent = tree.areas[index].parent.as_ref();
        let parent = parent.and_then(|name| tree.areas.iter().position(|area| area.name == *name));
        let (of_parent, contrast) = own[parent.unwrap_or(0)];
        levels.push(((mean - of_parent) / contrast, deviation / contrast));
        own.push((mean, deviation));
    }
    levels
}

/// A new picture's textures, as [`normalise`] brought those of training to their levels.
pub fn normalise_as(textures: &mut [Array2<f32>], tree: &Tree, levels: &[(f32, f32)]) {
    let Some(root) = textures.first() else {
        return;
    };
    let of_pictures: Vec<(f32, f32)> = root.outer_iter().map(level).collect();
    let mut own = vec![(0.0, 1.0)];
    for (index, texture) in textures.iter_mut().enumerate() {
        let (of_area, contrast) = if index == 0 {
            own[0]
        } else {
            let parent = tree.areas[index].parent.as_ref();
            let parent = parent.and_then(|name| tree.areas.iter().position(|area| area.name == *name));
            let (mean, deviation) = own[parent.unwrap_or(0)];
            let absolute = (mean + deviation * levels[index].0, deviation * levels[index].1);
            own.push(absolute);
            absolute
        };
        for (mut row, (mean, deviation)) in texture.outer_iter_mut().zip(&of_pictures) {
            row.mapv_inplace(|v| ((v - mean) / deviation - of_area) / contrast);
        }
    }
}

/// An area's appearance model, and the appearance c of every training picture `[n, C]`.
///
/// # Errors
///
/// Shapes or textures that are all alike: there is nothing to model.
pub fn fit(
    name: &str,
    geometry: &Geometry,
    shapes: &Array2<f32>,
    textures: &Array2<f32>,
    level: (f32, f32),
    keep: &Components,
) -> Result<(Appearance, Array2<f32>)> {
    let mut shape = components(shapes, keep.shape)?;
    // The mean of the aligned shapes, in which the pixels were laid out; it differs by less than the alignment's tolerance.
    shape.mean = geometry.mean();
    let texture = components(textures, keep.texture)?;
    ensure!(
        shape.modes() > 0 && texture.modes() > 0,
        Data,
        "area {name}: the {} of its {} training pictures are all alike, so that there is nothing to learn from them",
        if shape.modes() == 0 { "landmarks" } else { "levels" },
        shapes.nrows()
    );
    let weight = (texture.variances.sum() / shape.variances.sum()).sqrt();
    let of_shape = (shapes - &shape.mean).dot(&shape.components.t()) * weight;
    let of_texture = (textures - &texture.mean).dot(&texture.components.t());
    let both = concatenate![Axis(1), of_shape, of_texture];
    let mut joint = components(&both, keep.joint)?;
    // b has no mean but what rounding leaves.
    joint.mean.fill(0.0);
    let c = both.dot(&joint.components.t());
    let appearance = Appearance {
        shape,
        texture,
        weight,
        joint,
        triangles: geometry.triangles.clone(),
        level,
        patch: geometry.patch.clone(),
    };
    Ok((appearance, c))
}

/// Appearances c `[n, C]` of shapes and textures that took no part in training (eq. 3).
pub fn project(appearance: &Appearance, shapes: &Array2<f32>, textures: &Array2<f32>) -> Array2<f32> {
    let mut out = Array2::zeros((shapes.nrows(), appearance.size()));
    for ((shape, texture), mut row) in shapes
        .outer_iter()
        .zip(textures.outer_iter())
        .zip(out.outer_iter_mut())
    {
        row.assign(&appearance.project(shape, texture));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    const ALL: Components = Components {
        shape: Keep { share: 1.0, most: 99 },
        texture: Keep { share: 1.0, most: 99 },
        joint: Keep { share: 1.0, most: 99 },
    };

    /// A square with a point in it that moves, the square itself moved and turned in every picture.
    fn landmarks(n: usize) -> Array2<f32> {
        let base = [
            [0.0, 0.0],
            [30.0, 0.0],
            [30.0, 24.0],
            [0.0, 24.0],
            [12.0, 10.0],
            [18.0, 16.0],
        ];
        let mut out = Array2::zeros((n, 12));
        for (t, mut row) in out.outer_iter_mut().enumerate() {
            let (sin, cos) = (0.05 * (t as f32).sin()).sin_cos();
            for (k, [x, y]) in base.into_iter().enumerate() {
                let y = if k == 5 {
                    y + 3.0 * (1.3 * t as f32).sin()
                } else {
                    y
                };
                row[2 * k] = cos * x - sin * y + 40.0 + t as f32;
                row[2 * k + 1] = sin * x + cos * y + 30.0 - t as f32;
            }
        }
        out
    }

    fn tree() -> Tree {
        Tree::face_and_mouth([2, 3, 4, 5]).over(6).unwrap()
    }

    #[test]
    fn shapes_lie_on_their_grid_and_a_new_one_beside_them() {
        let landmarks = landmarks(12);
        let found = geometries(&landmarks, &tree()).unwrap();
        for (geometry, shapes) in &found {
            let mean = geometry.mean();
            let least = |axis: usize| {
                mean.iter()
                    .skip(axis)
                    .step_by(2)
                    .copied()
                    .fold(f32::INFINITY, f32::min)
            };
            assert!((least(0) - 1.0).abs() < 1e-5 && (least(1) - 1.0).abs() < 1e-5);
            for (picture, shape) in landmarks.outer_iter().zip(shapes.outer_iter()) {
                let alone = geometry.shape(picture);
                assert!((&alone - &shape).iter().all(|d| d.abs() < 1e-2));
            }
            assert!(geometry.half().unwrap().len() * 3 < geometry.patch.len());
        }
        // The triangles cover the square, 30 × 24, with its borders or without.
        assert!(
            (30 * 23..=31 * 25).contains(&found[0].0.patch.len()),
            "{}",
            found[0].0.patch.len()
        );
        assert!(geometries(&Array2::zeros((0, 12)), &tree()).is_err());
        let line = Array2::from_shape_fn((4, 12), |(_, k)| (k / 2) as f32);
        let refused = geometries(&line, &tree()).unwrap_err().to_string();
        assert!(refused.starts_with("area face: "), "{refused}");
    }

    /// With all components kept, eq. 1 to 3 there and back give every training picture.
    #[test]
    fn training_pictures_come_back() {
        let landmarks = landmarks(12);
        let found = geometries(&landmarks, &tree()).unwrap();
        let (geometry, shapes) = &found[1];
        let textures = Array2::from_shape_fn((12, geometry.patch.len()), |(t, p)| {
            (1.3 * t as f32).sin() * (p as f32 * 0.2).cos() + (0.7 * t as f32).cos() * (p as f32 * 0.05).sin()
        });
        let (appearance, c) = fit("mouth", geometry, shapes, &textures, (0.0, 1.0), &ALL).unwrap();
        for t in 0..12 {
            let x = appearance.shape_of(c.row(t));
            let g = appearance.texture_of(c.row(t));
            assert!((&x - &shapes.row(t)).iter().all(|d| d.abs() < 0.02));
            assert!((&g - &textures.row(t)).iter().all(|d| d.abs() < 1e-3));
        }
        // W_s makes both vary alike (Cootes): weighted shape parameters have the textures' variance.
        let weighted = appearance.shape.variances.sum() * appearance.weight.powi(2);
        assert!((weighted / appearance.texture.variances.sum() - 1.0).abs() < 1e-3);
        // What a trained model says of its geometry is what it was trained with.
        let same = Geometry::of(&tree().areas[1], &appearance);
        let again = project(&appearance, &same.shapes(&landmarks), &textures);
        assert!((&again - &c).iter().all(|d| d.abs() < 1e-3));
        let still = Array2::from_elem(textures.dim(), 3.0);
        let refused = fit("mouth", geometry, shapes, &still, (0.0, 1.0), &ALL)
            .unwrap_err()
            .to_string();
        assert!(
            refused.starts_with("area mouth: the levels of its 12"),
            "{refused}"
        );
    }

    #[test]
    fn light_is_taken_off_and_the_mouths_own_darkness_stays() {
        // The second picture is the first in other light; in the third the mouth is darker.
        let face = [
            array![10.0, 20.0, 30.0, 40.0],
            array![30.0, 50.0, 70.0, 90.0],
            array![10.0, 20.0, 30.0, 40.0],
        ];
        let mouth = [array![20.0, 30.0], array![50.0, 70.0], array![10.0, 15.0]];
        let stacked = |rows: &[Array1<f32>]| {
            ndarray::stack(Axis(0), &rows.iter().map(|r| r.view()).collect::<Vec<_>>()).unwrap()
        };
        let raw = vec![stacked(&face), stacked(&mouth)];
        let mut textures = raw.clone();
        let levels = normalise(&mut textures, &tree());
        assert!(
            (&textures[0].row(0) - &textures[0].row(1))
                .iter()
                .all(|d| d.abs() < 1e-5)
        );
        assert!(
            (&textures[1].row(0) - &textures[1].row(1))
                .iter()
                .all(|d| d.abs() < 1e-5)
        );
        assert!(textures[1].row(2).sum() < textures[1].row(0).sum() - 1.0);
        // Back through the levels: the mouth's place in the face, the face in levels of the first picture.
        let (mean, deviation) = level(face[0].view());
        for (g, raw) in textures[1].row(0).iter().zip(&mouth[0]) {
            let in_face = levels[1].0 + levels[1].1 * g;
            assert!((mean + deviation * in_face - raw).abs() < 1e-3);
        }
        let mut again = raw.clone();
        normalise_as(&mut again, &tree(), &levels);
        assert!(
            again
                .iter()
                .zip(&textures)
                .all(|(a, b)| (a - b).iter().all(|d| d.abs() < 1e-4))
        );
    }
}
