//! Conversion in floats: the phone loop followed by the audio alone, and the local linear maps it chooses
//! (DESIGN sections 5 and 6). What `core` does in integers, without beam or rounding.
use anyhow::{Result, bail};
use ndarray::{Array2, Axis, s};

use super::density::Evaluator;
use super::forward_backward::forward;
use super::graph::Graph;
use super::network::PhoneNetwork;
use super::topology::Topology;
use crate::local_linear;
use crate::model::{Mixtures, Model, N_EMITTING};
use crate::phones::{Phone, VISEMES};

/// How much of the future an occupancy may know.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lag {
    /// The whole utterance.
    Whole,
    /// So many frames.
    Frames(usize),
}

/// A model laid out over the phone loop, ready to follow speech.
pub struct Follower {
    graph: Graph,
    probability: Vec<f64>,
    audio: Evaluator,
    n_audio_states: usize,
    acoustic_scale: f64,
}

impl Follower {
    /// From the parts of a model; `transition` is `[phones, 15, 4]`, natural logs throughout.
    pub fn new(
        phones: &[Phone],
        audio: &Mixtures,
        transition: &ndarray::Array3<f32>,
        initial: &[f32],
        bigram: &Array2<f32>,
        acoustic_scale: f32,
    ) -> Self {
        let network = PhoneNetwork::phone_loop(initial, bigram);
        let graph = Graph::build(&network, Topology::PH_VI_CHMM, phones);
        let probability = graph.probabilities(transition);
        Self {
            graph,
            probability,
            audio: Evaluator::new(audio),
            n_audio_states: phones.len() * N_EMITTING,
            acoustic_scale: f64::from(acoustic_scale),
        }
    }

    pub fn of_model(model: &Model) -> Self {
        Self::new(
            &model.phones,
            &model.audio,
            &model.transition,
            &model.initial.to_vec(),
            &model.bigram,
            model.following.acoustic_scale,
        )
    }

    /// Occupancies of the audio states `[frames, 5·phones]` and of the visual states `[frames, 65]`.
    pub fn occupancies(&self, observations: &Array2<f32>, lag: Lag) -> Result<(Array2<f32>, Array2<f32>)> {
        let frames = observations.nrows();
        let mut audio = Array2::zeros((frames, self.n_audio_states));
        let mut visual = Array2::zeros((frames, VISEMES.len() * N_EMITTING));
        if frames == 0 {
            return Ok((audio, visual));
        }
        let states: Vec<usize> = (0..self.n_audio_states).collect();
        let log = self.audio.log_likelihoods(&states, observations.view());
        let emission =
            |t: usize, s: usize| self.acoustic_scale * f64::from(log[[t, self.graph.states[s].audio]]);
        let Some(forward) = forward(&self.graph, &self.probability, frames, &emission) else {
            bail!("the audio observations are not finite");
        };
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
}

/// Mouth parameters `[frames, D]` and viseme weights `[frames, 13]` of one utterance's observations `[frames, 39]`.
pub fn convert(model: &Model, observations: &Array2<f32>, lag: Lag) -> Result<(Array2<f32>, Array2<f32>)> {
    convert_with(&Follower::of_model(model), model, observations, lag)
}

/// [`convert`] with a follower that is kept for many utterances.
pub fn convert_with(
    follower: &Follower,
    model: &Model,
    observations: &Array2<f32>,
    lag: Lag,
) -> Result<(Array2<f32>, Array2<f32>)> {
    let (_, visual) = follower.occupancies(observations, lag)?;
    let statics = observations.slice(s![.., ..lipstream_core::N_STATIC]);
    let x = local_linear::project(&model.context, statics);
    let spoken = smooth(&local_linear::apply(&model.maps, &x, &visual));
    Ok((spoken, viseme_weights(&visual)))
}

/// Occupancy of each viseme: the sum over its five states.
pub fn viseme_weights(visual: &Array2<f32>) -> Array2<f32> {
    let frames = visual.nrows();
    let by_viseme = visual
        .to_shape((frames, VISEMES.len(), N_EMITTING))
        .expect("five states of each viseme stand side by side");
    by_viseme.sum_axis(Axis(2))
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
