//! Joint states of the ph-vi coupled HMM over a phone loop, and where each of them may go (Xie & Liu 2007 (X&L), eq. 19).
//!
//! The audio chain walks phones, the visual chain visemes, five states each, written 1..5 here as in the paper
//! and 0..4 in the code. Along the unrolled path the two chains are never more than one state apart, across
//! phone borders too. m is the viseme of phone p, written vis(p). The joint states are
//!
//! - **inside** phone p: (p, i) × (m, j), |i − j| ≤ 1, 13 pairs;
//! - **mouth leads**: (p, 5) × (m', 1), the mouth has gone on to viseme m', which binds the next phone to m';
//! - **sound leads**: (p', 1) × (m, 5), the sound has gone on to phone p', the mouth is still in viseme m.
//!
//! A joint state belongs to the phone of its audio state; that phone and the class (the pair, mouth leads, sound
//! leads) give its four choices: stay, the audio chain advances, the visual chain advances, both do. A choice that
//! eq. 19 forbids has probability 0 and the others sum to 1. B(p'|p) is the bigram, V(m'|p) = Σ B(p'|p) over
//! the phones p' of viseme m'.
//!
//! | from | stay | audio | visual | both |
//! |---|---|---|---|---|
//! | (p,i)×(m,j) inside | itself | (p,i+1)×(m,j) if a pair | (p,i)×(m,j+1) if a pair | (p,i+1)×(m,j+1) |
//! | (p,5)×(m,5) | itself | (p',1)×(m,5) with B(p'\|p) | (p,5)×(m',1) with V(m'\|p) | (p',1)×(vis(p'),1) with B(p'\|p) |
//! | (p,5)×(m,4) | itself | - | (p,5)×(m,5) | (p',1)×(m,5) with B(p'\|p) |
//! | (p,4)×(m,5) | itself | (p,5)×(m,5) | - | (p,5)×(m',1) with V(m'\|p) |
//! | (p,5)×(m',1) mouth leads | itself | (p',1)×(m',1) with B(p'\|p)/V(m'\|p), vis(p') = m' | - | (p',1)×(m',2), likewise |
//! | (p',1)×(m,5) sound leads | itself | - | (p',1)×(vis(p'),1) | (p',2)×(vis(p'),1) |
//!
//! An utterance begins in (p,1)×(m,1) with the initial probability of p (in a recurrent model in any pair of p with a thirteenth of
//! it); it may end anywhere.
use crate::frame::N_VISEMES;

/// States of a phone or viseme.
pub const N_EMITTING: usize = 5;
/// Most phones of a model.
pub const MAX_PHONES: usize = 48;
/// Audio states of the largest model: 5 · phone + i.
pub const MAX_AUDIO_STATES: usize = N_EMITTING * MAX_PHONES;
/// Visual states: 5 · viseme + j.
pub const N_VISUAL_STATES: usize = N_EMITTING * N_VISEMES;

/// Pairs (i, j) inside a phone.
pub const N_PAIRS: usize = 13;
/// Transition classes of a phone: its pairs, mouth leads, sound leads.
pub const N_CLASSES: usize = N_PAIRS + 2;
/// Class of a joint state whose mouth leads.
pub const MOUTH_LEADS: usize = N_PAIRS;
/// Class of a joint state whose sound leads.
pub const SOUND_LEADS: usize = N_PAIRS + 1;

/// What the two chains do next: stay.
pub const STAY: usize = 0;
/// The audio chain advances.
pub const AUDIO: usize = 1;
/// The visual chain advances.
pub const VISUAL: usize = 2;
/// Both chains advance.
pub const BOTH: usize = 3;
/// Choices of a joint state.
pub const N_CHOICES: usize = 4;

/// Joint states that belong to one phone: 13 pairs, then mouth leads into each viseme, then sound leads from each.
pub const PHONE_STATES: usize = N_PAIRS + 2 * N_VISEMES;
/// First mouth-leads slot; slot = this + m'.
pub const MOUTH_SLOT: usize = N_PAIRS;
/// First sound-leads slot; slot = this + m.
pub const SOUND_SLOT: usize = N_PAIRS + N_VISEMES;
/// Joint states of the largest model.
pub const MAX_JOINT_STATES: usize = PHONE_STATES * MAX_PHONES;

/// 1 / [`PHONE_STATES`], rounded up, in this many fraction bits: for processors without a division. Exact for every state there is.
const RECIPROCAL: u32 = (1_u32 << RECIPROCAL_SHIFT).div_ceil(PHONE_STATES as u32);
const RECIPROCAL_SHIFT: u32 = 21;
// What it is too large by must not reach the next whole number, nor the product 2³².
const _: () = {
    let excess = RECIPROCAL * PHONE_STATES as u32 - (1 << RECIPROCAL_SHIFT);
    assert!((MAX_JOINT_STATES as u64) * (excess as u64) < 1 << RECIPROCAL_SHIFT);
    assert!((u16::MAX as u64) * (RECIPROCAL as u64) < 1 << 32);
};

/// A joint state: 39 · phone + slot, where slot is the pair, 13 + m' (mouth leads) or 26 + m (sound leads).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct JointState(pub u16);

impl JointState {
    /// The joint state of a phone and a slot.
    #[inline]
    pub const fn new(phone: usize, slot: usize) -> Self {
        Self((phone * PHONE_STATES + slot) as u16)
    }

    /// The phone of its audio state.
    #[inline]
    pub const fn phone(self) -> usize {
        ((self.0 as u32 * RECIPROCAL) >> RECIPROCAL_SHIFT) as usize
    }

    /// Its slot among the phone's joint states.
    #[inline]
    pub const fn slot(self) -> usize {
        self.0 as usize - self.phone() * PHONE_STATES
    }

    /// Its place among all joint states.
    #[inline]
    pub const fn index(self) -> usize {
        self.0 as usize
    }

    /// Audio state 5 · phone + i.
    #[inline]
    pub fn audio(self) -> usize {
        N_EMITTING * self.phone() + usize::from(SLOTS[self.slot() & 63].audio)
    }

    /// Visual state 5 · viseme + j, given the viseme of the joint state's phone.
    #[inline]
    pub fn visual(self, viseme: usize) -> usize {
        let slot = self.slot();
        if slot < MOUTH_SLOT {
            N_EMITTING * viseme + usize::from(SLOTS[slot].visual)
        } else if slot < SOUND_SLOT {
            N_EMITTING * (slot - MOUTH_SLOT)
        } else {
            N_EMITTING * (slot - SOUND_SLOT) + N_EMITTING - 1
        }
    }
}

/// Index of the pair (i, j), 0-based, |i − j| ≤ 1.
pub const fn pair(audio: usize, visual: usize) -> usize {
    3 * audio + visual - audio
}

/// The audio and visual states (0-based) of a slot, and its transition class.
#[derive(Clone, Copy)]
pub struct Slot {
    /// 0-based state of the phone.
    pub audio: u8,
    /// 0-based state of whichever viseme the mouth is in.
    pub visual: u8,
    /// Transition class.
    pub class: u8,
}

/// By slot; entries from 39 on are never read.
pub static SLOTS: [Slot; 64] = slots();

const fn slots() -> [Slot; 64] {
    let mut slots = [Slot {
        audio: 0,
        visual: 0,
        class: 0,
    }; 64];
    let mut audio = 0;
    while audio < N_EMITTING {
        let mut visual = audio.saturating_sub(1);
        while visual <= audio + 1 && visual < N_EMITTING {
            slots[pair(audio, visual)] = Slot {
                audio: audio as u8,
                visual: visual as u8,
                class: pair(audio, visual) as u8,
            };
            visual += 1;
        }
        audio += 1;
    }
    let mut viseme = 0;
    while viseme < N_VISEMES {
        slots[MOUTH_SLOT + viseme] = Slot {
            audio: N_EMITTING as u8 - 1,
            visual: 0,
            class: MOUTH_LEADS as u8,
        };
        slots[SOUND_SLOT + viseme] = Slot {
            audio: 0,
            visual: N_EMITTING as u8 - 1,
            class: SOUND_LEADS as u8,
        };
        viseme += 1;
    }
    slots
}
