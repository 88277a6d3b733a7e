//! The appearance model of one node (section 4.1, eq. 1 to 3).
//!
//! A shape x are the node's landmarks x₀, y₀, x₁, …, moved and turned onto the mean shape but not scaled; a texture g are the luminances inside the mean
//! shape. Each has principal components, b_s and b_g; those of b = [W_s·b_s; b_g] are c = Q·b. W_s is one number, what shape must be multiplied with to vary
//! as much as texture. Then x = x̄ + P_sᵀ·W_s⁻¹·Q_s·c (eq. 1) and g = ḡ + P_gᵀ·Q_g·c (eq. 2).
use ndarray::{Array1, ArrayView1, concatenate, s};

use super::linear::Linear;
use super::mesh::{Patch, Triangles, points};
use crate::error::{Result, bail};
use crate::tensors::{Tensors, TensorsBuilder};
use ndarray::{Array2, Axis};

/// Shape, texture and what they have in common.
#[derive(Clone, Debug)]
pub struct Appearance {
    /// Of x: landmarks in the node's own mean frame, in pixels.
    pub shape: Linear,
    /// Of g: luminances of the pixels of [`Appearance::patch`], normalised.
    pub texture: Linear,
    /// W_s.
    pub weight: f32,
    /// Of b, whose mean is 0.
    pub joint: Linear,
    /// Between the node's landmarks.
    pub triangles: Triangles,
    /// Mean and standard deviation that a texture has in its parent's units (of the root: in levels of 0..255), in the mean of the training pictures.
    pub level: (f32, f32),
    /// The pixels of a texture.
    pub patch: Patch,
}

/// Most pixels of a node's grid on a side.
const MAX_SIDE: f32 = 1024.0;

/// The pixels that a mean shape covers: the grid ends one pixel beyond it.
///
/// # Errors
///
/// A shape that covers no pixel, or more than any picture has.
pub fn patch(mean: ArrayView1<f32>, triangles: &[[usize; 3]]) -> Result<Patch> {
    let shape = points(mean);
    let most = |axis: usize| shape.iter().map(|p| p[axis]).fold(0.0, f32::max) + 2.0;
    let (width, height) = (most(0), most(1));
    if !(width <= MAX_SIDE && height <= MAX_SIDE) {
        bail!(
            Data,
            "a mean face of {width:.0}×{height:.0} pixels: the most is {MAX_SIDE}"
        );
    }
    let patch = Patch::new(&shape, triangles, (width as usize, height as usize));
    if patch.is_empty() {
        bail!(Data, "the triangles between the mean landmarks cover no pixel");
    }
    Ok(patch)
}

impl Appearance {
    /// Numbers of an appearance c.
    pub fn size(&self) -> usize {
        self.joint.modes()
    }

    /// c of a shape and a texture (eq. 3).
    pub fn project(&self, shape: ArrayView1<f32>, texture: ArrayView1<f32>) -> Array1<f32> {
        let of_shape = self.shape.project(shape) * self.weight;
        let both = concatenate![Axis(0), of_shape, self.texture.project(texture)];
        self.joint.project(both.view())
    }

    /// Shape x of an appearance (eq. 1).
    pub fn shape_of(&self, c: ArrayView1<f32>) -> Array1<f32> {
        let b = self.joint.expand(c);
        self.shape
            .expand((&b.slice(s![..self.shape.modes()]) / self.weight).view())
    }

    /// Texture g of an appearance (eq. 2).
    pub fn texture_of(&self, c: ArrayView1<f32>) -> Array1<f32> {
        let b = self.joint.expand(c);
        self.texture.expand(b.slice(s![self.shape.modes()..]))
    }

    pub(super) fn put(&self, out: &mut TensorsBuilder, name: &str) {
        self.shape.put(out, &format!("{name}.shape"));
        self.texture.put(out, &format!("{name}.texture"));
        self.joint.put(out, &format!("{name}.joint"));
        out.note(&format!("{name}.weight"), self.weight);
        out.note(&format!("{name}.level"), self.level.0);
        out.note(&format!("{name}.contrast"), self.level.1);
        let corners = self.triangles.iter().flatten().map(|k| *k as f32).collect();
        let corners = Array2::from_shape_vec((self.triangles.len(), 3), corners);
        out.put(
            &format!("{name}.triangles"),
            &corners.expect("three corners each"),
        );
    }

    pub(super) fn read(from: &Tensors, name: &str) -> Result<Self> {
        let shape = Linear::read(from, &format!("{name}.shape"))?;
        let texture = Linear::read(from, &format!("{name}.texture"))?;
        let joint = Linear::read(from, &format!("{name}.joint"))?;
        let corners: Array2<f32> = from.array(&format!("{name}.triangles"))?;
        let landmarks = shape.size() / 2;
        let known = |k: &f32| *k >= 0.0 && k.fract() == 0.0 && (*k as usize) < landmarks;
        if corners.ncols() != 3 || !corners.iter().all(known) {
            bail!(File, "{name}: a triangle has a corner that is no landmark");
        }
        let triangles: Triangles = corners
            .outer_iter()
            .map(|t| [0, 1, 2].map(|k| t[k] as usize))
            .collect();
        let patch = patch(shape.mean.view(), &triangles)?;
        let weight: f32 = from.noted(&format!("{name}.weight"))?;
        let level = (
            from.noted(&format!("{name}.level"))?,
            from.noted(&format!("{name}.contrast"))?,
        );
        if patch.len() != texture.size()
            || joint.size() != shape.modes() + texture.modes()
            || !(weight.is_finite() && weight > 0.0)
        {
            bail!(
                File,
                "{name}: shape, texture and joint parameters do not fit each other"
            );
        }
        Ok(Self {
            shape,
            texture,
            weight,
            joint,
            triangles,
            level,
            patch,
        })
    }
}
