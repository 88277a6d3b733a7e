//! HMMs over a sound and a mouth in floats: graphs of joint states, densities, forward-backward.
//!
//! One graph type, one forward-backward: a system of X&L table 2 is a [`system::System`], that is, which pairs of
//! an audio and a visual state exist, what the visual atoms are, and whether the two streams share their mixtures.
pub mod evaluator;
pub mod forward_backward;
pub mod graph;
pub mod joint;
pub mod mixtures;
pub mod network;
pub mod system;
pub mod topology;

use ndarray::{Array2, Array3};

use crate::hmm::mixtures::Mixtures;
use crate::kinds::likelihood::Model;
use crate::phones::Phone;
use graph::Graph;
use network::PhoneNetwork;
use system::Density;
use topology::Topology;

/// A trained HMM, borrowed from a model or from training.
#[derive(Clone, Copy)]
pub struct Hmm<'a> {
    /// Which joint states exist.
    pub topology: Topology,
    /// How the two observations of a joint state are modelled.
    pub density: Density,
    /// Phones in table order.
    pub phones: &'a [Phone],
    /// One mixture per audio state: 5·phone + i.
    pub audio: &'a Mixtures,
    /// One mixture per visual state: 5·viseme + j, or 5·phone + j where both chains are over phones.
    pub visual: &'a Mixtures,
    /// Natural log, `[phones, classes, 4]`.
    pub transition: &'a Array3<f32>,
    /// Natural log, `[phones]`.
    pub initial: &'a [f32],
    /// Natural log, `[phones, phones]`.
    pub bigram: &'a Array2<f32>,
}

impl<'a> Hmm<'a> {
    /// The HMM in a likelihood-trained model.
    pub fn of_model(model: &'a Model) -> Self {
        Self {
            topology: model.system.topology,
            density: model.system.density,
            phones: &model.phones,
            audio: &model.audio,
            visual: &model.visual,
            transition: &model.transition,
            initial: model.initial.as_slice().expect("a vector stands in one piece"),
            bigram: &model.bigram,
        }
    }

    /// The loop over all phones, and the probability of each arc.
    pub fn phone_loop(&self) -> (Graph, Vec<f64>) {
        let network = PhoneNetwork::phone_loop(self.initial, self.bigram);
        let graph = Graph::build(&network, self.topology, self.phones);
        let probability = graph.probabilities(self.transition);
        (graph, probability)
    }

    /// Number of visual states.
    pub fn n_visual_states(&self) -> usize {
        self.topology.n_visual_states(self.phones.len())
    }
}
