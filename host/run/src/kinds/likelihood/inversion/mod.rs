//! Conversion by means (X&L section 4): the mouth that is likeliest under the HMM and the sound, found by EM from
//! the best path's centres; the old way, those centres themselves; and the mean of the mouth given the sound (`posterior.rs`).
//!
//! E step: γ_t(v, k) by forward-backward over the phone loop, given oᵃ and the present ôᵛ.
//! M step: ôᵛ_t = [Σ γ_t(v,k) Σ⁻¹_vk]⁻¹ Σ γ_t(v,k) Σ⁻¹_vk μ_vk (eq. 9 without its second weight; `docs/design.md` section 5).
//!
//! The streams' likelihoods have exponents: α on the sound (frames overlap, so that they are not independent) and κ on
//! the mouth. EM climbs Σ_q P(q) Π b_a(oᵃ)^α b_v(ôᵛ)^κ for any of them: ln b_v^κ = κ ln Σ_k, whose lower bound the M step
//! maximises whatever κ is.
use ndarray::{Array2, Array3, Axis, s};

use crate::hmm::Hmm;
use crate::hmm::evaluator::Evaluator;
use crate::hmm::forward_backward::{Forward, forward_from, viterbi, viterbi_within};
use crate::hmm::graph::{Graph, log_sum};
use crate::hmm::mixtures::Mixtures;
use crate::hmm::system::Density;
use crate::kinds::likelihood::{EmSettings, MStep, NotFinite};

mod live;
mod posterior;

/// What conversion returns.
type Result<T, E = NotFinite> = std::result::Result<T, E>;

/// A mouth during EM, and how likely it is.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// `[frames, D]`
    pub parameters: Array2<f32>,
    /// ln P(Oᵃ, Ôᵛ) per frame, with the streams' exponents.
    pub log_likelihood: f64,
}

/// An HMM laid out over the phone loop, ready to convert.
pub struct Inverter {
    /// Whether densities are of sound and mouth together.
    joint: bool,
    /// Densities of the mouth.
    mixtures: Mixtures,
    graph: Graph,
    probability: Vec<f64>,
    audio: Evaluator,
    visual: Evaluator,
    /// Mean of every visual state's mixture, `[states, D]`.
    centre: Array2<f32>,
}

/// Log likelihoods of one utterance's sound under one exponent.
struct Heard {
    /// `[frames, audio states]`, times α.
    state: Array2<f32>,
    /// `[frames, audio states, K]` where densities are joint: ln w_k N_k(oᵃ), times α.
    component: Option<Array3<f32>>,
}

impl Heard {
    /// Frames `first` to `last`.
    fn part(&self, first: usize, last: usize) -> Self {
        let component = self.component.as_ref();
        Self {
            state: self.state.slice(s![first..=last, ..]).to_owned(),
            component: component.map(|c| c.slice(s![first..=last, .., ..]).to_owned()),
        }
    }
}

impl Inverter {
    /// Lays out `hmm` over the phone loop.
    pub fn new(hmm: Hmm) -> Self {
        let (graph, probability) = hmm.phone_loop();
        let visual = match hmm.density {
            Density::Streams => Evaluator::new(hmm.visual),
            // The weight of a joint component stands with its sound.
            Density::Joint => Evaluator::new(&unweighted(hmm.visual)),
        };
        Self {
            audio: Evaluator::new(hmm.audio),
            visual,
            centre: centres(hmm.visual),
            joint: hmm.density == Density::Joint,
            mixtures: hmm.visual.clone(),
            graph,
            probability,
        }
    }

    fn hear(&self, observations: &Array2<f32>, scale: f32) -> Heard {
        let (state, component) = self.audio.log_components(observations.view());
        Heard {
            state: state * scale,
            component: self.joint.then(|| component * scale),
        }
    }

    /// The centres of the visual states on the best path through the sound (the "Viterbi single-state" way).
    pub fn best_path(&self, observations: &Array2<f32>, acoustic_scale: f32) -> Result<Array2<f32>> {
        self.centres_of_path(&self.hear(observations, acoustic_scale))
    }

    fn centres_of_path(&self, heard: &Heard) -> Result<Array2<f32>> {
        let frames = heard.state.nrows();
        if frames == 0 {
            return Ok(self.centres_on(&[]));
        }
        let emission = |t: usize, s: usize| f64::from(heard.state[[t, self.graph.states[s].audio]]);
        let (path, _) = viterbi(&self.graph, &self.probability, frames, &emission).ok_or(NotFinite)?;
        Ok(self.centres_on(&path))
    }

    /// The centres of the visual states on a path.
    fn centres_on(&self, path: &[usize]) -> Array2<f32> {
        let mut out = Array2::zeros((path.len(), self.centre.ncols()));
        for (mut row, &s) in out.outer_iter_mut().zip(path) {
            row.assign(&self.centre.row(self.graph.states[s].visual));
        }
        out
    }

    /// The mouth after `settings.iterations` of EM, `[frames, D]`, and the viseme occupancies of the last E step,
    /// `[frames, visual states]`.
    pub fn convert(
        &self,
        observations: &Array2<f32>,
        settings: &EmSettings,
    ) -> Result<(Array2<f32>, Array2<f32>)> {
        let heard = self.hear(observations, settings.acoustic_scale);
        let mut mouth = self.centres_of_path(&heard)?;
        let mut occupancy = Array2::zeros((mouth.nrows(), self.centre.nrows()));
        for _ in 0..settings.iterations {
            let step = self.step(&heard, &mouth, settings)?;
            (mouth, occupancy) = (step.next, step.occupancy);
        }
        if settings.iterations == 0 {
            occupancy = self.step(&heard, &mouth, settings)?.occupancy;
        }
        Ok((mouth, occupancy))
    }

    /// [`Self::best_path`] as a stream knows it `lag` frames later.
    pub fn best_path_within(
        &self,
        observations: &Array2<f32>,
        acoustic_scale: f32,
        lag: usize,
    ) -> Result<Array2<f32>> {
        self.centres_within(&self.hear(observations, acoustic_scale), lag)
    }

    fn centres_within(&self, heard: &Heard, lag: usize) -> Result<Array2<f32>> {
        let frames = heard.state.nrows();
        let emission = |t: usize, s: usize| f64::from(heard.state[[t, self.graph.states[s].audio]]);
        let path = viterbi_within(&self.graph, &self.probability, frames, &emission, lag).ok_or(NotFinite)?;
        Ok(self.centres_on(&path))
    }

    /// [`Self::convert`] with a future of `lag` frames: the iterations share it, and begin at the centres of the states
    /// that are best so far.
    pub fn convert_within(
        &self,
        observations: &Array2<f32>,
        settings: &EmSettings,
        lag: usize,
    ) -> Result<Array2<f32>> {
        let heard = self.hear(observations, settings.acoustic_scale);
        if settings.iterations == 0 {
            return self.centres_within(&heard, lag);
        }
        let mut mouth = self.centres_within(&heard, 0)?;
        for n in 0..settings.iterations {
            // Where the frames cannot be shared evenly, the later iterations have more.
            let share = lag * (n + 1) / settings.iterations - lag * n / settings.iterations;
            mouth = self.step_within(&heard, &mouth, settings, Some(share))?.next;
        }
        Ok(mouth)
    }

    /// Every estimate from the path's centres on, with its likelihood: `settings.iterations` + 1 of them.
    pub fn iterations(&self, observations: &Array2<f32>, settings: &EmSettings) -> Result<Vec<Estimate>> {
        let heard = self.hear(observations, settings.acoustic_scale);
        let mut parameters = self.centres_of_path(&heard)?;
        let mut all = Vec::new();
        for _ in 0..=settings.iterations {
            let step = self.step(&heard, &parameters, settings)?;
            all.push(Estimate {
                parameters: std::mem::replace(&mut parameters, step.next),
                log_likelihood: step.log_likelihood,
            });
        }
        Ok(all)
    }

    /// One E and one M step from `mouth`.
    fn step(&self, heard: &Heard, mouth: &Array2<f32>, settings: &EmSettings) -> Result<Step> {
        self.step_within(heard, mouth, settings, None)
    }

    /// [`Self::step`] where occupancies know `lag` frames of the future; none: all of it.
    fn step_within(
        &self,
        heard: &Heard,
        mouth: &Array2<f32>,
        settings: &EmSettings,
        lag: Option<usize>,
    ) -> Result<Step> {
        let frames = mouth.nrows();
        let (state, component) = self.see(heard, mouth, settings.visual_exponent);
        let forward = self.follow(heard, &state, None, frames)?;
        let gamma = match lag {
            None => forward.backward(&self.graph, &self.probability, |_, _, _| ()),
            Some(lag) => forward.fixed_lag(&self.graph, &self.probability, lag),
        };
        let (occupancy, next) = self.maximise(&gamma, &component, settings.m_step);
        Ok(Step {
            next,
            occupancy,
            log_likelihood: forward.log_likelihood / frames.max(1) as f64,
        })
    }

    /// ln b_v(ôᵛ)^κ of every state, ready to be an emission (with the sound where densities are joint), and the logs of its
    /// components.
    fn see(&self, heard: &Heard, mouth: &Array2<f32>, kappa: f32) -> (Array2<f32>, Array3<f32>) {
        // ln w_k N_k(ôᵛ) of every component, without κ.
        let (mut state, mut component) = self.visual.log_components(mouth.view());
        match &heard.component {
            None => state *= kappa,
            Some(sound) => {
                ndarray::Zip::from(&mut component)
                    .and(sound)
                    .for_each(|part, &heard| {
                        *part = if heard > f32::NEG_INFINITY {
                            kappa * *part + heard
                        } else {
                            heard
                        };
                    });
                for ((t, s), log) in state.indexed_iter_mut() {
                    *log = log_sum(component.slice(s![t, s, ..]).iter().copied());
                }
            }
        }
        (state, component)
    }

    fn emission(&self, heard: &Heard, state: &Array2<f32>, t: usize, s: usize) -> f64 {
        let at = self.graph.states[s];
        let sound = if heard.component.is_some() {
            0.0
        } else {
            f64::from(heard.state[[t, at.audio]])
        };
        sound + f64::from(state[[t, at.visual]])
    }

    /// Occupancies of the visual states, `[frames, visual states]`, from those of the joint states.
    fn visual_occupancy(&self, gamma: &Array2<f64>) -> Array2<f32> {
        let mut occupancy = Array2::<f32>::zeros((gamma.nrows(), self.centre.nrows()));
        for (t, row) in gamma.outer_iter().enumerate() {
            for (s, &g) in self.graph.states.iter().zip(row) {
                occupancy[[t, s.visual]] += g as f32;
            }
        }
        occupancy
    }

    /// Occupancies of the visual states `[frames, visual states]`, and the M step: the mouth `[frames, D]`.
    fn maximise(
        &self,
        gamma: &Array2<f64>,
        component: &Array3<f32>,
        how: MStep,
    ) -> (Array2<f32>, Array2<f32>) {
        let (states, k, size) = self.mixtures.mean.dim();
        let frames = gamma.nrows();
        let occupancy = self.visual_occupancy(gamma);
        let mut next = Array2::<f32>::zeros((frames, size));
        let (mut precision, mut weighted) = (vec![0.0f64; size], vec![0.0f64; size]);
        for t in 0..frames {
            precision.fill(0.0);
            weighted.fill(0.0);
            for s in 0..states {
                let share = occupancy[[t, s]];
                if share < LEAST_OCCUPANCY {
                    continue;
                }
                let total = log_sum(component.slice(s![t, s, ..]).iter().copied());
                for k in 0..k {
                    let mut gamma = f64::from(share) * f64::from((component[[t, s, k]] - total).exp());
                    if how == MStep::Printed {
                        gamma *= f64::from(self.mixtures.log_weight[[s, k]]).exp();
                    }
                    if gamma > 0.0 {
                        for i in 0..size {
                            let p = gamma / f64::from(self.mixtures.variance[[s, k, i]]);
                            precision[i] += p;
                            weighted[i] += p * f64::from(self.mixtures.mean[[s, k, i]]);
                        }
                    }
                }
            }
            for i in 0..size {
                next[[t, i]] = (weighted[i] / precision[i]) as f32;
            }
        }
        (occupancy, next)
    }

    /// [`Self::see`] where no mouth has been seen: what sound alone says of each visual state.
    fn unseen(&self, heard: &Heard) -> Array2<f32> {
        let states = self.centre.nrows();
        Array2::from_shape_fn((heard.state.nrows(), states), |(t, s)| {
            heard
                .component
                .as_ref()
                .map_or(0.0, |sound| log_sum(sound.slice(s![t, s, ..]).iter().copied()))
        })
    }

    /// The forward pass over a window, on from the frame before it.
    fn follow(
        &self,
        heard: &Heard,
        state: &Array2<f32>,
        before: Option<&[f64]>,
        length: usize,
    ) -> Result<Forward> {
        let emission = |t: usize, s: usize| self.emission(heard, state, t, s);
        forward_from(&self.graph, &self.probability, before, length, &emission).ok_or(NotFinite)
    }
}

/// An occupancy this small moves no mean by a visible amount, and the likelihood by less than what is asserted.
const LEAST_OCCUPANCY: f32 = 1e-7;

struct Step {
    next: Array2<f32>,
    occupancy: Array2<f32>,
    /// Of the mouth that the step started from, per frame.
    log_likelihood: f64,
}

/// The same components with weight one; those that are not used stay so.
fn unweighted(mixtures: &Mixtures) -> Mixtures {
    let mut out = mixtures.clone();
    out.log_weight
        .mapv_inplace(|w| if w > Mixtures::NO_WEIGHT { 0.0 } else { w });
    out
}

/// Σ_k w_k μ_k of every state, `[states, D]`.
pub fn centres(mixtures: &Mixtures) -> Array2<f32> {
    let (states, k, d) = mixtures.mean.dim();
    let mut out = Array2::zeros((states, d));
    for s in 0..states {
        for k in 0..k {
            let weight = mixtures.log_weight[[s, k]].exp();
            let mean = mixtures.mean.index_axis(Axis(0), s);
            out.row_mut(s).scaled_add(weight, &mean.index_axis(Axis(0), k));
        }
    }
    out
}
