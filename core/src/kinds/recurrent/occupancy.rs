//! Occupancies of the audio and of the visual states, from the tokens of a frame.
use crate::hmm::gates::share;
use crate::hmm::tables::HmmTables;
use crate::hmm::token::Token;
use crate::hmm::transition::{MAX_AUDIO_STATES, N_VISUAL_STATES};
use crate::logmath::LogProb;

/// Occupancies of both chains' states, Q0.16; each chain's sum is 1 within its number of states in LSBs.
pub struct Occupancy {
    /// Of the audio states 5·phone + i.
    pub audio: [u32; MAX_AUDIO_STATES],
    /// Of the visual states 5·viseme + j.
    pub visual: [u32; N_VISUAL_STATES],
}

impl Occupancy {
    /// γᵃ(a) = Σ_v α(a, v), γᵛ(v) = Σ_a α(a, v).
    pub fn of(hmm: &HmmTables, tokens: &[Token]) -> Self {
        let mut out = Self {
            audio: [0; MAX_AUDIO_STATES],
            visual: [0; N_VISUAL_STATES],
        };
        // The best token has 2¹⁶; at most 1872 of them: below 2²⁷.
        let mut total: u32 = 0;
        for token in tokens {
            let weight = LogProb::from_score(token.score).exp2();
            total += weight;
            if let Some(sum) = out.audio.get_mut(token.state.audio()) {
                *sum += weight;
            }
            let visual = token.state.visual(hmm.viseme(token.state.phone()));
            if let Some(sum) = out.visual.get_mut(visual) {
                *sum += weight;
            }
        }
        share(&mut out.audio, total);
        share(&mut out.visual, total);
        out
    }
}
