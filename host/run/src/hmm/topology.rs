//! Which joint states exist, and how their transitions are tied (X&L eq. 17-19).
use ndarray::Array3;

use crate::hmm::joint::{N_EMITTING, choice};
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
    /// |a − v| ≤ the width along the unrolled path, across phone borders too (CHMM; 1 in eq. 19). Less than the states of a
    /// phone, so that no chain is two phones ahead.
    Band(usize),
}

/// What the states of the visual chain belong to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VisualAtom {
    /// Phones: both chains are over phones.
    Phone,
    /// Visemes: phones that look alike share their visual states.
    Viseme,
    /// Pairs of states inside a phone: what the mouth does depends on where the sound stands too (eq. 11, where the state of
    /// eq. 10 is printed as a pair).
    Pair,
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
        pairing: Pairing::Band(1),
        visual: VisualAtom::Viseme,
    };
    /// Coupled chains, both over the phones.
    pub const PH_CHMM: Topology = Topology {
        pairing: Pairing::Band(1),
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
    /// Independent chains inside a phone, the mouth's densities on pairs of states.
    pub const PH_FHMM_PAIRS: Topology = Topology {
        pairing: Pairing::Free,
        visual: VisualAtom::Pair,
    };
    /// One chain over the phones.
    pub const PH_HMM: Topology = Topology {
        pairing: Pairing::Equal,
        visual: VisualAtom::Phone,
    };

    /// The same with chains that may be so many states apart in place of one.
    pub const fn within(self, width: usize) -> Self {
        Self {
            pairing: Pairing::Band(width),
            ..self
        }
    }

    /// Rows of the transition table that one phone has: pairs inside it, then those whose mouth leads, then those whose
    /// sound does.
    pub fn classes_per_phone(self) -> usize {
        self.inside_pairs().len() + 2 * self.lead_pairs().len()
    }

    /// Row of the pair (i, j) inside a phone.
    pub fn inside_class(self, audio: usize, visual: usize) -> usize {
        match self.pairing {
            Pairing::Equal => audio,
            Pairing::Free => N_EMITTING * audio + visual,
            Pairing::Band(width) => {
                let first = |i: usize| i.saturating_sub(width);
                let row = |i: usize| (i + width).min(N_EMITTING - 1) + 1 - first(i);
                (0..audio).map(row).sum::<usize>() + visual - first(audio)
            }
        }
    }

    /// Row of a pair whose mouth is in state `visual` of what follows, while the sound is in state `audio` of the phone.
    pub fn mouth_leads_class(self, audio: usize, visual: usize) -> usize {
        self.inside_pairs().len() + self.lead(audio, visual)
    }

    /// Row of a pair whose sound is in state `audio` of the phone, while the mouth is in state `visual` of what went before.
    pub fn sound_leads_class(self, audio: usize, visual: usize) -> usize {
        self.inside_pairs().len() + self.lead_pairs().len() + self.lead(visual, audio)
    }

    fn lead(self, behind: usize, ahead: usize) -> usize {
        let pairs = self.lead_pairs();
        let place = pairs.iter().position(|pair| *pair == (behind, ahead));
        place.expect("a pair that the band allows")
    }

    /// Pairs (i, j) inside one phone.
    pub fn inside_pairs(self) -> Vec<(usize, usize)> {
        let all = (0..N_EMITTING).flat_map(|i| (0..N_EMITTING).map(move |j| (i, j)));
        match self.pairing {
            Pairing::Equal => all.filter(|(i, j)| i == j).collect(),
            Pairing::Free => all.collect(),
            Pairing::Band(width) => all.filter(|(i, j)| i.abs_diff(*j) <= width).collect(),
        }
    }

    /// Pairs across a border: the state of the chain that is behind, and that of the one that is in the next phone already.
    pub fn lead_pairs(self) -> Vec<(usize, usize)> {
        let Pairing::Band(width) = self.pairing else {
            return Vec::new();
        };
        let all = (0..N_EMITTING).flat_map(|i| (0..N_EMITTING).map(move |j| (i, j)));
        all.filter(|(behind, ahead)| N_EMITTING + ahead - behind <= width)
            .collect()
    }

    /// Which of the four choices a row of the transition table allows.
    pub fn allowed(self, class: usize) -> [bool; 4] {
        let (audio, visual, both) = match self.pairing {
            Pairing::Equal => (false, false, true),
            Pairing::Free => {
                const LAST: usize = N_EMITTING - 1;
                let (i, j) = (class / N_EMITTING, class % N_EMITTING);
                (i < LAST, j < LAST, (i < LAST) == (j < LAST))
            }
            Pairing::Band(width) => {
                let (inside, leads) = (self.inside_pairs(), self.lead_pairs());
                // Places of the two chains on the unrolled path.
                let (i, j) = if class < inside.len() {
                    inside[class]
                } else if class < inside.len() + leads.len() {
                    let (behind, ahead) = leads[class - inside.len()];
                    (behind, N_EMITTING + ahead)
                } else {
                    let (behind, ahead) = leads[class - inside.len() - leads.len()];
                    (N_EMITTING + ahead, behind)
                };
                ((i + 1).abs_diff(j) <= width, i.abs_diff(j + 1) <= width, true)
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
            VisualAtom::Phone | VisualAtom::Pair => index,
            VisualAtom::Viseme => usize::from(phone.viseme().0),
        }
    }

    /// Visual states of one atom.
    pub fn states_of_atom(self) -> usize {
        match self.visual {
            VisualAtom::Phone | VisualAtom::Viseme => N_EMITTING,
            VisualAtom::Pair => N_EMITTING * N_EMITTING,
        }
    }

    /// Number of the visual state of an atom when the mouth is in its state j and, where that counts, the sound in state i.
    pub fn visual_state(self, atom: usize, i: usize, j: usize) -> usize {
        match self.visual {
            VisualAtom::Phone | VisualAtom::Viseme => N_EMITTING * atom + j,
            VisualAtom::Pair => N_EMITTING * (N_EMITTING * atom + i) + j,
        }
    }

    /// All visual states of an atom in which the mouth is in state j.
    pub fn visual_states_at(self, atom: usize, j: usize) -> impl Iterator<Item = usize> {
        let sounds = self.states_of_atom() / N_EMITTING;
        (0..sounds).map(move |i| self.visual_state(atom, i, j))
    }

    /// Number of visual states of a model over `n_phones` phones.
    pub fn n_visual_states(self, n_phones: usize) -> usize {
        self.states_of_atom()
            * match self.visual {
                VisualAtom::Phone | VisualAtom::Pair => n_phones,
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
    fn rows_number_themselves() {
        use crate::hmm::joint::{MOUTH_LEADS, N_TRANSITION_CLASSES, SOUND_LEADS, pair_class};
        let t = Topology::PH_VI_CHMM;
        assert_eq!(t.classes_per_phone(), N_TRANSITION_CLASSES);
        for (class, (i, j)) in t.inside_pairs().into_iter().enumerate() {
            assert_eq!((t.inside_class(i, j), pair_class(i, j)), (class, class));
        }
        let last = N_EMITTING - 1;
        assert_eq!(t.mouth_leads_class(last, 0), MOUTH_LEADS);
        assert_eq!(t.sound_leads_class(0, last), SOUND_LEADS);
        for width in 1..N_EMITTING {
            let t = t.within(width);
            let mut rows: Vec<usize> = t
                .inside_pairs()
                .iter()
                .map(|p| t.inside_class(p.0, p.1))
                .collect();
            rows.extend(t.lead_pairs().iter().map(|p| t.mouth_leads_class(p.0, p.1)));
            rows.extend(t.lead_pairs().iter().map(|p| t.sound_leads_class(p.1, p.0)));
            assert_eq!(
                rows,
                (0..t.classes_per_phone()).collect::<Vec<_>>(),
                "width {width}"
            );
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
