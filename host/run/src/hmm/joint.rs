//! The joint states of the coupled HMM: states of a phone, transition classes, choices (X&L eq. 19).

/// Emitting states of a phone or a viseme (X&L section 7.1).
pub const N_EMITTING: usize = 5;
/// Transition classes of one phone: 13 inside, mouth leads, sound leads (see [`super::topology`]).
pub const N_TRANSITION_CLASSES: usize = 15;

/// Index of the 13 pairs (i, j), |i − j| ≤ 1, of audio state i and visual state j inside a phone: 0..13.
pub const fn pair_class(audio: usize, visual: usize) -> usize {
    debug_assert!(audio < N_EMITTING && visual < N_EMITTING && audio.abs_diff(visual) <= 1);
    3 * audio + visual - audio
}

/// Transition class of a pair whose mouth has gone on to the next viseme, (p, 5) × (m', 1).
pub const MOUTH_LEADS: usize = 13;
/// Transition class of a pair whose mouth is still in the last viseme, (p, 1) × (m, 5).
pub const SOUND_LEADS: usize = 14;

/// What the two chains of a joint state do next: columns of a transition table.
/// Impossible choices (eq. 19) hold [`NO_WEIGHT`](super::mixtures::Mixtures::NO_WEIGHT).
pub mod choice {
    /// Neither chain advances.
    pub const STAY: usize = 0;
    /// The audio chain advances, the visual chain stays.
    pub const AUDIO_ADVANCES: usize = 1;
    /// The visual chain advances, the audio chain stays.
    pub const VISUAL_ADVANCES: usize = 2;
    /// Both chains advance.
    pub const BOTH_ADVANCE: usize = 3;
}
