//! Candidates that need no training corpus of systems: the mean, ridge regression, and one trained model in floats and as
//! the device computes it.
use lipstream_core::StreamSettings;
use lipstream_core::wire::Profile;
use ndarray::Array2;

use super::candidate::{Candidate, Heard, Prediction};
use super::ridge::RidgeMap;
use crate::error::{Error, Result, ensure};
use crate::features::{FeatureFolder, Split};
use lipstream::engine::{Engine, RunSettings};
use lipstream::export::{ExportSettings, MgeSettings, export, export_mge};
use lipstream::kinds::likelihood::Model;
use lipstream::kinds::likelihood::convert::{Follower, Lag, convert_with};
use lipstream::kinds::recurrent::live;
use lipstream::kinds::recurrent::model::RecurrentModel;

/// Always the mean mouth.
pub fn mean<'a>(size: usize) -> Candidate<'a> {
    Candidate::new("mean", Some(0), move |heard: &Heard| {
        Ok(Prediction {
            parameters: Array2::zeros((heard.observations.nrows(), size)),
            visemes: None,
        })
    })
}

/// Ridge regression from normalised statics, ±200 ms and live, and the points of its curve. Fitted here.
pub fn ridge<'a>(folder: &FeatureFolder, curve: bool) -> Result<Vec<Candidate<'a>>> {
    let train = super::truths(folder, Split::Train)?;
    let validation = super::truths(folder, Split::Val)?;
    let fitted = |name: &str, taps: Vec<i32>| -> Result<Candidate<'a>> {
        let ahead = 10 * taps.last().map_or(0, |t| (*t).max(0) as u32);
        let map = RidgeMap::fit(&train, &validation, taps)?;
        let candidate = Candidate::new(name, Some(ahead), move |heard: &Heard| {
            Ok(Prediction {
                parameters: map.predict(&heard.observations),
                visemes: None,
            })
        });
        Ok(candidate.of_family("ridge"))
    };
    let mut wide = fitted("ridge, ±200 ms", (-20..=20).collect())?;
    wide.family = None;
    let mut out = vec![wide, fitted("ridge, −300…80 ms", (-30..=8).step_by(2).collect())?];
    if curve {
        for ahead in [2, 4, 12, 20] {
            let name = format!("ridge, −300…{}0 ms", ahead);
            out.push(fitted(&name, (-30..=ahead).step_by(2).collect())?.unlisted());
        }
    }
    Ok(out)
}

/// A trained model: in floats over the whole clip, under its lag, and in fixed point with beam and lag.
pub fn of_model<'a>(
    folder: &FeatureFolder,
    model: &'a Model,
    beam_bits: Option<f64>,
) -> Result<Vec<Candidate<'a>>> {
    speaks_as_many(folder, model.visual_size())?;
    let tables = export(model, &ExportSettings::of(model))
        .map_err(Error::other)?
        .bytes;
    let ahead = Some(model.look_ahead_ms());
    Ok(vec![
        local_linear("ph-vi-chmm + local linear, float", None, model, Lag::Whole),
        local_linear(
            "ph-vi-chmm + local linear, float, fixed lag",
            ahead,
            model,
            Lag::Frames(model.following.lag),
        ),
        device(
            "ph-vi-chmm + local linear, fixed point, beam and lag",
            ahead,
            tables,
            RunSettings {
                beam_bits,
                ..RunSettings::default()
            },
        )?,
    ])
}

/// Local linear maps in floats.
pub(super) fn local_linear<'a>(name: &str, ahead: Option<u32>, model: &'a Model, lag: Lag) -> Candidate<'a> {
    let follower = Follower::of_model(model);
    Candidate::new(name, ahead, move |heard: &Heard| {
        let (parameters, visemes) =
            convert_with(&follower, model, &heard.observations, lag).map_err(Error::other)?;
        Ok(Prediction {
            parameters,
            visemes: Some(visemes),
        })
    })
}

/// What the device makes of these tables.
fn device<'a>(name: &str, ahead: Option<u32>, tables: Vec<u8>, with: RunSettings) -> Result<Candidate<'a>> {
    let engine = Engine::fixed(tables).map_err(Error::other)?;
    Ok(Candidate::new(name, ahead, move |heard: &Heard| {
        let said = engine.convert(&heard.samples, &with).map_err(Error::other)?;
        Ok(Prediction {
            parameters: said.parameters,
            visemes: Some(said.visemes),
        })
    }))
}

/// Refuses a model of another number of mouth parameters than the folder's.
pub(super) fn speaks_as_many(folder: &FeatureFolder, size: usize) -> Result<()> {
    ensure!(
        size == folder.manifest.visual_size,
        Choice,
        "the model speaks {size} mouth parameters, {} holds {}",
        folder.root.display(),
        folder.manifest.visual_size
    );
    Ok(())
}

/// A model trained on the error of its mouth, streamed frame by frame in floats with `look_ahead` frames of future.
pub(super) fn mge_float<'a>(
    name: impl Into<String>,
    model: &'a RecurrentModel,
    look_ahead: usize,
) -> Candidate<'a> {
    Candidate::new(name, Some(10 * look_ahead as u32), move |heard: &Heard| {
        let said = live::convert_within(model, heard.observations.view(), look_ahead);
        Ok(Prediction {
            parameters: said.parameters,
            visemes: Some(said.visemes),
        })
    })
}

/// A model trained on the error of its mouth, streamed frame by frame: in floats, and as the device computes it in every
/// profile.
pub fn of_mge<'a>(
    folder: &FeatureFolder,
    model: &'a RecurrentModel,
    beam_bits: Option<f64>,
) -> Result<Vec<Candidate<'a>>> {
    speaks_as_many(folder, model.deviation.len())?;
    let ahead = Some(model.look_ahead_ms());
    let tables = export_mge(model, &MgeSettings::default())
        .map_err(Error::other)?
        .bytes;
    let own = model.parameters.shape.context.look_ahead();
    let mut out = vec![mge_float("mge, float", model, own)];
    for (name, profile) in [
        ("mge, fixed point and beam", Profile::Studio),
        ("mge, fixed point, standard", Profile::Standard),
        ("mge, fixed point, live", Profile::Live),
    ] {
        let waits = StreamSettings::of(profile)
            .look_ahead
            .map(|hops| 10 * u32::from(hops));
        let with = RunSettings {
            beam_bits,
            profile: Some(profile),
            ..RunSettings::default()
        };
        let ahead = ahead.map(|own| waits.map_or(own, |waits| waits.min(own)));
        out.push(device(name, ahead, tables.clone(), with)?);
    }
    Ok(out)
}
