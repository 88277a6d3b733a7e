//! Mixtures grown by splitting, one chain's after the other's, as long as the validation clips grow likelier.
use rand::SeedableRng;
use rand_pcg::Pcg64;

use super::TrainSettings;
use super::data::Clips;
use super::em::{Learnt, passes};
use crate::em::density::{self, Accumulator};
use crate::em::source::Source;
use crate::em::{self, Parameters, Sums};
use crate::error::Result;
use lipstream::hmm::mixtures::Mixtures;
use lipstream::progress::Progress;

/// Frames that a component must have before it is split.
pub(super) const ENOUGH_TO_SPLIT: f64 = 30.0;

/// Whose components are split.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Chain {
    /// The sound's, or those of joint densities.
    Sound,
    Mouth,
}

/// Grows mixtures from `parameters`, with EM passes after every split; prints the log likelihood of each. A split stays only
/// if the validation clips are likelier with it, and each chain stops by itself: the two need different numbers. Without
/// validation clips the settings' most is what is grown.
pub(super) fn grow(
    mut parameters: Parameters,
    learnt: &Learnt,
    train: &Clips,
    validation: &Clips,
    settings: &TrainSettings,
    progress: &dyn Progress,
) -> Result<Parameters> {
    let mut signs = (settings.seed != 0).then(|| Pcg64::seed_from_u64(settings.seed));
    let judge = |parameters: &Parameters| -> Result<Option<f64>> {
        if validation.is_empty() {
            return Ok(None);
        }
        let unseen = em::expect(parameters, validation)?.per_frame();
        progress.say(&format!("  validation clips: {unseen:.4} a frame"));
        Ok(Some(unseen))
    };
    let mut sums = passes(&mut parameters, train, learnt, settings, progress)?;
    let mut likeliest = judge(&parameters)?;
    let mut open = Vec::new();
    if learnt.audio.is_some() {
        open.push(Chain::Sound);
    }
    if learnt.visual.is_some() {
        open.push(Chain::Mouth);
    }
    while !open.is_empty() {
        for chain in open.clone() {
            let mut wider = parameters.clone();
            let mut stays = split(&mut wider, &sums, chain, settings, signs.as_mut());
            if stays {
                let wider_sums = passes(&mut wider, train, learnt, settings, progress)?;
                let unseen = judge(&wider)?;
                stays = unseen.zip(likeliest).is_none_or(|(now, before)| now > before);
                if stays {
                    (parameters, sums, likeliest) = (wider, wider_sums, unseen);
                }
            }
            if !stays {
                open.retain(|other| *other != chain);
            }
        }
    }
    Ok(parameters)
}

/// Splits the components of a chain; false where there may not be more, or none has enough frames.
fn split(
    parameters: &mut Parameters,
    sums: &Sums,
    chain: Chain,
    settings: &TrainSettings,
    signs: Option<&mut Pcg64>,
) -> bool {
    let (mixtures, sums, most): (&mut Mixtures, &Accumulator, usize) = match chain {
        Chain::Sound => (&mut parameters.audio, &sums.audio, settings.audio_mixtures),
        Chain::Mouth => match (&mut parameters.visual, &sums.visual) {
            (Some(mixtures), Some(sums)) => (mixtures, sums, settings.visual_mixtures),
            _ => return false,
        },
    };
    if mixtures.mean.dim().1 >= most {
        return false;
    }
    let used = |m: &Mixtures| m.log_weight.iter().filter(|w| **w > Mixtures::NO_WEIGHT).count();
    let before = used(mixtures);
    *mixtures = density::split(mixtures, sums, ENOUGH_TO_SPLIT, signs);
    used(mixtures) > before
}
