//! What comes out of the core: one frame of parameters, in named groups.
use crate::{FRAME_SAMPLES, HOP_SAMPLES};

/// Most parameters of a frame, all groups together.
pub const MAX_PARAMETERS: usize = 96;
/// Most groups of a frame.
pub const MAX_GROUPS: usize = 4;
/// Visemes of X&L (Xie & Liu 2007, *A coupled HMM approach to video-realistic speech animation*), table 1.
pub const N_VISEMES: usize = 13;

/// Names of the visemes, in the order of every frame's weights: silence, four classes of vowels by lip rounding, and the places of articulation of the consonants.
pub const VISEME_NAMES: [&str; N_VISEMES] = [
    "sip", "lr1", "lr2", "lr3", "lr4", "as", "af", "al", "pa", "bi", "de", "ld", "ve",
];

/// How far the mouth is open in each viseme, 255 = as wide as in speech. The host derives them from its table of blend shapes (`docs/visemes.md`), and holds these against
/// that.
pub const VISEME_OPENNESS: [u8; N_VISEMES] = [0, 255, 76, 234, 94, 104, 87, 93, 76, 0, 94, 47, 104];

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

    /// How far the mouth is open by its visemes, 0 closed to 255 as wide as in speech: enough for a servo on a jaw, without the eigenmouths that the parameters need. 0
    /// where the model has no visemes.
    pub fn jaw_open(&self) -> u8 {
        let products = self.viseme_weights.iter().zip(VISEME_OPENNESS);
        // At most 13 · 255².
        let sum: u32 = products.map(|(w, open)| u32::from(*w) * u32::from(open)).sum();
        // Weights add up to 255 but for rounding, which may reach one too far.
        ((sum + 127) / 255).min(255) as u8
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_jaw_opens_as_its_visemes_do() {
        let frame = |weights: &[u8]| {
            let weights = VisemeWeights::from_slice(weights).unwrap();
            ParameterFrame::numbered(0, heapless::Vec::new(), weights)
        };
        let mut one = [0; N_VISEMES];
        for (k, open) in VISEME_OPENNESS.into_iter().enumerate() {
            one.fill(0);
            one[k] = 255;
            assert_eq!(frame(&one).jaw_open(), open);
        }
        // Half shut, half wide open.
        one.fill(0);
        (one[9], one[1]) = (127, 128);
        assert_eq!(frame(&one).jaw_open(), 128);
        assert_eq!(frame(&[255; N_VISEMES]).jaw_open(), 255);
        assert_eq!(frame(&[]).jaw_open(), 0);
    }
}
