//! Recurrent models: the coupled HMM grown up, trained through its forward pass on the error of its own mouth (minimum generation
//! error), with a memory that its states gate. Live, in fixed point; the twin in floats is the host's.
//!
//! With c_t the context of frame t, α the forward variable over joint states (a, v) and ŷ the mouth:
//!
//! ```text
//! z_t = V c_t − b_z                                              [`context`]
//! α_t(a, v) ∝ (Aᵀα_{t−1})(a, v) · 2^(U_a z_t + b_a + F_v ŷ_{t−1} + f_v)   [`follower`]
//! γᵃ, γᵛ: sums of α_t                                            [`occupancy`]
//! w = Σγ G,  r = Σγ R,  λ = Σγ Λ                                 [`memory`]
//! h_t = h_{t−1} + λ∘(V_d z_t ∘ w + r − h_{t−1})
//! ŷ_t = W₀ z_t + b₀ + Σγ B + O h_t
//! y_t = (1 − s) ŷ_t + s ĝ_t                                      [`gated`], where there is a second memory
//! s_t = s_{t−1} + k_t·(y_t − s_{t−1})                            [`settle`]
//! ```
//!
//! V is in i16, as its columns are strongly correlated; every other matrix in i8 ([`rows`]). Sums over states take the
//! largest occupancies only, see [`crate::hmm::gates`]. z, ŷ and what the output reads of h are Q5.10 in 16 bits; h
//! itself is Q15.16; log likelihoods are [`crate::logmath::LogProb`]. [`converter`] runs the stages in order; [`tables`] holds
//! what they read.
pub mod context;
pub mod converter;
pub mod follower;
pub mod gated;
pub mod memory;
pub mod occupancy;
pub mod rate;
pub mod rows;
pub mod settle;
pub mod tables;

pub use converter::Converter;

use super::{Kind, sealed::Sealed};
use crate::context::ContextTables;
use crate::frame::N_VISEMES;
use crate::hmm::HmmTables;
use crate::logmath::LogProb;
use crate::model::container::Sections;
use crate::model::{Head, I16s, ModelError};
use crate::settings::Setting;
use tables::{Blocks, Gate, GateTables, GatedTables, OwnSettings, Rows};

/// Active joint states that a device's stream has room for, and keeps at most unless the settings say otherwise: the bound on the
/// work of the worst frame.
pub const TOKENS: usize = 80;

/// The tables of a recurrent model.
#[derive(Clone, Copy, Debug)]
pub struct Recurrent<'a> {
    hmm: HmmTables<'a>,
    context: ContextTables<'a>,
    settings: OwnSettings,
    mean_shifts: &'a [u8],
    audio: Rows<'a>,
    visual: Rows<'a>,
    drive: Blocks<'a>,
    output: Blocks<'a>,
    memory: Blocks<'a>,
    audio_gates: GateTables<'a>,
    visual_gates: GateTables<'a>,
    gated: Option<GatedTables<'a>>,
    first_memory: I16s<'a>,
    n_parameters: usize,
    n_fed_back: usize,
}

impl Sealed for Recurrent<'_> {}

impl<'a> Kind<'a> for Recurrent<'a> {
    const TAG: u16 = 2;
    const NAME: &'static str = "Recurrent";
    type Converter = Converter<'a, TOKENS>;

    fn read(sections: &mut Sections<'a>, head: &Head<'a>) -> Result<Self, ModelError> {
        tables::read(sections, head)
    }

    fn understands(&self, setting: Setting) -> bool {
        match setting {
            Setting::Beam | Setting::LookAhead | Setting::Most | Setting::Phones | Setting::Settle => true,
            Setting::Lag | Setting::AcousticScale | Setting::Average | Setting::Feedback => false,
        }
    }

    fn n_visemes(&self) -> usize {
        N_VISEMES
    }

    fn beam(&self) -> Option<LogProb> {
        Some(self.settings().beam)
    }
}

impl<'a> Recurrent<'a> {
    /// Phones, visemes, transitions.
    #[inline]
    pub fn hmm(&self) -> &HmmTables<'a> {
        &self.hmm
    }

    /// Taps and projection.
    #[inline]
    pub fn context(&self) -> &ContextTables<'a> {
        &self.context
    }

    /// The settings that the model was made for, and what its states own.
    #[inline]
    pub fn settings(&self) -> &OwnSettings {
        &self.settings
    }

    /// Rates of the context's exponential means, as right shifts 1..=12, `[M]`.
    #[inline]
    pub fn mean_shifts(&self) -> &'a [u8] {
        self.mean_shifts
    }

    /// H, numbers in the memory.
    #[inline]
    pub fn n_memory(&self) -> usize {
        self.drive.len()
    }

    /// Numbers of the last mouth that feed back into the visual emissions: D or none.
    #[inline]
    pub fn n_fed_back(&self) -> usize {
        self.n_fed_back
    }

    /// U and b: log emissions of the audio states.
    #[inline]
    pub fn audio(&self) -> &Rows<'a> {
        &self.audio
    }

    /// F and f: log emissions of the visual states.
    #[inline]
    pub fn visual(&self) -> &Rows<'a> {
        &self.visual
    }

    /// V_d: what z drives the memory with.
    #[inline]
    pub fn drive(&self) -> &Blocks<'a> {
        &self.drive
    }

    /// W₀ and b₀: the mouth from z.
    #[inline]
    pub fn output(&self) -> &Blocks<'a> {
        &self.output
    }

    /// O: the mouth from the memory.
    #[inline]
    pub fn memory(&self) -> &Blocks<'a> {
        &self.memory
    }

    /// What audio state 5·phone + i brings to the memory and to the mouth.
    #[inline]
    pub fn audio_gate(&self, state: usize) -> Gate<'a> {
        self.audio_gates.of(state)
    }

    /// What visual state 5·viseme + j brings to the memory and to the mouth.
    #[inline]
    pub fn visual_gate(&self, state: usize) -> Gate<'a> {
        self.visual_gates.of(state)
    }

    /// The second memory, where there is one.
    #[inline]
    pub fn gated(&self) -> Option<&GatedTables<'a>> {
        self.gated.as_ref()
    }

    /// The memory before the first frame, Q5.10 `[H]`.
    #[inline]
    pub fn first_memory(&self) -> I16s<'a> {
        self.first_memory
    }
}
