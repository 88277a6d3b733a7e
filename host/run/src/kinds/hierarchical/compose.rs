//! Parts of a face into a face (section 5).
//!
//! Shape: what a child's landmarks are off its own mean is added to the mean places that these landmarks have in its parent, from the leaves upwards; where a child
//! says something, the parent's own word is dropped.
//!
//! Texture: the child's texture is laid over the parent's where the child lies in the parent's mean shape; the rough result goes through the parent's principal components and
//! back ("parent approximation"), which leaves a texture such as the parent has seen, with what the child shows and without a seam.
use ndarray::{Array1, ArrayView1};

use super::Node;
use super::mesh::{Patch, points};

/// A child's place in its parent's texture.
#[derive(Clone, Debug)]
pub(super) struct Inlay {
    /// For each pixel: its index in the parent's texture, and where it lies in the child's own mean frame.
    pixels: Vec<(usize, [f32; 2])>,
}

impl Inlay {
    /// The pixels of `parent` inside the child's triangles; `places` are the child's landmarks as the parent counts its own.
    pub(super) fn new(parent: &Node, child: &Node, places: &[usize]) -> Self {
        let (of_parent, of_child) = (&parent.appearance, &child.appearance);
        let mean = points(of_parent.shape.mean.view());
        let shape: Vec<[f32; 2]> = places.iter().map(|k| mean[*k]).collect();
        let grid = (of_parent.patch.width, of_parent.patch.height);
        let within = Patch::new(&shape, &of_child.triangles, grid);
        let mut index = vec![None; grid.0 * grid.1];
        for (at, (x, y)) in of_parent.patch.places().enumerate() {
            index[y * grid.0 + x] = Some(at);
        }
        let own = points(of_child.shape.mean.view());
        let pixels = within
            .places()
            .zip(within.in_shape(&own))
            .filter_map(|((x, y), place)| Some((index[y * grid.0 + x]?, place)))
            .collect();
        Self { pixels }
    }
}

/// Shape and texture of one node, the texture in the node's own normalised units.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// x `[2 × landmarks]`, in the node's mean frame.
    pub shape: Array1<f32>,
    /// g, one level for each pixel of the node's patch.
    pub texture: Array1<f32>,
}

/// What a child adds to its parent.
pub(super) fn add(
    parent: &mut Part,
    of_parent: &Node,
    child: &Part,
    of_child: &Node,
    inlay: &Inlay,
    places: &[usize],
) {
    let off = &child.shape - &of_child.appearance.shape.mean;
    for (k, place) in places.iter().enumerate() {
        for axis in 0..2 {
            parent.shape[2 * place + axis] =
                of_parent.appearance.shape.mean[2 * place + axis] + off[2 * k + axis];
        }
    }
    let (mean, contrast) = of_child.appearance.level;
    for (at, place) in &inlay.pixels {
        parent.texture[*at] =
            mean + contrast * of_child.appearance.patch.sample(child.texture.view(), *place);
    }
    let texture = &of_parent.appearance.texture;
    let parameters = texture.project(parent.texture.view());
    parent.texture = texture.expand(parameters.view());
}

/// The part that an appearance c of a node stands for.
pub(super) fn part(node: &Node, c: ArrayView1<f32>) -> Part {
    Part {
        shape: node.appearance.shape_of(c),
        texture: node.appearance.texture_of(c),
    }
}
