//! The papers' systems as candidates: each HMM trained once (or read, where it was trained before), each way of
//! speaking a candidate of its own.
use std::path::Path;
use std::sync::Arc;

use super::candidate::{Candidate, Heard, Iteration, Prediction};
use super::models::local_linear;
use crate::error::{Context as _, Error, Result, bail, ensure};
use crate::features::FeatureFolder;
use crate::train::{self, TrainSettings};
use lipstream::hmm::Hmm;
use lipstream::hmm::system::{SYSTEMS, Speech, System};
use lipstream::kinds::likelihood::convert::{Lag, smooth, viseme_weights};
use lipstream::kinds::likelihood::inversion::Inverter;
use lipstream::kinds::likelihood::{EmSettings, Model};
use lipstream::progress::Progress;

/// Systems by name, separated by commas; `all` are the paper's HMMs in every way of speaking, `variants` those of other HMMs.
pub fn parse(names: &str) -> Result<Vec<System>> {
    if names == "all" || names == "variants" {
        let variants = names == "variants";
        return Ok(SYSTEMS
            .into_iter()
            .filter(|s| s.is_variant() == variants)
            .collect());
    }
    let known = || SYSTEMS.map(|s| s.name).join(", ");
    names
        .split(',')
        .map(|name| {
            System::from_name(name.trim()).ok_or_else(|| {
                Error::Choice(format!(
                    "unknown system {:?}; there are all, variants, {}",
                    name.trim(),
                    known()
                ))
            })
        })
        .collect()
}

/// A system that iterates, and beside it the posterior mean of the same HMM; another system alone.
pub fn by_means(system: System) -> Vec<System> {
    let posterior = SYSTEMS
        .into_iter()
        .find(|s| s.speech == Speech::Posterior && s.hmm() == system.hmm());
    let beside = posterior.filter(|_| system.speech == Speech::Means);
    std::iter::once(system).chain(beside).collect()
}

/// The models of `systems`, one for each HMM: read from `store` where they are, else trained and written there, so that
/// work that was interrupted goes on with the next one.
pub fn open_or_train(
    systems: &[System],
    store: &Path,
    folder: &FeatureFolder,
    audio_only: &[FeatureFolder],
    progress: &dyn Progress,
) -> Result<Vec<Model>> {
    std::fs::create_dir_all(store).with_context(|| format!("cannot create {}", store.display()))?;
    let mut models: Vec<Model> = Vec::new();
    for system in systems {
        let hmm = system.hmm();
        if models.iter().any(|m| m.system.hmm() == hmm) {
            continue;
        }
        let path = store.join(format!("{}.safetensors", hmm.name));
        let model = if path.exists() {
            let model = Model::read(&path).map_err(Error::other)?;
            ensure!(
                model.system.hmm() == hmm,
                Choice,
                "{} holds the system {}: remove it to train {} again",
                path.display(),
                model.system.name,
                hmm.name
            );
            model
        } else {
            let model = train::train(folder, audio_only, &TrainSettings::of(hmm), progress)?;
            model.write(&path).map_err(Error::other)?;
            model
        };
        if model.visual_size() != folder.manifest.visual_size {
            bail!(
                Choice,
                "{} speaks {} mouth parameters, {} holds {}: remove it to train it again",
                path.display(),
                model.visual_size(),
                folder.root.display(),
                folder.manifest.visual_size
            );
        }
        models.push(model);
    }
    Ok(models)
}

/// A candidate of each system, from the models of their HMMs.
pub fn candidates<'a>(systems: &[System], models: &'a [Model]) -> Result<Vec<Candidate<'a>>> {
    systems
        .iter()
        .map(|&system| {
            let model = models
                .iter()
                .find(|m| m.system.hmm() == system.hmm())
                .ok_or_else(|| Error::Choice(format!("no model for the system {}", system.name)))?;
            Ok(candidate(system, model))
        })
        .collect()
}

/// A likelihood-trained model under a name of its own, in its own way of speaking and, if that iterates, by the posterior mean
/// too: the same system trained otherwise.
pub fn also<'a>(name: &str, model: &'a Model, folder: &FeatureFolder) -> Result<Vec<Candidate<'a>>> {
    super::models::speaks_as_many(folder, model.visual_size()).with_context(|| name.to_owned())?;
    let ways = by_means(model.system).into_iter();
    Ok(ways
        .map(|system| {
            let mut candidate = candidate(system, model);
            candidate.name = match system == model.system {
                true => name.to_owned(),
                false => format!("{name}, posterior mean"),
            };
            candidate
        })
        .collect())
}

fn candidate(system: System, model: &Model) -> Candidate<'_> {
    match system.speech {
        Speech::LocalLinear => {
            let lag = Lag::Frames(model.following.lag);
            local_linear(system.name, Some(model.look_ahead_ms()), model, lag)
        }
        Speech::Viterbi => {
            let inverter = Inverter::new(Hmm::of_model(model));
            Candidate::new(system.name, None, move |heard: &Heard| {
                let said = inverter
                    .best_path(&heard.observations, model.conversion.acoustic_scale)
                    .map_err(Error::other)?;
                Ok(Prediction {
                    parameters: smooth(&said),
                    visemes: None,
                })
            })
        }
        Speech::Posterior => {
            let inverter = Inverter::new(Hmm::of_model(model));
            Candidate::new(system.name, None, move |heard: &Heard| {
                let (said, occupancy) = inverter
                    .posterior_mean(&heard.observations, model.posterior_scale, Lag::Whole)
                    .map_err(Error::other)?;
                Ok(Prediction {
                    parameters: smooth(&said),
                    visemes: Some(viseme_weights(model, &occupancy)),
                })
            })
        }
        Speech::Means => {
            let inverter = Arc::new(Inverter::new(Hmm::of_model(model)));
            let again = inverter.clone();
            let candidate = Candidate::new(system.name, None, move |heard: &Heard| {
                let (said, occupancy) = inverter
                    .convert(&heard.observations, &model.conversion)
                    .map_err(Error::other)?;
                Ok(Prediction {
                    parameters: smooth(&said),
                    visemes: Some(viseme_weights(model, &occupancy)),
                })
            });
            candidate.with_iterations(move |heard: &Heard| {
                let frames = heard.observations.nrows() as f64;
                let estimates = again
                    .iterations(&heard.observations, &SHOWN)
                    .map_err(Error::other)?;
                Ok(estimates
                    .into_iter()
                    .map(|e| Iteration {
                        log_likelihood: e.log_likelihood * frames,
                        parameters: smooth(&e.parameters),
                    })
                    .collect())
            })
        }
    }
}

/// What figure 10 shows: the paper's EM, both streams at full weight, from the best path's centres.
const SHOWN: EmSettings = EmSettings {
    acoustic_scale: 1.0,
    visual_exponent: 1.0,
    iterations: 6,
    m_step: lipstream::kinds::likelihood::MStep::Exact,
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_known_or_refused_in_words() {
        let (all, variants) = (parse("all").unwrap(), parse("variants").unwrap());
        assert_eq!((all.len(), variants.len()), (16, 10));
        assert_eq!(all.len() + variants.len(), SYSTEMS.len());
        assert_eq!(parse("ph-hmm, viterbi").unwrap().len(), 2);
        let error = parse("ph-hmm,gru").unwrap_err().to_string();
        assert!(
            error.contains("\"gru\"") && error.contains("ph-vi-chmm"),
            "{error}"
        );
    }
}
