//! What recorded pictures are in a trained model's own numbers: to hold what it says against, parameter by parameter (COS figures 9 and 10).
use lipstream::kinds::hierarchical::HierarchicalModel;
use lipstream::progress::Progress;
use ndarray::{Array2, Axis, concatenate};

use super::appearance::{Geometry, normalise_as, project};
use super::pictures::{self, Picked};
use crate::error::Result;

/// Appearances c of all areas of recorded pictures, `[n, C of all areas]`, as the model gives them for speech.
///
/// # Errors
///
/// A video that cannot be decoded.
pub fn appearances(
    model: &HierarchicalModel,
    picked: &[Picked],
    progress: &dyn Progress,
) -> Result<Array2<f32>> {
    let areas = &model.tree.areas;
    let geometries: Vec<Geometry> = std::iter::zip(areas, &model.nodes)
        .map(|(area, node)| Geometry::of(area, &node.appearance))
        .collect();
    let levels: Vec<(f32, f32)> = model.nodes.iter().map(|node| node.appearance.level).collect();
    let mut textures = pictures::look(picked, &geometries, 0, progress)?.textures;
    normalise_as(&mut textures, &model.tree, &levels);
    let landmarks = pictures::stacked(picked, |clip| &clip.landmarks)?;
    let parts: Vec<Array2<f32>> = std::iter::zip(&geometries, &model.nodes)
        .zip(&textures)
        .map(|((geometry, node), textures)| project(&node.appearance, &geometry.shapes(&landmarks), textures))
        .collect();
    let views: Vec<_> = parts.iter().map(|part| part.view()).collect();
    Ok(concatenate(Axis(1), &views)?)
}
