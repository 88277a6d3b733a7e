//! Which joint states exist, and how their transitions are tied (X&L eq. 17-19).
use ndarray::Array3;

use crate::hmm::joint::{MOUTH_LEADS, N_EMITTING, N_TRANSITION_CLASSES, SOUND_LEADS, choice, pair_class};
use crate::hmm::mixtures::Mixtures;
use crate::phones::Phone;

/// Pairs of an audio state and a visual state that a system allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pairing {
    /// a = v: one chain (ph-HMM, ph-MSHMM, and the audio HMM by itself; eq. 17).
    Equal,
    /// Any pair inside one phone; each chain advances by its own probability (FHMM, eq. 18). Both leave the phone
    /// together.
    Free,
    /// |a − v| ≤ 1 along the unrolled path, across phone borders too (CHMM, eq. 19).
    Band,
}

/// What the states of the visual chain belong to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VisualAtom {
    /// Phones: both chains are over phones.
    Phone,
    /// Visemes: phones that look alike share their visual states.
    Viseme,
}

/// A system's description.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Topology {
    /// Which pairs of states exist.
    pub pairing: Pairing,
    /// What the visual states belong to.
    pub visual: VisualAtom,
}

impl Topology {
    /// X&L's own system: phoneme states for the sound, viseme states for the mouth, coupled.
    pub const PH_VI_CHMM: Topology = Topology {
        pairing: Pairing::Band,
        visual: VisualAtom::Viseme,
    };
    /// Coupled chains, both over the phones.
    pub const PH_CHMM: Topology = Topology {
        pairing: Pairing::Band,
        visual: VisualAtom::Phone,
    };
    /// Independent chains inside a phone, viseme states for the mouth.
    pub const PH_VI_FHMM: Topology = Topology {
        pairing: Pairing::Free,
        visual: VisualAtom::Viseme,
    };
    /// Independent chains inside a phone.
    pub const PH_FHMM: Topology = Topology {
        pairing: Pairing::Free,
        visual: VisualAtom::Phone,
    };
    /// One chain over the phones.
    pub const PH_HMM: Topology = Topology {
        pairing: Pairing::Equal,
        visual: VisualAtom::Phone,
    };

    /// Rows of the transition table that one phone has.
    pub fn classes_per_phone(self) -> usize {
        match self.pairing {
            Pairing::Equal => N_EMITTING,
            Pairing::Free => N_EMITTING * N_EMITTING,
            Pairing::Band => N_TRANSITION_CLASSES,
        }
    }

    /// Row of the pair (i, j) inside a phone.
    pub fn inside_class(self, audio: usize, visual: usize) -> usize {
        match self.pairing {
            Pairing::Equal => audio,
            Pairing::Free => N_EMITTING * audio + visual,
            Pairing::Band => pair_class(audio, visual),
        }
    }

    /// Pairs (i, j) inside one phone.
    pub fn inside_pairs(self) -> Vec<(usize, usize)> {
        let all = (0..N_EMITTING).flat_map(|i| (0..N_EMITTING).map(move |j| (i, j)));
        match self.pairing {
            Pairing::Equal => all.filter(|(i, j)| i == j).collect(),
            Pairing::Free => all.collect(),
            Pairing::Band => all.filter(|(i, j)| i.abs_diff(*j) <= 1).collect(),
        }
    }

    /// Which of the four choices a row of the transition table allows.
    pub fn allowed(self, class: usize) -> [bool; 4] {
        let (audio, visual, both) = match (self.pairing, class) {
            (Pairing::Equal, _) => (false, false, true),
            (Pairing::Free, _) => {
                const LAST: usize = N_EMITTING - 1;
                let (i, j) = (class / N_EMITTING, class % N_EMITTING);
                (i < LAST, j < LAST, (i < LAST) == (j < LAST))
            }
            (Pairing::Band, MOUTH_LEADS) => (true, false, true),
            (Pairing::Band, SOUND_LEADS) => (false, true, true),
            (Pairing::Band, _) => {
                let (i, j) = self.inside_pairs()[class];
                (i <= j, j <= i, true)
            }
        };
        let mut allowed = [false; 4];
        allowed[choice::STAY] = true;
        allowed[choice::AUDIO_ADVANCES] = audio;
        allowed[choice::VISUAL_ADVANCES] = visual;
        allowed[choice::BOTH_ADVANCE] = both;
        allowed
    }

    /// Number of the visual atom of a phone: itself in the model's order, or its viseme.
    pub fn visual_atom(self, index: usize, phone: Phone) -> usize {
        match self.visual {
            VisualAtom::Phone => index,
            VisualAtom::Viseme => usize::from(phone.viseme().0),
        }
    }

    /// Number of visual states of a model over `n_phones` phones.
    pub fn n_visual_states(self, n_phones: usize) -> usize {
        N_EMITTING
            * match self.visual {
                VisualAtom::Phone => n_phones,
                VisualAtom::Viseme => crate::phones::VISEMES.len(),
            }
    }
}

/// Every choice that a row allows; staying is likelier, so that a state lasts about three frames.
pub fn start_transitions(topology: Topology, phones: usize) -> Array3<f32> {
    const STAY: f32 = 0.65;
    if topology.pairing == Pairing::Free {
        return Array3::from_shape_fn((phones, topology.classes_per_phone(), 4), |(_, class, c)| {
            independent(class, 1.0 - STAY, 1.0 - STAY)[c]
        });
    }
    Array3::from_shape_fn((phones, topology.classes_per_phone(), 4), |(_, class, c)| {
        let allowed = topology.allowed(class);
        let others = allowed.iter().filter(|a| **a).count() as f32 - 1.0;
        match (allowed[c], c == choice::STAY) {
            (false, _) => Mixtures::NO_WEIGHT,
            (true, true) => STAY.ln(),
            (true, false) => ((1.0 - STAY) / others).ln(),
        }
    })
}

/// Logs of the four choices of pair (i, j) when each chain advances by its own chance (eq. 18). In the last state a
/// chain waits for the other; when both are there, `audio` is the chance to leave the phone.
pub fn independent(class: usize, audio: f32, visual: f32) -> [f32; 4] {
    const LAST: usize = N_EMITTING - 1;
    let (i, j) = (class / N_EMITTING, class % N_EMITTING);
    let mut row = [0.0; 4];
    match (i < LAST, j < LAST) {
        (false, false) => (row[choice::STAY], row[choice::BOTH_ADVANCE]) = (1.0 - audio, audio),
        (a, v) => {
            let (audio, visual) = (if a { audio } else { 0.0 }, if v { visual } else { 0.0 });
            row[choice::STAY] = (1.0 - audio) * (1.0 - visual);
            row[choice::AUDIO_ADVANCES] = audio * (1.0 - visual);
            row[choice::VISUAL_ADVANCES] = (1.0 - audio) * visual;
            row[choice::BOTH_ADVANCE] = audio * visual;
        }
    }
    row.map(|p| if p > 0.0 { p.ln() } else { Mixtures::NO_WEIGHT })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thirteen_pairs_number_themselves() {
        let t = Topology::PH_VI_CHMM;
        let pairs = t.inside_pairs();
        assert_eq!(pairs.len(), 13);
        for (class, (i, j)) in pairs.into_iter().enumerate() {
            assert_eq!(t.inside_class(i, j), class);
        }
    }

    #[test]
    fn free_chains_leave_a_phone_together() {
        let t = Topology::PH_FHMM;
        let last = N_EMITTING - 1;
        assert_eq!(t.allowed(t.inside_class(last, last)), [true, false, false, true]);
        assert_eq!(t.allowed(t.inside_class(last, 0)), [true, false, true, false]);
        assert_eq!(t.allowed(t.inside_class(0, 3)), [true; 4]);
    }

    #[test]
    fn a_chain_never_runs_two_states_ahead() {
        let t = Topology::PH_VI_CHMM;
        for (class, (i, j)) in t.inside_pairs().into_iter().enumerate() {
            let allowed = t.allowed(class);
            assert_eq!(allowed[choice::AUDIO_ADVANCES], (i + 1).abs_diff(j) <= 1);
            assert_eq!(allowed[choice::VISUAL_ADVANCES], i.abs_diff(j + 1) <= 1);
        }
    }
}
