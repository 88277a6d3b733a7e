//! The second paper's system as a candidate: clusters chosen picture by picture, by Mahalanobis distance, without an HMM.
use super::candidate::{Candidate, Heard, Prediction};
use crate::error::Result;
use crate::features::FeatureFolder;
use lipstream::kinds::hierarchical::{HierarchicalModel, at_frames, speech};

/// Future that a picture's numbers know, in ms between frame centres: smoothing takes in the next picture, and between the middles of two pictures the later one is known.
const LOOK_AHEAD_MS: u32 = 80;

/// A model, measured by the eigenmouth weights that are read from its appearances.
///
/// # Errors
///
/// That the model speaks of another mouth than the folder's.
pub fn candidate<'a>(
    name: &str,
    model: &'a HierarchicalModel,
    folder: &FeatureFolder,
) -> Result<Candidate<'a>> {
    super::models::speaks_as_many(folder, model.mouth.size())?;
    Ok(Candidate::new(name, Some(LOOK_AHEAD_MS), move |heard: &Heard| {
        let said = model.eigenmouths(&model.convert(&heard.samples));
        Ok(Prediction {
            parameters: at_frames(&said, speech::PICTURES_HZ as f32, heard.observations.nrows()),
            visemes: None,
        })
    }))
}
