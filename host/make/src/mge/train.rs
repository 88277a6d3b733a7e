//! The training loop: batches of clips, gradients through the recursion, validation after every pass.
//!
//! With e = ŷ − y (standardised), weights w_d = σ_d^ρ / Σσ^ρ, and (a_t, v_t) the forced alignment, a batch's loss is
//! ```text
//! E = 1/T Σ_t Σ_d w_d e²_td − κ_a/T Σ ln γᵃ_t(a_t) − κ_v/T Σ ln γᵛ_t(v_t)
//!     − κ_h/T_h Σ_heard ln γᵃ_t(a_t) + κ_t/T_h Σ_heard Σ_d w_d (y − what its phones say)²_td
//!     + κ_l/T_l Σ_watched (g_t − ĝ_t − mean)² + κ_c Σ c²_t/(T or T_h)   (M10)
//! ```
//! over the T frames of its clips with video, the T_h frames of those without, and the T_l frames of other people of whom the lip gap g alone is known;
//! ĝ is what is read off the mouth, in deviations, and the mean over the piece is taken off, since everybody's mouth has its own; c is how far ĝ is on the wrong side of closed
//! lips, where the phone a_t says which side that is (`lips.rs`). Random numbers depend on the seed, the
//! step and the clip's place only, and sums are taken in the order of the clips: neither threads nor interruptions
//! change the result.
use std::path::Path;
use std::time::Instant;

use ndarray::Array2;

use super::batch::Trainer;
use super::checkpoint::{self, Best};
use super::data::{self, Beside, Clip, Data};
use super::judge::{Judgement, judge};
use super::optimise::Optimiser;
use super::settings::MgeTrainSettings;
use super::start::{Seen, start};
use crate::em::source::in_order;
use crate::error::{Error, Result, bail};
use crate::features::FeatureFolder;
use crate::hash::Fnv1a;
use lipstream::kinds::likelihood::Model;
use lipstream::kinds::recurrent::chain::{Chain, ROWS};
use lipstream::kinds::recurrent::model::{LEAST, RecurrentModel, check_parent};
use lipstream::kinds::recurrent::parameters::{Parameters, Shape};
use lipstream::progress::Progress;

/// Trains, beginning at the likelihood-trained `parent`. `checkpoint` is where an interrupted run left off and will
/// leave off.
///
/// # Errors
///
/// That `parent` has learnt another mouth than the folder's, which the new model would be drawn with; and what reading data says.
pub fn train(
    folder: &FeatureFolder,
    beside: &Beside,
    parent: &Model,
    settings: &MgeTrainSettings,
    checkpoint: Option<&Path>,
    progress: &dyn Progress,
) -> Result<RecurrentModel> {
    settings.check()?;
    check_parent(parent).map_err(Error::other)?;
    if let Some(space) = &parent.mouth {
        folder.has_mouth(space)?;
    }
    progress.say("forced alignment with the likelihood-trained model");
    let aside = checkpoint.and_then(Path::parent);
    let data = data::read(folder, beside, parent, settings, aside, progress)?;
    progress.say(&format!(
        "{} clips with video, {} with sound only, {} of other people's lips, {} to validate on",
        data.train.len(),
        data.heard.len(),
        data.watched.len(),
        data.validation.len()
    ));
    train_on(&data, parent, settings, checkpoint, progress)
}

/// [`train`] on data that has been read.
pub fn train_on(
    data: &Data,
    parent: &Model,
    settings: &MgeTrainSettings,
    checkpoint_path: Option<&Path>,
    progress: &dyn Progress,
) -> Result<RecurrentModel> {
    let shape = Shape {
        phones: parent.phones.len(),
        context: settings.context.clone(),
        inputs: settings.inputs,
        memory: settings.memory,
        outputs: data.deviation.len(),
        feedback: settings.feedback,
        maps: settings.maps,
        rates: settings.rates,
    };
    let start = || begin(&shape, data, parent, settings);
    run(data, parent, &shape, &start, settings, checkpoint_path, progress)
}

/// The loop, from what `start` gives: parameters and the contexts' mean.
pub(super) fn run(
    data: &Data,
    parent: &Model,
    shape: &Shape,
    start: &dyn Fn() -> Result<(Parameters, Vec<f32>)>,
    settings: &MgeTrainSettings,
    checkpoint_path: Option<&Path>,
    progress: &dyn Progress,
) -> Result<RecurrentModel> {
    let mut trainer = Trainer {
        settings,
        data,
        chain: Chain::new(&parent.phones, &parent.transition, &parent.bigram),
        context_mean: Vec::new(),
        weights: weights(&data.deviation, settings.error_power),
    };
    let steps = settings.passes * trainer.steps_per_pass();
    let rule = settings.rule.over(steps);
    let fingerprint = fingerprint(settings, data)?;
    let found = match checkpoint_path {
        Some(path) => checkpoint::read(path, &Parameters::zeros(shape), fingerprint)?,
        None => None,
    };
    let (mut optimiser, mut best) = match found {
        Some((optimiser, best, context_mean)) => {
            progress.say(&format!("going on after step {} of {steps}", optimiser.step));
            trainer.context_mean = context_mean;
            (optimiser, best)
        }
        None => {
            let (parameters, mean) = start()?;
            trainer.context_mean = mean;
            let best = Best {
                error: f64::INFINITY,
                parameters: parameters.clone(),
                pass: 0,
            };
            (Optimiser::new(parameters), best)
        }
    };
    progress.say(&format!(
        "{} parameters, {:.1} KiB of tables in i8; {steps} steps",
        optimiser.parameters.values.len(),
        optimiser.parameters.table_size() as f64 / 1024.0
    ));
    let mut begun = Instant::now();
    let (mut error, mut entropy, mut length, mut count) = (0.0, 0.0, 0.0f32, 0);
    while optimiser.step < steps {
        let step = optimiser.step;
        let share = trainer.batch(&optimiser.parameters, step)?;
        let moved = if share.error.is_finite() && share.entropy.is_finite() {
            optimiser.step(&rule, &share.gradient)
        } else {
            None
        };
        let Some(moved) = moved else {
            bail!(
                Numbers,
                "training diverged at step {} of {steps} (loss {}): lower the learning rate, now {}",
                step + 1,
                share.error,
                rule.rate
            );
        };
        error += share.error;
        entropy += share.entropy;
        length = length.max(moved);
        count += 1;
        if optimiser.step % trainer.steps_per_pass() == 0 {
            let pass = optimiser.step / trainer.steps_per_pass();
            let seen = validate(&trainer, &optimiser, pass, &mut best)?;
            progress.say(&format!(
                "pass {pass}/{}: error {:.4}, entropy {:.4}, gradient up to {length:.2}; {seen}; {:.1} s",
                settings.passes,
                error / f64::from(count),
                entropy / f64::from(count),
                begun.elapsed().as_secs_f32()
            ));
            if let Some(path) = checkpoint_path {
                checkpoint::write(path, &optimiser, &best, &trainer.context_mean, fingerprint)?;
            }
            begun = Instant::now();
            (error, entropy, length, count) = (0.0, 0.0, 0.0, 0);
        }
    }
    progress.say(&format!("the parameters after pass {} are kept", best.pass));
    let validation_amse = match data.validation.is_empty() {
        true => None,
        false => {
            let ahead = settings.context.look_ahead();
            Some(judged(&trainer, &best.parameters, ahead)?.score.amse())
        }
    };
    Ok(RecurrentModel {
        parent: parent.clone(),
        parameters: best.parameters,
        validation_amse,
        context_mean: trainer.context_mean,
        gated: None,
        scale: data.scale.clone(),
        deviation: data.deviation.clone(),
        least: LEAST,
        provenance: format!(
            "coupled HMM trained on the error of its mouth; {} clips with video, {} with sound only, {} of other people's lips, each heard {} times more with \
             noise, other levels and later beginnings; for look-aheads of {} frames; {} passes, seed {}; started from: {}",
            data.train.len(),
            data.heard.len(),
            data.watched.len(),
            settings.variants,
            settings
                .look_aheads
                .iter()
                .map(usize::to_string)
                .collect::<Vec<_>>()
                .join(", "),
            settings.passes,
            settings.seed,
            parent.provenance
        ),
    })
}

/// w_d = σ_d^ρ / Σσ^ρ.
pub(super) fn weights(deviation: &[f32], power: f32) -> Vec<f32> {
    let powers: Vec<f32> = deviation.iter().map(|d| d.powf(power)).collect();
    let sum: f32 = powers.iter().sum();
    powers.iter().map(|p| p / sum).collect()
}

fn begin(
    shape: &Shape,
    data: &Data,
    parent: &Model,
    settings: &MgeTrainSettings,
) -> Result<(Parameters, Vec<f32>)> {
    let seen = |n: usize| {
        let own = data.train.len();
        let clip = match n < own {
            true => data.train.get(n)?,
            false => data.heard.get(n - own)?,
        };
        Ok(Seen {
            context: shape.context.stack(&clip.x, clip.x.nrows()),
            states: clip.states,
            // What is taught is no mouth to start from.
            mouth: clip.mouth.filter(|_| n < own),
        })
    };
    let transition = Array2::from_shape_vec(
        (shape.phones, ROWS),
        parent.transition.iter().copied().collect::<Vec<f32>>(),
    )?;
    let (parameters, mean) = start(
        shape,
        &(data.train.len() + data.heard.len(), &seen),
        &transition,
        &parent.initial.to_vec(),
        &settings.start,
        settings.seed,
    )?;
    Ok((parameters, mean.to_vec()))
}

/// Scores the mean of the parameters and keeps it if it is the best; without validation clips the last one is kept.
fn validate(trainer: &Trainer, optimiser: &Optimiser, pass: usize, best: &mut Best) -> Result<String> {
    let data = trainer.data;
    if data.validation.is_empty() {
        *best = Best {
            error: 0.0,
            parameters: optimiser.mean.clone(),
            pass,
        };
        return Ok("no clips to validate on".into());
    }
    let own = [trainer.settings.context.look_ahead()];
    let look_aheads = match trainer.settings.look_aheads.as_slice() {
        [] => &own,
        some => some,
    };
    let seen: Vec<Judgement> = look_aheads
        .iter()
        .map(|&ahead| judged(trainer, &optimiser.mean, ahead))
        .collect::<Result<_>>()?;
    let amse = seen.iter().map(|s| s.score.amse()).sum::<f64>() / seen.len() as f64;
    if !amse.is_finite() {
        bail!(
            Numbers,
            "training diverged in pass {pass}: lower the learning rate, now {}",
            trainer.settings.rule.rate
        );
    }
    if amse < best.error {
        *best = Best {
            error: amse,
            parameters: optimiser.mean.clone(),
            pass,
        };
    }
    let said: Vec<String> = seen
        .iter()
        .map(|s| {
            format!(
                "at {} ms AMSE {:.0}, ACC {:.4}, phones {:.1} %, visemes {:.1} %, viseme states {:.1} %",
                10 * s.ahead,
                s.score.amse(),
                s.score.acc(),
                100.0 * s.share(s.phones),
                100.0 * s.share(s.visemes),
                100.0 * s.share(s.visual_states)
            )
        })
        .collect();
    Ok(format!("validation {}", said.join("; ")))
}

/// Parameters on the validation clips.
fn judged(trainer: &Trainer, parameters: &Parameters, ahead: usize) -> Result<Judgement> {
    let data = trainer.data;
    judge(
        parameters,
        &trainer.chain,
        &trainer.context_mean,
        &data.deviation,
        &data.validation,
        ahead,
        LEAST,
    )
}

/// A number that settings and data share with no other run.
pub(super) fn fingerprint(settings: &MgeTrainSettings, data: &Data) -> Result<u64> {
    let mut hash = Fnv1a::new();
    let mut eat = |bytes: &[u8]| hash.eat(bytes.iter().copied());
    eat(format!("{settings:?}").as_bytes());
    let mut eat_clip = |clip: Clip| {
        eat(clip.id.as_bytes());
        eat(&clip.x.sum().to_bits().to_le_bytes());
        eat(&(clip.x.nrows() as u64).to_le_bytes());
        let states: usize = clip
            .states
            .iter()
            .enumerate()
            .map(|(t, (a, v))| (t + 1) * (a + 7 * v))
            .sum();
        eat(&(states as u64).to_le_bytes());
        if let Some(mouth) = &clip.mouth {
            eat(&mouth.sum().to_bits().to_le_bytes());
        }
        Ok(())
    };
    for clips in [&data.train, &data.heard, &data.watched, &data.validation] {
        in_order(clips.len(), |n| clips.get(n), &mut eat_clip)?;
    }
    Ok(hash.value())
}
