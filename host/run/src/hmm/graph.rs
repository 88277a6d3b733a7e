//! Joint states and arcs (`docs/design.md` section 3): a phone network unrolled into pairs of an audio and a visual state.
use std::collections::HashMap;

use ndarray::Array3;

use super::network::PhoneNetwork;
use super::topology::{Pairing, Topology};
use crate::hmm::joint::{N_EMITTING, choice};
use crate::phones::Phone;

/// A pair of states, with the row of the transition table that governs it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JointState {
    /// 5·phone + i.
    pub audio: usize,
    /// 5·atom + j.
    pub visual: usize,
    /// Phone of the audio state, and class: row (phone, class) of the transition table.
    pub phone: usize,
    /// Transition class of the pair, see [`pair_class`](super::joint::pair_class).
    pub class: usize,
    /// Node of the phone network that the audio state belongs to.
    pub node: usize,
}

/// From one joint state to another (or itself).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arc {
    /// Index of the joint state that it leaves.
    pub from: u32,
    /// Index of the joint state that it enters.
    pub to: u32,
    /// Column of the transition table: what the two chains do.
    pub choice: u8,
    /// Natural log of the network's own probability (bigram, pronunciation).
    pub weight: f32,
}

/// A sparse graph of joint states. Arcs are sorted by `from`.
#[derive(Clone, Debug)]
pub struct Graph {
    /// The joint states; arcs and entries refer to them by index.
    pub states: Vec<JointState>,
    /// The arcs, from a joint state to itself too.
    pub arcs: Vec<Arc>,
    /// `arcs[first[s]..first[s + 1]]` leave state s.
    pub first: Vec<usize>,
    /// Where an utterance begins, with natural log probability.
    pub entries: Vec<(usize, f32)>,
    /// Where it may end; `None`: anywhere.
    pub exits: Option<Vec<usize>>,
}

/// What a joint state is before it has a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Key {
    /// (node, i, j)
    Inside(usize, usize, usize),
    /// (node, atom, i, j): the sound is still in state i of the node while the mouth is in state j of the atom that follows.
    MouthLeads(usize, usize, usize, usize),
    /// (node, atom, i, j): the sound is in state i of the node while the mouth is still in state j of the atom before.
    SoundLeads(usize, usize, usize, usize),
}

impl Graph {
    /// Unrolls `network` over the model's `phones`.
    pub fn build(network: &PhoneNetwork, topology: Topology, phones: &[Phone]) -> Self {
        let mut builder = Builder {
            network,
            topology,
            phones,
            states: Vec::new(),
            found: HashMap::new(),
        };
        let entries: Vec<(usize, f32)> = network
            .entries
            .iter()
            .map(|&(n, w)| (builder.state(Key::Inside(n, 0, 0)), w))
            .collect();
        let mut arcs = Vec::new();
        let mut next = 0;
        while next < builder.states.len() {
            let key = builder.states[next];
            builder.leave(key, &mut |to, choice, weight| {
                arcs.push(Arc {
                    from: next as u32,
                    to: to as u32,
                    choice: choice as u8,
                    weight,
                });
            });
            next += 1;
        }
        let mut first = vec![0; builder.states.len() + 1];
        for arc in &arcs {
            first[arc.from as usize + 1] += 1;
        }
        for s in 0..builder.states.len() {
            first[s + 1] += first[s];
        }
        let exits = (!network.exits.is_empty()).then(|| {
            let last = N_EMITTING - 1;
            network
                .exits
                .iter()
                .filter_map(|&n| builder.found.get(&Key::Inside(n, last, last)).copied())
                .collect()
        });
        let states = builder
            .states
            .iter()
            .map(|&key| builder.joint_state(key))
            .collect();
        Graph {
            states,
            arcs,
            first,
            entries,
            exits,
        }
    }

    /// Probabilities of the arcs under a transition table `[phones, classes, 4]` of natural logs.
    pub fn probabilities(&self, transition: &Array3<f32>) -> Vec<f64> {
        self.arcs
            .iter()
            .map(|arc| {
                let state = self.states[arc.from as usize];
                let log = transition[[state.phone, state.class, usize::from(arc.choice)]];
                (f64::from(log) + f64::from(arc.weight)).exp()
            })
            .collect()
    }
}

/// Choices that leave a joint state, and how far each chain goes.
const ADVANCES: [(usize, usize, usize); 3] = [
    (choice::AUDIO_ADVANCES, 1, 0),
    (choice::VISUAL_ADVANCES, 0, 1),
    (choice::BOTH_ADVANCE, 1, 1),
];

struct Builder<'a> {
    network: &'a PhoneNetwork,
    topology: Topology,
    phones: &'a [Phone],
    states: Vec<Key>,
    found: HashMap<Key, usize>,
}

impl Builder<'_> {
    fn state(&mut self, key: Key) -> usize {
        let states = &mut self.states;
        *self.found.entry(key).or_insert_with(|| {
            states.push(key);
            states.len() - 1
        })
    }

    fn atom(&self, node: usize) -> usize {
        let index = self.network.nodes[node];
        self.topology.visual_atom(index, self.phones[index])
    }

    fn joint_state(&self, key: Key) -> JointState {
        let topology = self.topology;
        let (node, atom, (i, j), class) = match key {
            Key::Inside(node, i, j) => (node, self.atom(node), (i, j), topology.inside_class(i, j)),
            Key::MouthLeads(node, atom, i, j) => (node, atom, (i, j), topology.mouth_leads_class(i, j)),
            Key::SoundLeads(node, atom, i, j) => (node, atom, (i, j), topology.sound_leads_class(i, j)),
        };
        let phone = self.network.nodes[node];
        JointState {
            audio: N_EMITTING * phone + i,
            visual: topology.visual_state(atom, i, j),
            phone,
            class,
            node,
        }
    }

    /// Calls `arc(to, choice, weight)` for every arc that leaves `key`.
    fn leave(&mut self, key: Key, arc: &mut dyn FnMut(usize, usize, f32)) {
        let here = self.state(key);
        arc(here, choice::STAY, 0.0);
        match (key, self.topology.pairing) {
            (Key::Inside(node, i, _), Pairing::Equal) => {
                if i + 1 < N_EMITTING {
                    arc(
                        self.state(Key::Inside(node, i + 1, i + 1)),
                        choice::BOTH_ADVANCE,
                        0.0,
                    );
                } else {
                    for (next, weight) in self.network.successors[node].clone() {
                        arc(self.state(Key::Inside(next, 0, 0)), choice::BOTH_ADVANCE, weight);
                    }
                }
            }
            (Key::Inside(node, i, j), Pairing::Free) => {
                let last = N_EMITTING - 1;
                if (i, j) == (last, last) {
                    for (next, weight) in self.network.successors[node].clone() {
                        arc(self.state(Key::Inside(next, 0, 0)), choice::BOTH_ADVANCE, weight);
                    }
                }
                for (choice, i2, j2) in ADVANCES.map(|(choice, a, v)| (choice, i + a, j + v)) {
                    if i2 <= last && j2 <= last {
                        arc(self.state(Key::Inside(node, i2, j2)), choice, 0.0);
                    }
                }
            }
            (Key::Inside(node, i, j), Pairing::Band(width)) => {
                for (choice, i2, j2) in ADVANCES.map(|(choice, a, v)| (choice, i + a, j + v)) {
                    if i2.abs_diff(j2) <= width {
                        self.enter(node, i2, j2, choice, arc);
                    }
                }
            }
            (Key::MouthLeads(node, atom, i, j), Pairing::Band(width)) => {
                if N_EMITTING + j + 1 - i <= width {
                    arc(
                        self.state(Key::MouthLeads(node, atom, i, j + 1)),
                        choice::VISUAL_ADVANCES,
                        0.0,
                    );
                }
                if i + 1 < N_EMITTING {
                    for (choice, j2) in [(choice::AUDIO_ADVANCES, j), (choice::BOTH_ADVANCE, j + 1)] {
                        arc(self.state(Key::MouthLeads(node, atom, i + 1, j2)), choice, 0.0);
                    }
                    return;
                }
                let bound: Vec<_> = self.network.successors[node]
                    .iter()
                    .copied()
                    .filter(|s| self.atom(s.0) == atom)
                    .collect();
                let total = log_sum(bound.iter().map(|s| s.1));
                for (next, weight) in bound {
                    arc(
                        self.state(Key::Inside(next, 0, j)),
                        choice::AUDIO_ADVANCES,
                        weight - total,
                    );
                    arc(
                        self.state(Key::Inside(next, 0, j + 1)),
                        choice::BOTH_ADVANCE,
                        weight - total,
                    );
                }
            }
            (Key::SoundLeads(node, atom, i, j), Pairing::Band(width)) => {
                if N_EMITTING + i + 1 - j <= width {
                    arc(
                        self.state(Key::SoundLeads(node, atom, i + 1, j)),
                        choice::AUDIO_ADVANCES,
                        0.0,
                    );
                }
                for (choice, i2) in [(choice::VISUAL_ADVANCES, i), (choice::BOTH_ADVANCE, i + 1)] {
                    let key = match j + 1 < N_EMITTING {
                        true => Key::SoundLeads(node, atom, i2, j + 1),
                        false => Key::Inside(node, i2, 0),
                    };
                    arc(self.state(key), choice, 0.0);
                }
            }
            (Key::MouthLeads(..) | Key::SoundLeads(..), Pairing::Equal | Pairing::Free) => {
                unreachable!("chains that may not lead never do")
            }
        }
    }

    /// Arcs into the unrolled pair (i, j) of `node`, where 5 stands for the first state of what follows.
    fn enter(
        &mut self,
        node: usize,
        i: usize,
        j: usize,
        choice: usize,
        arc: &mut dyn FnMut(usize, usize, f32),
    ) {
        let successors = self.network.successors[node].clone();
        match (i < N_EMITTING, j < N_EMITTING) {
            (true, true) => arc(self.state(Key::Inside(node, i, j)), choice, 0.0),
            (false, false) => {
                for (next, weight) in successors {
                    arc(self.state(Key::Inside(next, 0, 0)), choice, weight);
                }
            }
            (false, true) => {
                let atom = self.atom(node);
                for (next, weight) in successors {
                    arc(self.state(Key::SoundLeads(next, atom, 0, j)), choice, weight);
                }
            }
            (true, false) => {
                let mut atoms: Vec<usize> = successors.iter().map(|s| self.atom(s.0)).collect();
                atoms.sort_unstable();
                atoms.dedup();
                for atom in atoms {
                    let weight = log_sum(successors.iter().filter(|s| self.atom(s.0) == atom).map(|s| s.1));
                    arc(self.state(Key::MouthLeads(node, atom, i, 0)), choice, weight);
                }
            }
        }
    }
}

/// ln Σ exp.
pub fn log_sum(logs: impl Iterator<Item = f32> + Clone) -> f32 {
    let max = logs.clone().fold(f32::NEG_INFINITY, f32::max);
    if max == f32::NEG_INFINITY {
        return max;
    }
    max + logs.map(|l| (l - max).exp()).sum::<f32>().ln()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    const ALL: [Topology; 8] = [
        Topology::PH_FHMM_PAIRS,
        Topology::PH_CHMM.within(2),
        Topology::PH_VI_CHMM.within(3),
        Topology::PH_HMM,
        Topology::PH_FHMM,
        Topology::PH_VI_FHMM,
        Topology::PH_CHMM,
        Topology::PH_VI_CHMM,
    ];

    fn phone_loop(n: usize) -> (PhoneNetwork, Vec<Phone>) {
        let uniform = -(n as f32).ln();
        let phones = Phone::all().take(n).collect();
        (
            PhoneNetwork::phone_loop(&vec![uniform; n], &Array2::from_elem((n, n), uniform)),
            phones,
        )
    }

    fn uniform_transitions(topology: Topology, n: usize) -> Array3<f32> {
        Array3::from_shape_fn((n, topology.classes_per_phone(), 4), |(_, class, choice)| {
            let allowed = topology.allowed(class);
            let n = allowed.iter().filter(|a| **a).count() as f32;
            if allowed[choice] { -n.ln() } else { -1e9 }
        })
    }

    #[test]
    fn the_full_loop_has_about_1800_joint_states() {
        let (network, phones) = phone_loop(47);
        let graph = Graph::build(&network, Topology::PH_VI_CHMM, &phones);
        assert_eq!(graph.states.len(), 47 * 13 + 2 * 47 * 13);
        let by_phones = Graph::build(&network, Topology::PH_CHMM, &phones);
        assert_eq!(by_phones.states.len(), 47 * 13 + 2 * 47 * 47);
        let wide = Graph::build(&network, Topology::PH_VI_CHMM.within(2), &phones);
        assert_eq!(wide.states.len(), 47 * 19 + 2 * 47 * 13 * 3);
        assert_eq!(
            Graph::build(&network, Topology::PH_FHMM, &phones).states.len(),
            47 * 25
        );
    }

    #[test]
    fn probability_is_conserved() {
        for topology in ALL {
            let (network, phones) = phone_loop(9);
            let graph = Graph::build(&network, topology, &phones);
            let p = graph.probabilities(&uniform_transitions(topology, 9));
            for s in 0..graph.states.len() {
                let sum: f64 = p[graph.first[s]..graph.first[s + 1]].iter().sum();
                assert!((sum - 1.0).abs() < 1e-5, "{topology:?} state {s} sums to {sum}");
            }
        }
    }

    #[test]
    fn every_arc_obeys_the_table() {
        let (network, phones) = phone_loop(9);
        for topology in ALL {
            let graph = Graph::build(&network, topology, &phones);
            for arc in &graph.arcs {
                let state = graph.states[arc.from as usize];
                assert!(
                    topology.allowed(state.class)[usize::from(arc.choice)],
                    "{topology:?} {state:?} {arc:?}"
                );
            }
        }
    }

    #[test]
    fn an_utterance_is_a_band_along_the_diagonal() {
        let phones: Vec<Phone> = ["sil", "b", "iy", "sil"]
            .map(|n| Phone::from_name(n).unwrap())
            .to_vec();
        let graph = Graph::build(&PhoneNetwork::chain(&[0, 1, 2, 3]), Topology::PH_VI_CHMM, &phones);
        // 20 steps of the unrolled diagonal and its two neighbours.
        assert_eq!(graph.states.len(), 3 * 20 - 2);
        let network = PhoneNetwork::chain(&[0, 1, 2, 3]);
        let graph = Graph::build(&network, Topology::PH_VI_CHMM.within(3), &phones);
        assert_eq!(graph.states.len(), 7 * 20 - 2 * (1 + 2 + 3));
        assert_eq!(graph.exits.as_ref().unwrap().len(), 1);
    }
}
