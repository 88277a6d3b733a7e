//! A whole face from the numbers of a hierarchical model (COS section 5): composed from its parts, coloured like the nearest training picture, and warped
//! from the mean shape to the shape that was said.
use ndarray::{ArrayView1, s};

use super::{MAX_SIDE, Scene};
use crate::error::{Result, bail};
use crate::kinds::hierarchical::mesh::{Patch, points};
use crate::kinds::hierarchical::{HierarchicalModel, half_patch, yiq};

/// What lies around the face.
const AROUND: u8 = 16;
/// Width of a picture where no scale is asked for, about.
const WIDTH: usize = 384;

/// Draws a model's faces, from the brow to the jaw.
pub struct HierarchicalScene<'a> {
    model: &'a HierarchicalModel,
    /// The pixels of the stored colours.
    half: Patch,
    /// Pixels of a picture for one of the mean shape.
    scale: f32,
    /// Width and height.
    size: (usize, usize),
}

impl<'a> HierarchicalScene<'a> {
    /// Pictures `scale` times the size of the mean face, about 384 pixels wide where none is given.
    ///
    /// # Errors
    ///
    /// A scale of 0, or one that makes pictures too large.
    pub fn new(model: &'a HierarchicalModel, scale: Option<usize>) -> Result<Self> {
        let patch = &model.nodes[0].appearance.patch;
        let scale = scale.unwrap_or((WIDTH / patch.width).max(1));
        let side = |native: usize| native.saturating_mul(scale).div_ceil(16).saturating_mul(16);
        let size = (side(patch.width), side(patch.height));
        if scale == 0 || size.0.max(size.1) > MAX_SIDE {
            bail!(
                Choice,
                "faces of {}×{}: choose another scale (1 at least, largest side {MAX_SIDE})",
                size.0,
                size.1
            );
        }
        Ok(Self {
            half: half_patch(&model.nodes[0].appearance)?,
            scale: scale as f32,
            model,
            size,
        })
    }
}

impl Scene for HierarchicalScene<'_> {
    fn size(&self) -> (usize, usize) {
        self.size
    }

    fn n_parameters(&self) -> usize {
        self.model.n_parameters()
    }

    fn draw(&mut self, parameters: ArrayView1<f32>) -> Result<Vec<u8>> {
        let root = &self.model.nodes[0].appearance;
        let part = self.model.compose(parameters);
        let chroma = self.model.colours.chroma.row(self.model.nearest(&part));
        let (i, q) = (
            chroma.slice(s![..self.half.len()]),
            chroma.slice(s![self.half.len()..]),
        );
        let shape = points((&part.shape * self.scale).view());
        let drawn = Patch::new(&shape, &root.triangles, self.size);
        let mean = points(root.shape.mean.view());
        let mut rgb = vec![AROUND; self.size.0 * self.size.1 * 3];
        for ((x, y), place) in drawn.places().zip(drawn.in_shape(&mean)) {
            let luminance = root.level.0 + root.level.1 * root.patch.sample(part.texture.view(), place);
            let coarse = place.map(|v| 0.5 * v);
            let levels = yiq::to_rgb([
                luminance,
                self.half.sample(i, coarse),
                self.half.sample(q, coarse),
            ]);
            let at = 3 * (y * self.size.0 + x);
            // Casts saturate: what is darker than black is black.
            rgb[at..at + 3].copy_from_slice(&levels.map(|level| level.round() as u8));
        }
        Ok(rgb)
    }
}
