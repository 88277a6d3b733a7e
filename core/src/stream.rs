//! Samples in, parameters out: the front end and a kind's converter behind one `push`.
use core::marker::PhantomData;

use crate::frame::ParameterFrame;
use crate::frontend::{Config, FrontEnd, OBSERVATION_DELAY};
use crate::kinds::{Convert, Kind};
use crate::model::Model;
use crate::settings::StreamSettings;
use crate::{FRAME_SAMPLES, HOP_SAMPLES};

/// One stream of speech through a model of kind `K`. The result does not depend on how the samples are cut.
///
/// The converter `C` is the kind's, of a device's size unless another one is named with [`Stream::sized`]. Nothing in here
/// allocates, fails or panics once it is made.
#[derive(Clone, Debug)]
pub struct Stream<'m, K: Kind<'m>, C = <K as Kind<'m>>::Converter> {
    frontend: FrontEnd,
    converter: C,
    kind: PhantomData<&'m K>,
}

impl<'m, K: Kind<'m>> Stream<'m, K> {
    /// A stream of the device's size.
    #[inline(always)]
    pub fn new(model: &'m Model<'m, K>, settings: StreamSettings) -> Self {
        Self::sized(model, settings)
    }
}

impl<'m, K: Kind<'m>, C: Convert<'m, K>> Stream<'m, K, C> {
    /// A stream of the size that its converter's type says, for hosts with room to spare: `Stream<Likelihood, Converter<1872, 100>>`.
    ///
    /// Inlined into the place that it is made for: the state is large, and copies of it cost a device its stack.
    #[inline(always)]
    pub fn sized(model: &'m Model<'m, K>, settings: StreamSettings) -> Self {
        Self {
            frontend: FrontEnd::new(Config {
                start_mean: model.head().start_mean(),
                normalise: true,
            }),
            converter: C::new(model, settings),
            kind: PhantomData,
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
        // A turn takes the front end's next held-back observation and lets the converter move one frame on by one of its steps
        // (occupancies, maps, average). Each held-back frame needs at most four turns, so this many are enough; the bound is there
        // only so that the loop ends whatever happens.
        for _ in 0..4 * (C::HELD_BACK + OBSERVATION_DELAY) + 64 {
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
    pub fn set(&mut self, settings: StreamSettings) {
        self.frontend.reset();
        self.converter.set(settings);
    }

    /// Active joint states of the newest frame.
    pub fn active(&self) -> usize {
        self.converter.active()
    }

    /// Frames since the beginning in which the beam was narrowed to hold the worst case, see [`StreamSettings::most`] and
    /// [`StreamSettings::phones`].
    pub fn narrowed(&self) -> u32 {
        self.converter.narrowed()
    }

    /// Algorithmic delay in samples: from the centre of a frame's window (its `sample`) to the last sample that its parameters wait
    /// for. Of a likelihood-trained model 160 · max(lag + 4, last tap), 160 more with the moving average, and half a window of
    /// 200; of a recurrent one 160 · look-ahead and half a window.
    pub fn delay_samples(&self) -> usize {
        self.converter.delay_hops() * HOP_SAMPLES + FRAME_SAMPLES / 2
    }
}
