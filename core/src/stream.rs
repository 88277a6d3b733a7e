//! Samples in, mouth parameters out: front end, converter and moving average behind one `push`.
use crate::frontend::{Config, FrontEnd, OBSERVATION_DELAY};
use crate::hmm::converter::Converter;
use crate::model::Model;
use crate::parameters::ParameterFrame;
use crate::{FRAME_SAMPLES, HOP_SAMPLES};

pub use crate::hmm::converter::Settings;

/// Active joint states that a device's stream has room for.
pub const TOKENS: usize = 384;
/// Frames of a device's smoothing window: a lag of 8 at most.
pub const FRAMES: usize = 9;
/// The same for a stream of a model with a memory (see [`crate::mge`]), which keeps fewer states and has no lag: with these as
/// its parameters a [`Stream`] takes half the room, and gives the same frames.
pub const MEMORY_TOKENS: usize = crate::hmm::follower::MOST_SHARP;
pub const MEMORY_FRAMES: usize = 1;

/// One stream of speech. The result does not depend on how the samples are cut.
///
/// `TOKENS` bounds the active joint states, `FRAMES` − 1 the lag; [`Stream::new`] makes the device's size. Nothing in
/// here allocates, fails or panics once it is made.
#[derive(Clone, Debug)]
pub struct Stream<'m, const TOKENS: usize = { self::TOKENS }, const FRAMES: usize = { self::FRAMES }> {
    frontend: FrontEnd,
    converter: Converter<'m, TOKENS, FRAMES>,
}

impl<'m> Stream<'m> {
    /// A stream of the device's size.
    #[inline(always)]
    pub fn new(model: &'m Model<'m>, settings: Settings) -> Self {
        Self::sized(model, settings)
    }
}

impl<'m, const TOKENS: usize, const FRAMES: usize> Stream<'m, TOKENS, FRAMES> {
    /// A stream of the size that the type says. A lag beyond `FRAMES` − 1 is held to it, see [`Stream::lag`].
    #[inline(always)]
    pub fn sized(model: &'m Model<'m>, settings: Settings) -> Self {
        Self {
            frontend: FrontEnd::new(Config {
                start_mean: model.start_mean(),
                normalise: true,
            }),
            converter: Converter::new(model, settings),
        }
    }

    /// Takes samples up to the end of the next window; says how many, and the frame that came out.
    ///
    /// Call it until everything is consumed. Samples after [`finish`](Self::finish) start a new stream.
    pub fn push(&mut self, samples: &[i16]) -> (usize, Option<ParameterFrame>) {
        if self.converter.has_ended() {
            self.reset();
        }
        let (consumed, hop) = self.frontend.push(samples);
        let frame = hop.and_then(|hop| {
            self.converter
                .push(hop.statics.as_ref(), hop.observation.as_ref())
        });
        (consumed, frame)
    }

    /// The frames that are still to come, one a call; None when all are out.
    pub fn finish(&mut self) -> Option<ParameterFrame> {
        // Every turn but a few drains an observation or maps a frame, of which at most this many are left.
        for _ in 0..4 * (FRAMES + OBSERVATION_DELAY) + 64 {
            if self.converter.is_done() {
                return None;
            }
            let observation = self.frontend.finish().and_then(|hop| hop.observation);
            let frame = self.converter.push(None, observation.as_ref());
            if frame.is_some() {
                return frame;
            }
        }
        None
    }

    /// Forgets everything; the next frame is frame 0.
    pub fn reset(&mut self) {
        self.frontend.reset();
        self.converter.reset();
    }

    /// Other settings for the same model; starts a new stream.
    pub fn set(&mut self, settings: Settings) {
        self.frontend.reset();
        self.converter.set(settings);
    }

    /// Lag in force, hops.
    pub fn lag(&self) -> usize {
        self.converter.lag()
    }

    /// Active joint states of the newest frame.
    pub fn active(&self) -> usize {
        self.converter.active()
    }

    /// Frames since the beginning in which the beam was narrowed to hold the worst case, see [`Settings::most`] and
    /// [`Settings::phones`].
    pub fn narrowed(&self) -> u32 {
        self.converter.narrowed()
    }

    /// Algorithmic delay in samples: from the centre of a frame's window (its `sample`) to the last sample that its
    /// parameters wait for: 160 · max(lag + 4, last tap), 160 more with the moving average, and half a window of 200; with a
    /// memory 160 · look-ahead and half a window.
    pub fn delay_samples(&self) -> usize {
        self.converter.delay_hops() * HOP_SAMPLES + FRAME_SAMPLES / 2
    }
}
