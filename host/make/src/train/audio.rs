//! The second stage (X&L section 3.4): the audio densities on many speakers, and what phones that the video lacks are
//! given: their sound from the other speakers, their look from their viseme.
use ndarray::{Array3, Axis};

use super::TrainSettings;
use super::data::{Clips, Observed};
use super::em::{Aligned, Coupled, Learnt, passes};
use crate::em::{Parameters, Start};
use crate::error::Result;
use lipstream::hmm::joint::N_EMITTING;
use lipstream::hmm::mixtures::Mixtures;
use lipstream::hmm::topology::VisualAtom;
use lipstream::progress::Progress;

/// Which phones the clips' networks hold.
pub(super) fn seen(train: &Clips, n: usize) -> Vec<bool> {
    let mut seen = vec![false; n];
    let nodes = train.networks().flat_map(|network| network.nodes);
    nodes.for_each(|p| seen[p] = true);
    seen
}

/// Transitions of phones that were never seen with video: the mean of those that were, class by class.
pub(super) fn pool_unseen(parameters: &Parameters, seen: &[bool]) -> Array3<f32> {
    let n = parameters.phones.len();
    let mut out = parameters.transition.clone();
    let known = seen.iter().filter(|s| **s).count().max(1) as f32;
    for class in 0..parameters.topology.classes_per_phone() {
        let allowed = parameters.topology.allowed(class);
        for c in (0..4).filter(|&c| allowed[c]) {
            let mean = (0..n)
                .filter(|&p| seen[p])
                .map(|p| out[[p, class, c]].exp())
                .sum::<f32>()
                / known;
            (0..n)
                .filter(|&p| !seen[p])
                .for_each(|p| out[[p, class, c]] = mean.ln());
        }
    }
    out
}

/// Visual densities where both chains are over phones: those of a phone that the video lacks become one Gaussian with
/// the mean and variance of all frames that its viseme's phones have in the same state.
pub(super) fn look_of_viseme(coupled: &mut Coupled, seen: &[bool]) {
    let parameters = &mut coupled.parameters;
    let Some(visual) = &mut parameters.visual else {
        return;
    };
    if parameters.topology.visual == VisualAtom::Viseme {
        return;
    }
    let (_, k, size) = visual.mean.dim();
    let frames = &coupled.aligned.visual_frames;
    for (p, phone) in parameters.phones.iter().enumerate().filter(|(p, _)| !seen[*p]) {
        let states = parameters.topology.states_of_atom();
        for j in 0..states {
            let (mut n, mut first, mut second) = (0.0, vec![0.0; size], vec![0.0; size]);
            for (q, other) in parameters.phones.iter().enumerate() {
                if !seen[q] || other.viseme() != phone.viseme() {
                    continue;
                }
                let from = states * q + j;
                for k in 0..k {
                    let share = frames[from] * f64::from(visual.log_weight[[from, k]]).exp();
                    n += share;
                    for i in 0..size {
                        let mean = f64::from(visual.mean[[from, k, i]]);
                        first[i] += share * mean;
                        second[i] += share * (mean * mean + f64::from(visual.variance[[from, k, i]]));
                    }
                }
            }
            if n < 1.0 {
                continue;
            }
            let to = states * p + j;
            for i in 0..size {
                let mean = first[i] / n;
                visual.mean[[to, 0, i]] = mean as f32;
                visual.variance[[to, 0, i]] = (second[i] / n - mean * mean).max(1e-6) as f32;
            }
            visual.log_weight.row_mut(to).fill(Mixtures::NO_WEIGHT);
            visual.log_weight[[to, 0]] = 0.0;
        }
    }
}

/// Where the audio HMM alone starts, and what it is trained on: the clips with video by the coupled model's alignment, the
/// other speakers by their labels.
pub(super) fn all_speakers<'a>(
    aligned: Aligned,
    train: &Clips<'a>,
    heard: &Clips<'a>,
) -> Result<(Start, Clips<'a>)> {
    let mut start = aligned.sound;
    start.add_all(heard)?;
    let mut clips = train.observed(Observed::Sound);
    clips.keep(&aligned.fits);
    clips.extend(heard);
    Ok((start, clips))
}

/// The audio HMM alone: the components that the clips with video have grown are kept and re-estimated on everybody, in every
/// system alike. Grown anew they would follow the speakers and no longer the talker's own contexts, which the mouth
/// follows; where densities are joint they are the mouth's components besides.
pub(super) fn retrain(
    before: &Parameters,
    seen: &[bool],
    (start, clips): (Start, Clips),
    settings: &TrainSettings,
    progress: &dyn Progress,
) -> Result<Mixtures> {
    let (mut parameters, floors, _) = start.finish();
    parameters.audio = keep_components(&before.audio, &parameters.audio, seen);
    let learnt = Learnt {
        audio: Some(floors),
        visual: None,
    };
    passes(&mut parameters, &clips, &learnt, settings, progress)?;
    Ok(parameters.audio)
}

/// `grown` where the video had the phone, else one component from the single Gaussians of `single`.
fn keep_components(grown: &Mixtures, single: &Mixtures, seen: &[bool]) -> Mixtures {
    let mut out = grown.clone();
    for (p, _) in seen.iter().enumerate().filter(|(_, seen)| !**seen) {
        for state in N_EMITTING * p..N_EMITTING * (p + 1) {
            for (to, from) in [
                (&mut out.mean, &single.mean),
                (&mut out.variance, &single.variance),
            ] {
                to.index_axis_mut(Axis(0), state)
                    .row_mut(0)
                    .assign(&from.index_axis(Axis(0), state).row(0));
            }
            out.log_weight.row_mut(state).fill(Mixtures::NO_WEIGHT);
            out.log_weight[[state, 0]] = 0.0;
        }
    }
    out
}
