//! What may be chosen when a stream is made, whatever the kind of its model.
use crate::logmath::LogProb;
use crate::wire::Profile;

/// Choices for one stream; None leaves a choice to the model. A kind of model that does not know a setting takes no notice of it:
/// see [`Kind::understands`](crate::kinds::Kind::understands).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct StreamSettings {
    /// Hops that an occupancy waits for, beyond the look-ahead of ΔΔ; held to what the window has room for.
    pub lag: Option<u16>,
    /// Width of the beam; held to 16384 bits, which is no beam at all.
    pub beam: Option<LogProb>,
    /// Exponent on the audio likelihood, Q16.16; held to 4.
    pub acoustic_scale: Option<u32>,
    /// Whether three frames are averaged.
    pub average: Option<bool>,
    /// Hops of future that a recurrent model waits for; held to its latest tap. Where that reaches further, the newest frame stands
    /// for those that are not known yet. Other models have one look-ahead.
    pub look_ahead: Option<u16>,
    /// Active joint states, at most; held to the stream's room. With [`StreamSettings::phones`] it bounds the work of the worst
    /// frame.
    pub most: Option<u16>,
    /// Phones whose states a recurrent model evaluates in one frame, at most and at least one. It bites only in frames that reach
    /// more than 416 joint states, as many as a first frame of 32 phones has.
    pub phones: Option<u16>,
    /// The mouth by the paper's EM in place of the maps (see [`crate::kinds::likelihood::feedback`]): exponent of the visual
    /// likelihood, Q16.16, held to 4; 0 is EM without feedback. Models without visual densities keep their way. The lag is held
    /// to the window's room less one frame.
    pub feedback: Option<u32>,
    /// Whether a mouth that hardly moves is followed slowly (see [`crate::kinds::recurrent::settle`]); the default of recurrent
    /// models, which alone can.
    pub settle: Option<bool>,
}

/// The names of [`StreamSettings`], for questions about them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Setting {
    /// [`StreamSettings::lag`]
    Lag,
    /// [`StreamSettings::beam`]
    Beam,
    /// [`StreamSettings::acoustic_scale`]
    AcousticScale,
    /// [`StreamSettings::average`]
    Average,
    /// [`StreamSettings::look_ahead`]
    LookAhead,
    /// [`StreamSettings::most`]
    Most,
    /// [`StreamSettings::phones`]
    Phones,
    /// [`StreamSettings::feedback`]
    Feedback,
    /// [`StreamSettings::settle`]
    Settle,
}

impl StreamSettings {
    /// The model's own settings.
    pub const OWN: Self = Self {
        lag: None,
        beam: None,
        acoustic_scale: None,
        average: None,
        look_ahead: None,
        most: None,
        phones: None,
        feedback: None,
        settle: None,
    };

    /// What a profile means (docs/design.md section 5) to models of every kind.
    pub const fn of(profile: Profile) -> Self {
        match profile {
            // Recurrent: 30 ms and half a window. Likelihood-trained: the least delay that observations with ΔΔ and the maps allow.
            Profile::Live => Self {
                lag: Some(0),
                average: Some(false),
                look_ahead: Some(3),
                ..Self::OWN
            },
            // Recurrent: 60 ms and half a window. Likelihood-trained: as the model was made.
            Profile::Standard => Self {
                look_ahead: Some(6),
                ..Self::OWN
            },
            // All that the model can use.
            Profile::Studio => Self {
                lag: Some(u16::MAX),
                ..Self::OWN
            },
        }
    }
}
