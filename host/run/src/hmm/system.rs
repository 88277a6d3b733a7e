//! The systems of X&L table 2 and those beside them: a description each, no code of their own.
use super::topology::{Pairing, Topology, VisualAtom};

/// How a joint state's two observations are modelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Density {
    /// One mixture over [oᵃ; oᵛ]: component k of the sound is component k of the mouth.
    Joint,
    /// A mixture per stream.
    Streams,
}

/// How a system says what the mouth does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Speech {
    /// EM re-estimation of the mouth from the components' means (X&L section 4; HMMI where densities are joint).
    Means,
    /// The mean of the mouth given the sound: the components' means, each by its probability.
    Posterior,
    /// The mean of the one state that the best path is in.
    Viterbi,
    /// Local linear maps chosen by the visual states' occupancies (`docs/design.md` section 6).
    LocalLinear,
}

/// One system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct System {
    /// Name on the command line and in model files, such as `ph-vi-chmm`.
    pub name: &'static str,
    /// Which joint states exist, and how their transitions are tied.
    pub topology: Topology,
    /// How the two observations of a joint state are modelled.
    pub density: Density,
    /// How the mouth is found from the states.
    pub speech: Speech,
}

const fn of(name: &'static str, topology: Topology, density: Density, speech: Speech) -> System {
    System {
        name,
        topology,
        density,
        speech,
    }
}

/// A system with a mixture per stream.
const fn streams(name: &'static str, topology: Topology, speech: Speech) -> System {
    of(name, topology, Density::Streams, speech)
}

/// Every system that can be trained: the paper's six first, those that speak otherwise from the same HMMs after them, then
/// variants of the HMMs: chains that may be two or three states apart, and densities of the mouth on pairs of states.
pub const SYSTEMS: [System; 26] = [
    of("ph-hmm", Topology::PH_HMM, Density::Joint, Speech::Means),
    streams("ph-mshmm", Topology::PH_HMM, Speech::Means),
    streams("ph-fhmm", Topology::PH_FHMM, Speech::Means),
    streams("ph-vi-fhmm", Topology::PH_VI_FHMM, Speech::Means),
    streams("ph-chmm", Topology::PH_CHMM, Speech::Means),
    streams("ph-vi-chmm", Topology::PH_VI_CHMM, Speech::Means),
    of("viterbi", Topology::PH_HMM, Density::Joint, Speech::Viterbi),
    of(
        "posterior-ph-hmm",
        Topology::PH_HMM,
        Density::Joint,
        Speech::Posterior,
    ),
    streams("posterior-ph-mshmm", Topology::PH_HMM, Speech::Posterior),
    streams("posterior-ph-fhmm", Topology::PH_FHMM, Speech::Posterior),
    streams("posterior-ph-vi-fhmm", Topology::PH_VI_FHMM, Speech::Posterior),
    streams("posterior-ph-chmm", Topology::PH_CHMM, Speech::Posterior),
    streams("posterior-ph-vi-chmm", Topology::PH_VI_CHMM, Speech::Posterior),
    streams("local-linear", Topology::PH_VI_CHMM, Speech::LocalLinear),
    of(
        "local-linear-ph-hmm",
        Topology::PH_HMM,
        Density::Joint,
        Speech::LocalLinear,
    ),
    streams("local-linear-ph-chmm", Topology::PH_CHMM, Speech::LocalLinear),
    streams("ph-fhmm-pairs", Topology::PH_FHMM_PAIRS, Speech::Means),
    streams("ph-chmm-2", Topology::PH_CHMM.within(2), Speech::Means),
    streams("ph-chmm-3", Topology::PH_CHMM.within(3), Speech::Means),
    streams("ph-vi-chmm-2", Topology::PH_VI_CHMM.within(2), Speech::Means),
    streams("ph-vi-chmm-3", Topology::PH_VI_CHMM.within(3), Speech::Means),
    streams(
        "posterior-ph-fhmm-pairs",
        Topology::PH_FHMM_PAIRS,
        Speech::Posterior,
    ),
    streams(
        "posterior-ph-chmm-2",
        Topology::PH_CHMM.within(2),
        Speech::Posterior,
    ),
    streams(
        "posterior-ph-chmm-3",
        Topology::PH_CHMM.within(3),
        Speech::Posterior,
    ),
    streams(
        "posterior-ph-vi-chmm-2",
        Topology::PH_VI_CHMM.within(2),
        Speech::Posterior,
    ),
    streams(
        "posterior-ph-vi-chmm-3",
        Topology::PH_VI_CHMM.within(3),
        Speech::Posterior,
    ),
];

impl System {
    /// X&L's own system.
    pub const PH_VI_CHMM: System = SYSTEMS[5];
    /// The coupled HMM with local linear maps, which the device runs.
    pub const LOCAL_LINEAR: System = streams("local-linear", Topology::PH_VI_CHMM, Speech::LocalLinear);

    /// The system of this name; none if there is no such system.
    pub fn from_name(name: &str) -> Option<Self> {
        SYSTEMS.into_iter().find(|s| s.name == name)
    }

    /// The same HMM that speaks otherwise; its name stays the model's.
    pub fn speaking(self, speech: Speech) -> Self {
        Self { speech, ..self }
    }

    /// The paper's system whose HMM this one has: systems of the same HMM differ in how they speak only.
    pub fn hmm(self) -> System {
        SYSTEMS
            .into_iter()
            .find(|s| s.topology == self.topology && s.density == self.density)
            .expect("a system has its own HMM at least")
    }

    /// Whether a system of the same HMM speaks by local linear maps.
    pub fn speaks_by_maps(self) -> bool {
        let by_maps = |s: &System| s.speech == Speech::LocalLinear && s.hmm() == self.hmm();
        SYSTEMS.iter().any(by_maps)
    }

    /// Whether its HMM is none of the paper's table 2 but a variant.
    pub fn is_variant(self) -> bool {
        !SYSTEMS[..6].contains(&self.hmm())
    }

    /// Whether the device can run it.
    pub fn is_live(self) -> bool {
        self == Self::LOCAL_LINEAR
    }

    /// What it is, in a line for people.
    pub fn describe(self) -> String {
        let chains = match (self.topology.pairing, self.density) {
            (Pairing::Equal, Density::Joint) => "one chain, joint mixtures",
            (Pairing::Equal, Density::Streams) => "one chain, a mixture per stream",
            (Pairing::Free, _) => "two chains, each on its own inside a phone",
            (Pairing::Band(1), _) => "two chains, never two states apart",
            (Pairing::Band(2), _) => "two chains, at most two states apart",
            (Pairing::Band(_), _) => "two chains, at most three states apart",
        };
        let atoms = match self.topology.visual {
            VisualAtom::Phone => "phones",
            VisualAtom::Viseme => "phones and visemes",
            VisualAtom::Pair => "phones, the mouth by pairs of states",
        };
        let speech = match (self.speech, self.density) {
            (Speech::Means, Density::Joint) => "HMM inversion",
            (Speech::Means, Density::Streams) => "EM conversion",
            (Speech::Posterior, _) => "posterior mean",
            (Speech::Viterbi, _) => "means of the best path",
            (Speech::LocalLinear, _) => "local linear maps",
        };
        format!("{chains}; {atoms}; {speech}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_found_and_has_an_hmm_that_iterates() {
        for system in SYSTEMS {
            assert_eq!(System::from_name(system.name), Some(system));
            let hmm = system.hmm();
            assert!(
                system.name.ends_with(hmm.name) || !system.name.contains("ph-"),
                "{}",
                hmm.name
            );
            assert_eq!(
                system.is_variant(),
                SYSTEMS[16..].contains(&system),
                "{}",
                system.name
            );
            assert_eq!(hmm.speech, Speech::Means);
        }
        assert!(SYSTEMS.contains(&System::LOCAL_LINEAR));
        assert_eq!(System::LOCAL_LINEAR.hmm(), System::PH_VI_CHMM);
        assert_eq!(System::from_name("hmm"), None);
    }
}
