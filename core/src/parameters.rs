//! What comes out of the core: one frame of mouth parameters.

/// Most parameters that a model may have.
pub const MAX_PARAMETERS: usize = 64;
/// Visemes of X&L table 1.
pub const N_VISEMES: usize = 13;

/// Mouth parameters of one frame, and what the model thinks is being said.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ParameterFrame {
    /// Frame of the audio that the parameters belong to.
    pub frame: u32,
    /// Sample at the centre of that frame's window, 160·frame + 200, modulo 2³².
    pub sample: u32,
    /// Eigenmouth weights in units of the model's scales, as many as the model has.
    pub values: heapless::Vec<i16, MAX_PARAMETERS>,
    /// Occupancy of each viseme, 255 = 1.
    pub viseme_weights: [u8; N_VISEMES],
}
