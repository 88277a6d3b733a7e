//! Conversion in floats: the phone loop followed by the sound alone, and the local linear maps that it chooses
//! (`docs/design.md` sections 5 and 6): what `core` does in integers, without beam or rounding. Systems that speak by means are
//! in [`super::inversion`].
use ndarray::{Array2, Axis, s};

use super::inversion::Inverter;
use crate::hmm::Hmm;
use crate::hmm::evaluator::Evaluator;
use crate::hmm::forward_backward::{forward, forward_from};
use crate::hmm::graph::Graph;
use crate::hmm::joint::N_EMITTING;
use crate::hmm::system::Speech;
use crate::hmm::topology::VisualAtom;
use crate::kinds::likelihood::local_linear;
use crate::kinds::likelihood::{Model, NotFinite};
use crate::phones::VISEMES;

/// What conversion returns.
type Result<T, E = NotFinite> = std::result::Result<T, E>;

/// How much of the future an occupancy may know.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lag {
    /// The whole utterance.
    Whole,
    /// So many frames.
    Frames(usize),
}

/// An HMM laid out over the phone loop, ready to follow speech.
pub struct Follower {
    graph: Graph,
    probability: Vec<f64>,
    audio: Evaluator,
    n_audio_states: usize,
    n_visual_states: usize,
    acoustic_scale: f64,
}

impl Follower {
    /// Lays out `hmm`; `acoustic_scale` is the exponent of the audio likelihood.
    pub fn new(hmm: &Hmm, acoustic_scale: f32) -> Self {
        let (graph, probability) = hmm.phone_loop();
        Self {
            graph,
            probability,
            audio: Evaluator::new(hmm.audio),
            n_audio_states: hmm.phones.len() * N_EMITTING,
            n_visual_states: hmm.n_visual_states(),
            acoustic_scale: f64::from(acoustic_scale),
        }
    }

    /// Lays out the model's HMM, with the model's own acoustic scale.
    pub fn of_model(model: &Model) -> Self {
        Self::new(&Hmm::of_model(model), model.following.acoustic_scale)
    }

    /// ln b_a(o) of every audio state, `[frames, 5·phones]`, without the acoustic scale.
    pub fn log_likelihoods(&self, observations: &Array2<f32>) -> Array2<f32> {
        let states: Vec<usize> = (0..self.n_audio_states).collect();
        self.audio.log_likelihoods(&states, observations.view())
    }

    /// Occupancies of the audio states `[frames, 5·phones]` and of the visual states `[frames, visual states]`.
    pub fn occupancies(&self, observations: &Array2<f32>, lag: Lag) -> Result<(Array2<f32>, Array2<f32>)> {
        self.occupancies_of(&self.log_likelihoods(observations), lag)
    }

    /// [`Self::occupancies`] where [`Self::log_likelihoods`] are at hand, which do not depend on the acoustic scale.
    pub fn occupancies_of(&self, log: &Array2<f32>, lag: Lag) -> Result<(Array2<f32>, Array2<f32>)> {
        let frames = log.nrows();
        let mut audio = Array2::zeros((frames, self.n_audio_states));
        let mut visual = Array2::zeros((frames, self.n_visual_states));
        if frames == 0 {
            return Ok((audio, visual));
        }
        let emission =
            |t: usize, s: usize| self.acoustic_scale * f64::from(log[[t, self.graph.states[s].audio]]);
        let forward = forward(&self.graph, &self.probability, frames, &emission).ok_or(NotFinite)?;
        let gamma = match lag {
            Lag::Whole => forward.backward(&self.graph, &self.probability, |_, _, _| ()),
            Lag::Frames(lag) => forward.fixed_lag(&self.graph, &self.probability, lag),
        };
        for (t, row) in gamma.outer_iter().enumerate() {
            for (state, &occupancy) in self.graph.states.iter().zip(row) {
                audio[[t, state.audio]] += occupancy as f32;
                visual[[t, state.visual]] += occupancy as f32;
            }
        }
        Ok((audio, visual))
    }

    /// Forward variables `[frames, joint states]` and occupancies of the visual states of a piece of a stream, on from the forward
    /// variables of the frame before it. The last `lag` frames' occupancies know less than they should. None where the observations
    /// are not finite.
    pub fn piece(
        &self,
        before: Option<&[f64]>,
        observations: &Array2<f32>,
        lag: usize,
    ) -> Option<(Array2<f64>, Array2<f32>)> {
        let frames = observations.nrows();
        let log = self.log_likelihoods(observations);
        let emission =
            |t: usize, s: usize| self.acoustic_scale * f64::from(log[[t, self.graph.states[s].audio]]);
        let forward = forward_from(&self.graph, &self.probability, before, frames, &emission)?;
        let gamma = forward.fixed_lag(&self.graph, &self.probability, lag);
        let mut visual = Array2::zeros((frames, self.n_visual_states));
        for (t, row) in gamma.outer_iter().enumerate() {
            for (state, &occupancy) in self.graph.states.iter().zip(row) {
                visual[[t, state.visual]] += occupancy as f32;
            }
        }
        Some((forward.alpha, visual))
    }
}

/// Mouth parameters `[frames, D]` and viseme weights `[frames, 13]` of one utterance's observations `[frames, 39]`,
/// spoken as the model's system speaks. Systems without a lag hear the whole utterance.
pub fn convert(model: &Model, observations: &Array2<f32>, lag: Lag) -> Result<(Array2<f32>, Array2<f32>)> {
    convert_as(model, model.system.speech, observations, lag)
}

/// [`convert`], spoken in another way than the model's own: a model holds what all of them need.
pub fn convert_as(
    model: &Model,
    speech: Speech,
    observations: &Array2<f32>,
    lag: Lag,
) -> Result<(Array2<f32>, Array2<f32>)> {
    match speech {
        Speech::LocalLinear => convert_with(&Follower::of_model(model), model, observations, lag),
        Speech::Means => {
            let inverter = Inverter::new(Hmm::of_model(model));
            let (spoken, visual) = inverter.convert(observations, &model.conversion)?;
            Ok((smooth(&spoken), viseme_weights(model, &visual)))
        }
        Speech::Posterior => {
            let inverter = Inverter::new(Hmm::of_model(model));
            let (spoken, visual) =
                inverter.posterior_mean(observations, model.posterior_scale, Lag::Whole)?;
            Ok((smooth(&spoken), viseme_weights(model, &visual)))
        }
        Speech::Viterbi => {
            let inverter = Inverter::new(Hmm::of_model(model));
            let spoken = inverter.best_path(observations, model.conversion.acoustic_scale)?;
            let (_, visual) = Follower::of_model(model).occupancies(observations, Lag::Whole)?;
            Ok((smooth(&spoken), viseme_weights(model, &visual)))
        }
    }
}

/// Local linear conversion with a follower that is kept for many utterances.
pub fn convert_with(
    follower: &Follower,
    model: &Model,
    observations: &Array2<f32>,
    lag: Lag,
) -> Result<(Array2<f32>, Array2<f32>)> {
    let (spoken, visual) = apply_maps(follower, model, observations, lag)?;
    Ok((smooth(&spoken), viseme_weights(model, &visual)))
}

/// What the local linear maps say, not averaged yet, and the occupancies of the visual states.
pub fn apply_maps(
    follower: &Follower,
    model: &Model,
    observations: &Array2<f32>,
    lag: Lag,
) -> Result<(Array2<f32>, Array2<f32>)> {
    let (_, visual) = follower.occupancies(observations, lag)?;
    let statics = observations.slice(s![.., ..lipstream_core::N_STATIC]);
    let x = local_linear::project(&model.context, statics);
    Ok((local_linear::apply(&model.maps, &x, &visual), visual))
}

/// Occupancy of each viseme `[frames, 13]` from those of the model's visual states: the sum over the states of each
/// visual atom, and over the phones of a viseme where the atoms are phones.
pub fn viseme_weights(model: &Model, visual: &Array2<f32>) -> Array2<f32> {
    let mut out = Array2::zeros((visual.nrows(), VISEMES.len()));
    for (state, column) in visual.axis_iter(Axis(1)).enumerate() {
        let atom = state / model.system.topology.states_of_atom();
        let viseme = match model.system.topology.visual {
            VisualAtom::Viseme => atom,
            VisualAtom::Phone | VisualAtom::Pair => usize::from(model.phones[atom].viseme().0),
        };
        let mut weight = out.column_mut(viseme);
        weight += &column;
    }
    out
}

/// Moving average over 3 frames (X&L section 6), edges over what there is.
pub fn smooth(parameters: &Array2<f32>) -> Array2<f32> {
    let frames = parameters.nrows();
    let mut out = parameters.clone();
    for t in 0..frames {
        let (from, to) = (t.saturating_sub(1), (t + 2).min(frames));
        let mean = parameters
            .slice(s![from..to, ..])
            .mean_axis(Axis(0))
            .expect("the window is never empty");
        out.row_mut(t).assign(&mean);
    }
    out
}
