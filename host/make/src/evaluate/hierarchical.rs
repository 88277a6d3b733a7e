//! The second paper's system as a candidate: clusters chosen picture by picture, by Mahalanobis distance without an HMM, or by a model that hears more.
use super::candidate::{Candidate, Heard, Prediction};
use crate::error::{Error, Result};
use crate::features::FeatureFolder;
use lipstream::kinds::hierarchical::{Choice, Hearing, HierarchicalModel, at_frames, speech};

/// Future that a picture's numbers know, in ms between frame centres: smoothing takes in the next picture, and between the middles of two pictures the later one is known.
const LOOK_AHEAD_MS: u32 = 80;
/// The same in ms between the centre of a frame and of the one that begins the last picture that it takes in.
const TO_BEGINNING_MS: u32 = 70;
/// From the middle of a picture to its end.
const HALF_PICTURE_MS: u32 = 500 / speech::PICTURES_HZ;

/// A model, measured by the eigenmouth weights that are read from its appearances.
///
/// # Errors
///
/// That the model speaks of another mouth than the folder's, or was not trained for the choice.
pub fn candidate<'a>(
    name: &str,
    model: &'a HierarchicalModel,
    choice: Choice,
    folder: &FeatureFolder,
) -> Result<Candidate<'a>> {
    super::models::speaks_as_many(folder, model.mouth.size())?;
    let guide = model.guide_of(choice).map_err(Error::other)?;
    let own = match &model.hearing {
        Hearing::Window => LOOK_AHEAD_MS,
        Hearing::Frames { taps, .. } => {
            TO_BEGINNING_MS + 10 * taps.last().map_or(0, |tap| tap.max(&0).unsigned_abs().into())
        }
    };
    let more = guide.map_or(0, |guide| HALF_PICTURE_MS + guide.look_ahead_ms(choice));
    Ok(Candidate::new(name, Some(own + more), move |heard: &Heard| {
        let said = model.convert(&heard.samples, choice).map_err(Error::other)?;
        let said = model.eigenmouths(&said);
        Ok(Prediction {
            parameters: at_frames(&said, speech::PICTURES_HZ as f32, heard.observations.nrows()),
            visemes: None,
        })
    }))
}
