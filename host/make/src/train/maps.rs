//! The last stage: how the HMM is to be followed, and what it says. Local linear maps (`docs/design.md` section 6) under the
//! occupancies that conversion will see, and the exponents of conversion by means (X&L section 4).
use lipstream_core::N_STATIC;
use ndarray::{Array2, s};

use super::TrainSettings;
use crate::em::source::{Source, Utterance, in_order};
use crate::error::{Error, Result};
use crate::evaluate::metrics::Score;
use crate::train::local_linear::{ContextSums, MapSums};
use lipstream::hmm::Hmm;
use lipstream::kinds::likelihood::convert::{Follower, Lag, smooth};
use lipstream::kinds::likelihood::inversion::Inverter;
use lipstream::kinds::likelihood::local_linear;
use lipstream::kinds::likelihood::{ContextMap, EmSettings, Following, LocalLinear, MStep};
use lipstream::progress::Progress;

fn visual(u: &Utterance) -> Result<&Array2<f32>> {
    u.visual
        .as_ref()
        .ok_or_else(|| Error::Data(format!("clip {} has no video", u.id)))
}

/// Clips whose sums are added up before they join the others.
const CHUNK: usize = 16;

/// Context, maps, and how the model is to be followed: the acoustic scale and the ridge penalty with the smallest error
/// on the `judges`.
pub(crate) fn maps(
    hmm: &Hmm,
    train: &impl Source,
    judges: &impl Source,
    settings: &TrainSettings,
    progress: &dyn Progress,
) -> Result<(Following, ContextMap, LocalLinear)> {
    let statics = |u: &Utterance| u.audio.slice(s![.., ..N_STATIC]).to_owned();
    let mut sums = ContextSums::new(settings.taps.len() * N_STATIC);
    let stacked = |n: usize| {
        let utterance = train.get(n)?;
        Ok(local_linear::stack(statics(&utterance).view(), &settings.taps))
    };
    in_order(train.len(), stacked, |rows| {
        sums.add(&rows);
        Ok(())
    })?;
    let context = sums.solve(&settings.taps, settings.context)?;
    let project = |u: &Utterance| local_linear::project(&context, statics(u).view());
    let size = hmm.visual.mean.dim().2;
    let new_sums = || MapSums::new(settings.context, size, hmm.n_visual_states());
    let lag = Lag::Frames(settings.lag);
    let scales = &settings.acoustic_scales;
    let followers: Vec<Follower> = scales.iter().map(|&scale| Follower::new(hmm, scale)).collect();
    // Densities are evaluated once for all scales.
    let occupancies = |u: &Utterance| -> Result<Vec<Array2<f32>>> {
        let log = match followers.first() {
            Some(follower) => follower.log_likelihoods(&u.audio),
            None => return Ok(Vec::new()),
        };
        let of = followers
            .iter()
            .map(|follower| follower.occupancies_of(&log, lag));
        of.map(|both| both.map(|(_, visual)| visual).map_err(Error::other))
            .collect()
    };
    let mut sums: Vec<MapSums> = scales.iter().map(|_| new_sums()).collect();
    let sums_of = |chunk: usize| {
        let mut sums: Vec<MapSums> = scales.iter().map(|_| new_sums()).collect();
        for n in CHUNK * chunk..(CHUNK * (chunk + 1)).min(train.len()) {
            let u = train.get(n)?;
            let x = project(&u);
            for (sums, occupancy) in sums.iter_mut().zip(occupancies(&u)?) {
                sums.add(&x, visual(&u)?, &occupancy);
            }
        }
        Ok(sums)
    };
    in_order(train.len().div_ceil(CHUNK), sums_of, |parts| {
        sums.iter_mut()
            .zip(&parts)
            .for_each(|(sums, part)| sums.merge(part));
        Ok(())
    })?;
    let fit = |sums: &MapSums| -> Result<Vec<LocalLinear>> {
        let penalties = settings.penalties.iter();
        penalties.map(|penalty| sums.solve(1.0, *penalty)).collect()
    };
    let fitted: Vec<Vec<LocalLinear>> = sums.iter().map(fit).collect::<Result<_>>()?;
    let mut scores = vec![vec![Score::new(size); settings.penalties.len()]; scales.len()];
    let said = |n: usize| {
        let u = judges.get(n)?;
        let x = project(&u);
        let of_scales = fitted.iter().zip(occupancies(&u)?);
        let said = of_scales.map(|(fitted, occupancy)| -> Vec<Array2<f32>> {
            let fitted = fitted.iter();
            fitted
                .map(|maps| smooth(&local_linear::apply(maps, &x, &occupancy)))
                .collect()
        });
        Ok((visual(&u)?.clone(), said.collect()))
    };
    in_order(judges.len(), said, |(truth, said): (_, Vec<Vec<Array2<f32>>>)| {
        for (score, said) in scores.iter_mut().flatten().zip(said.iter().flatten()) {
            score.add(&truth, said);
        }
        Ok(())
    })?;
    let mut best: Option<(f64, Following, LocalLinear)> = None;
    for ((&acoustic_scale, fitted), scores) in scales.iter().zip(fitted).zip(&scores) {
        for ((maps, score), penalty) in fitted.into_iter().zip(scores).zip(&settings.penalties) {
            progress.say(&format!(
                "  maps: acoustic scale {acoustic_scale}, penalty {penalty}: AMSE {:.2}, ACC {:.4} on {} validation clips",
                score.amse(),
                score.acc(),
                judges.len()
            ));
            if best.as_ref().is_none_or(|(amse, ..)| score.amse() < *amse) {
                let following = Following {
                    acoustic_scale,
                    lag: settings.lag,
                };
                best = Some((score.amse(), following, maps));
            }
        }
    }
    let (_, following, maps) =
        best.ok_or_else(|| Error::Choice("no acoustic scale or penalty to choose from".into()))?;
    Ok((following, context, maps))
}

/// The acoustic scale with the smallest error of the posterior mean on the `judges`.
pub(super) fn posterior(
    hmm: &Hmm,
    judges: &impl Source,
    settings: &TrainSettings,
    progress: &dyn Progress,
) -> Result<f32> {
    let inverter = Inverter::new(*hmm);
    let mut best = None;
    for &scale in &settings.acoustic_scales {
        let mut score = Score::new(hmm.visual.mean.dim().2);
        let said = |n: usize| {
            let u = judges.get(n)?;
            let said = inverter.posterior_mean(&u.audio, scale, Lag::Whole);
            Ok((visual(&u)?.clone(), smooth(&said.map_err(Error::other)?.0)))
        };
        in_order(judges.len(), said, |(truth, said)| {
            score.add(&truth, &said);
            Ok(())
        })?;
        progress.say(&format!(
            "  posterior mean: acoustic scale {scale}: AMSE {:.2}, ACC {:.4}",
            score.amse(),
            score.acc()
        ));
        if best.is_none_or(|(amse, _)| score.amse() < amse) {
            best = Some((score.amse(), scale));
        }
    }
    best.map(|(_, scale)| scale)
        .ok_or_else(|| Error::Choice("no acoustic scale to choose from".into()))
}

/// Visual exponents that the validation clips choose from, after the acoustic scale was chosen at the first.
const VISUAL_EXPONENTS: [f32; 5] = [0.0, 0.01, 0.03, 0.1, 1.0];
/// EM iterations that they choose from: up to this many.
const MOST_ITERATIONS: usize = 5;

/// The exponents and the number of iterations with the smallest error of conversion by means on the `judges`.
pub(super) fn conversion(
    hmm: &Hmm,
    judges: &impl Source,
    settings: &TrainSettings,
    progress: &dyn Progress,
) -> Result<EmSettings> {
    let inverter = Inverter::new(*hmm);
    let mut best = (f64::INFINITY, EmSettings::default());
    let judge = |acoustic_scale: f32, visual_exponent: f32, best: &mut (f64, EmSettings)| -> Result<()> {
        let with = EmSettings {
            acoustic_scale,
            visual_exponent,
            iterations: MOST_ITERATIONS,
            m_step: MStep::Exact,
        };
        let size = hmm.visual.mean.dim().2;
        let mut scores = vec![Score::new(size); MOST_ITERATIONS + 1];
        let estimates = |n: usize| {
            let u = judges.get(n)?;
            let estimates = inverter.iterations(&u.audio, &with).map_err(Error::other)?;
            Ok((visual(&u)?.clone(), estimates))
        };
        in_order(judges.len(), estimates, |(truth, estimates)| {
            for (score, estimate) in scores.iter_mut().zip(&estimates) {
                score.add(&truth, &smooth(&estimate.parameters));
            }
            Ok(())
        })?;
        for (iterations, score) in scores.iter().enumerate() {
            if score.amse() < best.0 {
                *best = (score.amse(), EmSettings { iterations, ..with });
            }
        }
        let accs: Vec<String> = scores.iter().map(|s| format!("{:.3}", s.acc())).collect();
        progress.say(&format!(
            "  means: acoustic scale {acoustic_scale}, visual exponent {visual_exponent}: ACC per iteration {}",
            accs.join(" ")
        ));
        Ok(())
    };
    for &acoustic_scale in &settings.acoustic_scales {
        judge(acoustic_scale, VISUAL_EXPONENTS[0], &mut best)?;
    }
    let acoustic_scale = best.1.acoustic_scale;
    for exponent in &VISUAL_EXPONENTS[1..] {
        judge(acoustic_scale, *exponent, &mut best)?;
    }
    progress.say(&format!(
        "  means: visual exponent {}, {} iterations: AMSE {:.2}",
        best.1.visual_exponent, best.1.iterations, best.0
    ));
    Ok(best.1)
}
