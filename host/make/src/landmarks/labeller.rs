//! Which found points can be trusted: what a model says of labelled pictures that were kept from it.
//!
//! The labelled pictures are dealt into a few parts; each part is found by a model of the others. How unlike the labelled pictures these finds look is what a find is held against, and how far
//! they are off is what may be expected of pictures that nobody labels.
use ndarray::ArrayView1;

use super::search::{ActiveShape, Example, FaceFinder, Fit, Look, errors};
use crate::error::Result;
use lipstream_media::video::Frames;

/// Parts that the labelled pictures are dealt into.
const PARTS: usize = 5;
/// Below it a find is named as one to look at.
pub const UNSURE: f32 = 0.6;
/// Below it there is no face where one was looked for.
pub const LOST: f32 = 0.4;

/// A model, and what its finds are worth.
pub struct Labeller {
    model: ActiveShape,
    /// How unlike a good find looks.
    usual: f32,
    /// Median distance of a point of a picture that it has not seen, in shares of the face's width; None of a single picture.
    expected: Option<f32>,
}

impl Labeller {
    /// Learns from labelled pictures, see [`ActiveShape::learn`].
    ///
    /// # Errors
    ///
    /// As there.
    pub fn learn(examples: &[&Example], starts: &[usize]) -> Result<Self> {
        let model = ActiveShape::learn(examples, starts)?;
        let parts = PARTS.min(examples.len());
        let (mut unlike, mut off) = (Vec::new(), Vec::new());
        if parts > 1 {
            for part in 0..parts {
                let of = |kept: bool| {
                    let all = examples.iter().enumerate();
                    all.filter(move |(n, _)| (n % parts == part) == kept)
                        .map(|(_, example)| *example)
                };
                let other = ActiveShape::learn(&of(false).collect::<Vec<_>>(), starts)?;
                for example in of(true) {
                    // Where the detector fails, from the truth: what is asked is how a good find looks.
                    let fit = other
                        .find(&example.look, None)
                        .or_else(|| other.find(&example.look, Some(example.points.view())));
                    if let Some(fit) = fit {
                        unlike.push(fit.unlike);
                        off.extend(errors(fit.points.view(), example.points.view()));
                    }
                }
            }
        }
        Ok(Self {
            model,
            // A dimension's distance is 1 on average in pictures like the labelled ones; what is nearer is no more of a face, as of drawings that hardly differ.
            usual: median(unlike).unwrap_or(1.0).max(1.0),
            expected: median(off),
        })
    }

    /// The model.
    pub fn model(&self) -> &ActiveShape {
        &self.model
    }

    /// Median distance of a point of a picture that it has not seen, in shares of the face's width; None of a single labelled picture.
    pub fn expected(&self) -> Option<f32> {
        self.expected
    }

    /// From 0 to 1: 1 where a find looks as much like the labelled pictures as these look like each other, one half where it is twice as unlike.
    pub fn confidence(&self, fit: &Fit) -> f32 {
        (self.usual / fit.unlike.max(f32::MIN_POSITIVE)).min(1.0)
    }

    /// Finds the points of a picture whose neighbours are unknown, and how sure they are. None: there is no face.
    pub fn find(&self, look: &Look) -> Option<(Fit, f32)> {
        let fit = self.model.find(look, None)?;
        self.trusted([self.known(fit)])
    }

    /// Finds the points of picture `index` of a clip near those of the one before; where that does not convince, also where the detector sees a face. None: there is no face.
    pub fn follow(
        &self,
        frames: &Frames,
        index: usize,
        before: Option<ArrayView1<f32>>,
        finder: &mut FaceFinder,
    ) -> Option<(Fit, f32)> {
        let mut near = None;
        if let Some(before) = before {
            let fit = self
                .model
                .find(&Look::without_face(frames, index), Some(before))?;
            let known = self.known(fit);
            if known.1 >= UNSURE {
                return Some(known);
            }
            near = Some(known);
        }
        let anew = self.model.find(&Look::new(frames, index, finder), None);
        self.trusted(near.into_iter().chain(anew.map(|fit| self.known(fit))))
    }

    fn known(&self, fit: Fit) -> (Fit, f32) {
        let confidence = self.confidence(&fit);
        (fit, confidence)
    }

    /// The surest find, where it is sure enough to be a face.
    fn trusted(&self, finds: impl IntoIterator<Item = (Fit, f32)>) -> Option<(Fit, f32)> {
        let best = finds.into_iter().max_by(|a, b| a.1.total_cmp(&b.1));
        best.filter(|(_, confidence)| *confidence >= LOST)
    }
}

/// The middle value, None of none.
fn median(values: Vec<f32>) -> Option<f32> {
    (!values.is_empty()).then(|| crate::vision::median(values.into_iter()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::landmarks::search::tests::drawn;

    #[test]
    fn it_knows_what_to_expect_and_where_there_is_no_face() {
        let example = |n: usize| {
            let (frames, points) = drawn(4.0 + 1.2 * n as f32, [(n % 3) as f32, (n % 2) as f32]);
            Example {
                look: Look::without_face(&frames, 0),
                points,
            }
        };
        let examples: Vec<Example> = (0..10).map(example).collect();
        let used: Vec<&Example> = examples.iter().collect();
        let labeller = Labeller::learn(&used, &[]).unwrap();
        let expected = labeller.expected().unwrap();
        assert!(expected > 0.0 && expected < 0.01, "{expected}");
        let (frames, truth) = drawn(9.0, [4.0, 3.0]);
        let look = Look::without_face(&frames, 0);
        let (fit, confidence) = labeller.find(&look).unwrap();
        assert!(confidence > UNSURE, "{confidence}");
        let off = errors(fit.points.view(), truth.view());
        assert!(median(off).unwrap() < 0.01);
        // Points of long ago, far away, do not mislead it.
        let (_, far) = drawn(9.0, [60.0, -40.0]);
        let mut finder = FaceFinder::new().unwrap();
        let (_, again) = labeller
            .follow(&frames, 0, Some(far.view()), &mut finder)
            .unwrap();
        assert!(again > UNSURE, "{again}");
        let (empty, _) = drawn(9.0, [4000.0, 0.0]);
        let lost = labeller.follow(&empty, 0, Some(truth.view()), &mut finder);
        assert!(lost.is_none(), "{lost:?}");
        assert!(Labeller::learn(&used[..1], &[]).unwrap().expected().is_none());
    }
}
