//! What comes out of the core: one frame of parameters, in named groups.
use crate::{FRAME_SAMPLES, HOP_SAMPLES};

/// Most parameters of a frame, all groups together.
pub const MAX_PARAMETERS: usize = 96;
/// Most groups of a frame.
pub const MAX_GROUPS: usize = 4;
/// Visemes of X&L (Xie & Liu 2007, *A coupled HMM approach to video-realistic speech animation*), table 1.
pub const N_VISEMES: usize = 13;

/// Occupancy of each viseme, 255 = 1: [`N_VISEMES`] numbers, or none where the model has no visemes.
pub type VisemeWeights = heapless::Vec<u8, N_VISEMES>;

/// Parameters of one frame, and what the model thinks is being said.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ParameterFrame {
    /// Frame of the audio that the parameters belong to.
    pub frame: u32,
    /// Sample at the centre of that frame's window, 160·frame + 200, modulo 2³².
    pub sample: u32,
    /// The parameters of all groups one after another, in units of the model's scales, as many as the model has.
    /// [`Head::groups`](crate::model::Head::groups) says which is whose.
    pub values: heapless::Vec<i16, MAX_PARAMETERS>,
    /// Occupancy of each viseme, if the model has visemes.
    pub viseme_weights: VisemeWeights,
}

impl ParameterFrame {
    /// Frame number `frame` of a stream.
    #[inline]
    pub(crate) fn numbered(
        frame: u32,
        values: heapless::Vec<i16, MAX_PARAMETERS>,
        viseme_weights: VisemeWeights,
    ) -> Self {
        Self {
            frame,
            sample: frame
                .wrapping_mul(HOP_SAMPLES as u32)
                .wrapping_add(FRAME_SAMPLES as u32 / 2),
            values,
            viseme_weights,
        }
    }
}
