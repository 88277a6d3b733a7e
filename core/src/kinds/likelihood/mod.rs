//! Likelihood-trained models: the coupled HMM of X&L (Xie & Liu 2007, *A coupled HMM approach to video-realistic speech animation*)
//! with Gaussian mixtures for the sound, and the mouth by local linear maps or by the paper's EM in a lag window.
//!
//! Per frame [`follower`] runs: [`density`] says how well the sound fits each active audio state, [`crate::hmm`] moves probability,
//! [`lag`] smooths over the last frames. Then [`local_linear`] turns the visual states' occupancies and the context into
//! parameters, or [`feedback`] the occupancies and the mouth itself. [`converter`] runs them in order; [`tables`] holds what
//! they read.
pub mod converter;
pub mod density;
pub mod feedback;
pub mod follower;
pub mod lag;
pub mod local_linear;
pub mod tables;

pub use converter::Converter;

use super::{Kind, sealed::Sealed};
use crate::context::tables::SumRows;
use crate::context::{ContextTables, SumRow};
use crate::frame::N_VISEMES;
use crate::hmm::HmmTables;
use crate::logmath::LogProb;
use crate::model::container::Sections;
use crate::model::{Head, I16s, ModelError};
use crate::settings::Setting;
use tables::{MixtureTables, OwnSettings, StateMaps, StateRow};

/// Active joint states that a device's stream has room for.
pub const TOKENS: usize = 384;
/// Frames of a device's smoothing window: a lag of 8 at most.
pub const FRAMES: usize = 9;

/// The tables of a likelihood-trained model.
#[derive(Clone, Copy, Debug)]
pub struct Likelihood<'a> {
    hmm: HmmTables<'a>,
    context: ContextTables<'a>,
    settings: OwnSettings,
    audio: MixtureTables<'a>,
    global_map: SumRows<'a>,
    state_maps: StateMaps<'a>,
    visual: MixtureTables<'a>,
    visual_centres: I16s<'a>,
    n_parameters: usize,
}

impl Sealed for Likelihood<'_> {}

impl<'a> Kind<'a> for Likelihood<'a> {
    const TAG: u16 = 1;
    const NAME: &'static str = "Likelihood";
    type Converter = Converter<'a, TOKENS, FRAMES>;

    fn read(sections: &mut Sections<'a>, head: &Head<'a>) -> Result<Self, ModelError> {
        tables::read(sections, head)
    }

    fn understands(&self, setting: Setting) -> bool {
        match setting {
            Setting::Lag | Setting::Beam | Setting::AcousticScale | Setting::Average | Setting::Most => true,
            Setting::Feedback => self.has_visual_densities(),
            Setting::LookAhead | Setting::Phones | Setting::Settle => false,
        }
    }

    fn n_visemes(&self) -> usize {
        N_VISEMES
    }

    fn beam(&self) -> Option<LogProb> {
        Some(self.settings().beam)
    }
}

impl<'a> Likelihood<'a> {
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

    /// The settings that the model was made for.
    #[inline]
    pub fn settings(&self) -> &OwnSettings {
        &self.settings
    }

    /// K, densities of an audio state's mixture.
    pub fn n_densities(&self) -> usize {
        self.audio.of(0).count()
    }

    /// The mixtures of the audio states 5·phone + i over observations.
    #[inline]
    pub fn audio(&self) -> &MixtureTables<'a> {
        &self.audio
    }

    /// The mixtures of the visual states 5·viseme + j over parameters; none of a model that cannot re-estimate its mouth.
    #[inline]
    pub fn visual(&self) -> &MixtureTables<'a> {
        &self.visual
    }

    /// Whether the tables have visual densities, see [`feedback`].
    #[inline]
    pub fn has_visual_densities(&self) -> bool {
        !self.visual_centres.bytes().is_empty()
    }

    /// Mean of the mixture of visual state 5·viseme + j, parameter LSBs `[D]`.
    #[inline]
    pub fn visual_centre(&self, state: usize) -> I16s<'a> {
        self.visual_centres.row(state, self.n_parameters)
    }

    /// Rows of the global map: mantissas `[X]`, shift, bias.
    #[inline]
    pub fn global_map(&self) -> impl Iterator<Item = SumRow<'a>> + use<'a> {
        self.global_map.iter()
    }

    /// Rows of the residual map of visual state 5·viseme + j.
    #[inline]
    pub fn state_map(&self, visual_state: usize) -> impl Iterator<Item = StateRow<'a>> + use<'a> {
        self.state_maps.rows(visual_state)
    }
}
