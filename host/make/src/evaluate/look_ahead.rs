//! Quality against look-ahead: the same HMMs made to wait for less or more of the future.
//!
//! Between frame centres, ΔΔ looks 40 ms ahead and the average over three frames 10 ms; what is left of a look-ahead is the lag of
//! the occupancies. At 20 ms there is room for Δ only: the densities' marginals without ΔΔ (their covariances are diagonal) hear the
//! other 26 numbers. Local linear maps are fitted again for each look-ahead, their context as long as it allows; conversion by means
//! shares the lag among its iterations, and begins at the centres of the states that are likeliest so far; the best path waits for
//! the lag before it is read off.
use std::borrow::Cow;

use lipstream_core::N_STATIC;
use ndarray::{Array2, s};

use super::candidate::{Candidate, Heard, Prediction};
use super::models;
use crate::em::source::{Source, Utterance};
use crate::error::{Error, Result, ensure};
use crate::features::{FeatureFolder, Split};
use crate::train::data::Clips;
use crate::train::{self, maps};
use lipstream::hmm::Hmm;
use lipstream::hmm::system::{Speech, System};
use lipstream::kinds::likelihood::Model;
use lipstream::kinds::likelihood::convert::{Follower, Lag, apply_maps, smooth};
use lipstream::kinds::likelihood::inversion::Inverter;
use lipstream::kinds::recurrent::model::RecurrentModel;
use lipstream::phones::Phone;
use lipstream::progress::Progress;

/// One look-ahead, in frames of 10 ms between centres.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Wait {
    frames: usize,
    /// Numbers of an observation that are heard.
    heard: usize,
    lag: usize,
    average: bool,
}

impl Wait {
    fn of(frames: usize) -> Self {
        const DELTA: usize = 2;
        // An average pays where a lag of one frame more does not.
        let average = frames > 2 * DELTA;
        let deltas = if frames >= 2 * DELTA { 2 } else { 1 };
        Self {
            frames,
            heard: (1 + deltas) * N_STATIC,
            lag: frames - deltas * DELTA - usize::from(average),
            average,
        }
    }

    /// The model as far as its densities hear.
    fn cut(&self, model: &Model) -> Model {
        let mut cut = model.clone();
        cut.audio.mean = model.audio.mean.slice(s![.., .., ..self.heard]).to_owned();
        cut.audio.variance = model.audio.variance.slice(s![.., .., ..self.heard]).to_owned();
        cut
    }

    fn heard(&self, observations: &Array2<f32>) -> Array2<f32> {
        observations.slice(s![.., ..self.heard]).to_owned()
    }

    fn said(&self, parameters: Array2<f32>) -> Array2<f32> {
        if self.average {
            smooth(&parameters)
        } else {
            parameters
        }
    }
}

/// What is measured, in frames: 20 to 200 ms.
const LOOK_AHEADS: [usize; 5] = [2, 4, 8, 12, 20];

/// The points of the curves of `systems`, unlisted.
pub fn curves<'a>(
    folder: &FeatureFolder,
    systems: &[System],
    models: &[Model],
    progress: &dyn Progress,
) -> Result<Vec<Candidate<'a>>> {
    let mut out = Vec::new();
    for system in systems {
        let Some(model) = models.iter().find(|m| m.system.hmm() == system.hmm()) else {
            continue;
        };
        let refit = match system.speech {
            Speech::LocalLinear => Some(Refit::new(folder, &model.phones, progress)?),
            Speech::Means | Speech::Posterior | Speech::Viterbi => None,
        };
        for wait in LOOK_AHEADS.map(Wait::of) {
            let ms = 10 * wait.frames as u32;
            let name = format!("{}, {ms} ms", system.name);
            progress.say(&format!("for the curve: {name}"));
            let model = wait.cut(model);
            let candidate = match &refit {
                Some(refit) => refit.candidate(name, model, wait, progress)?,
                None => by_means(name, *system, &model, wait),
            };
            out.push(candidate.of_family(system.name).unlisted());
        }
    }
    Ok(out)
}

/// A model trained on its error at every look-ahead that it can be run at, unlisted: one model for all.
pub fn of_mge<'a>(model: &'a RecurrentModel, family: &str) -> Vec<Candidate<'a>> {
    let own = model.parameters.shape.context.look_ahead();
    let within = [2, 3, 4, 6].into_iter().filter(|ahead| *ahead < own);
    within
        .chain([own])
        .map(|ahead| {
            let name = format!("{family}, {} ms", 10 * ahead);
            models::mge_float(name, model, ahead).of_family(family).unlisted()
        })
        .collect()
}

fn by_means<'a>(name: String, system: System, model: &Model, wait: Wait) -> Candidate<'a> {
    let inverter = Inverter::new(Hmm::of_model(model));
    let (settings, posterior_scale) = (model.conversion, model.posterior_scale);
    Candidate::new(name, Some(10 * wait.frames as u32), move |heard: &Heard| {
        let observations = wait.heard(&heard.observations);
        let parameters = match system.speech {
            Speech::Viterbi => inverter
                .best_path_within(&observations, settings.acoustic_scale, wait.lag)
                .map_err(Error::other)?,
            Speech::Posterior => {
                inverter
                    .posterior_mean(&observations, posterior_scale, Lag::Frames(wait.lag))
                    .map_err(Error::other)?
                    .0
            }
            _ => inverter
                .convert_within(&observations, &settings, wait.lag)
                .map_err(Error::other)?,
        };
        Ok(Prediction {
            parameters: wait.said(parameters),
            visemes: None,
        })
    })
}

/// The clips that maps are fitted on.
struct Refit<'a> {
    train: Clips<'a>,
    judges: Clips<'a>,
}

/// Clips as a cut model hears them.
struct Cut<'a> {
    clips: &'a Clips<'a>,
    wait: Wait,
}

impl Source for Cut<'_> {
    fn len(&self) -> usize {
        self.clips.len()
    }

    fn get(&self, index: usize) -> Result<Cow<'_, Utterance>> {
        let mut utterance = self.clips.get(index)?.into_owned();
        utterance.audio = self.wait.heard(&utterance.audio);
        Ok(Cow::Owned(utterance))
    }
}

impl<'a> Refit<'a> {
    fn new(folder: &'a FeatureFolder, phones: &'a [Phone], progress: &dyn Progress) -> Result<Self> {
        let clips = |split| Clips::new(folder, split, phones, progress).readable(true, progress);
        let new = Self {
            train: clips(Split::Train),
            judges: clips(Split::Val),
        };
        ensure!(
            !new.train.is_empty() && !new.judges.is_empty(),
            Data,
            "{} has no training or no validation clips with video to fit maps on",
            folder.root.display()
        );
        Ok(new)
    }

    fn candidate<'b>(
        &self,
        name: String,
        mut model: Model,
        wait: Wait,
        progress: &dyn Progress,
    ) -> Result<Candidate<'b>> {
        let cut = |clips| Cut { clips, wait };
        let last = wait.frames as i32 - i32::from(wait.average);
        let settings = train::TrainSettings {
            taps: (-30..=last).step_by(2).collect(),
            lag: wait.lag,
            acoustic_scales: vec![model.following.acoustic_scale],
            ..train::TrainSettings::default()
        };
        let hmm = Hmm::of_model(&model);
        let (following, context, fitted) =
            maps::maps(&hmm, &cut(&self.train), &cut(&self.judges), &settings, progress)?;
        (model.following, model.context, model.maps) = (following, context, fitted);
        let follower = Follower::of_model(&model);
        Ok(Candidate::new(
            name,
            Some(10 * wait.frames as u32),
            move |heard: &Heard| {
                let observations = wait.heard(&heard.observations);
                let (said, _) = apply_maps(&follower, &model, &observations, Lag::Frames(wait.lag))
                    .map_err(Error::other)?;
                Ok(Prediction {
                    parameters: wait.said(said),
                    visemes: None,
                })
            },
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_add_up() {
        for frames in LOOK_AHEADS {
            let wait = Wait::of(frames);
            let deltas = 2 * (wait.heard / N_STATIC - 1);
            assert_eq!(wait.lag + deltas + usize::from(wait.average), frames, "{wait:?}");
        }
        assert_eq!(
            Wait::of(2),
            Wait {
                frames: 2,
                heard: 26,
                lag: 0,
                average: false
            }
        );
        assert_eq!(Wait::of(8).lag, 3);
    }
}
