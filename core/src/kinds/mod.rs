//! The kinds of model, a folder each. The kind of a model is a type: its tables, and the converter that runs them.
//!
//! To add a kind: its folder (tables with readers and writers, a converter, [`Kind`] and [`Convert`] for them) and its line in
//! `any!` below. Nothing else asks which kind a model is.
pub mod hierarchical;
pub mod likelihood;
pub mod recurrent;

use core::fmt;

pub use hierarchical::Hierarchical;
pub use likelihood::Likelihood;
pub use recurrent::Recurrent;

use crate::frame::ParameterFrame;
use crate::logmath::LogProb;
use crate::model::container::Sections;
use crate::model::{Head, Model, ModelError};
use crate::settings::{Setting, StreamSettings};
use crate::stream::Stream;
use crate::{N_OBSERVATION, N_STATIC};

pub(crate) mod sealed {
    /// Kinds are made here only.
    pub trait Sealed {}
}

/// A kind of model: the type of its tables, borrowed for `'a`.
pub trait Kind<'a>: Copy + fmt::Debug + sealed::Sealed + 'a {
    /// Number of the kind in the header of the tables.
    const TAG: u16;
    /// Name of the type, which is what messages call the kind.
    const NAME: &'static str;
    /// What runs models of this kind, of a device's size.
    type Converter: Convert<'a, Self>;

    /// Takes the kind's sections and checks every number that could lead its converter astray.
    ///
    /// # Errors
    ///
    /// [`ModelError`] names the first section that is missing, has the wrong length or holds a number out of its range.
    fn read(sections: &mut Sections<'a>, head: &Head<'a>) -> Result<Self, ModelError>;

    /// Whether the setting changes anything in streams of this model.
    fn understands(&self, setting: Setting) -> bool;

    /// Viseme weights of a frame; 0 where the kind has no visemes.
    fn n_visemes(&self) -> usize;

    /// The beam of the model's own settings; None where nothing is searched.
    fn beam(&self) -> Option<LogProb> {
        None
    }
}

/// What turns the front end's numbers into parameters, the state of one stream of a model of kind `K`.
pub trait Convert<'m, K>: sealed::Sealed {
    /// Frames that it may hold back, at most.
    const HELD_BACK: usize;

    /// A stream from frame 0 on. Inlined into the place that it is made for: the state is large, and copies of it cost a device its
    /// stack.
    fn new(model: &'m Model<'m, K>, settings: StreamSettings) -> Self;

    /// Other settings; starts a new stream.
    fn set(&mut self, settings: StreamSettings);

    /// Forgets the stream; the next frame is frame 0.
    fn reset(&mut self);

    /// One hop: the next frame's statics (None once the sound has ended), the next observation if there is one yet, both Q7.8. Gives
    /// at most one frame, [`Convert::delay_hops`] late.
    fn push(
        &mut self,
        statics: Option<&[i16; N_STATIC]>,
        observation: Option<&[i16; N_OBSERVATION]>,
    ) -> Option<ParameterFrame>;

    /// Whether the sound has ended.
    fn has_ended(&self) -> bool;

    /// Whether the sound has ended and every frame has been given out.
    fn is_done(&self) -> bool;

    /// Hops between a frame and the hop that brings its parameters out.
    fn delay_hops(&self) -> usize;

    /// Active joint states of the newest frame; 0 of kinds that have none.
    fn active(&self) -> usize;

    /// Frames since the beginning in which more was worth following than the bounds of [`StreamSettings`] allow.
    fn narrowed(&self) -> u32;
}

macro_rules! any {
    ($($kind:ident: $article:literal),* $(,)?) => {
        /// A checked model of whichever kind, for programs that learn the kind when they run.
        #[derive(Clone, Copy, Debug)]
        #[allow(clippy::large_enum_variant, reason = "slices into tables, of which a program has one set; there is no heap to put them on")]
        pub enum AnyModel<'a> {
            $(
                #[doc = concat!($article, " model.")]
                $kind(Model<'a, $kind<'a>>),
            )*
        }

        impl<'a> AnyModel<'a> {
            /// Checks `bytes` from the first to the last.
            ///
            /// # Errors
            ///
            /// [`ModelError`] says what is wrong.
            pub fn new_checked(bytes: &'a [u8]) -> Result<Self, ModelError> {
                match Sections::open(bytes)?.kind() {
                    $(<$kind as Kind>::TAG => Model::new_checked(bytes).map(Self::$kind),)*
                    kind => Err(ModelError::UnknownKind { kind }),
                }
            }

            /// What every model has.
            pub fn head(&self) -> &Head<'a> {
                match self {
                    $(Self::$kind(model) => model.head(),)*
                }
            }

            /// Name of the kind: that of its type here, see [`Kind::NAME`].
            pub fn kind_name(&self) -> &'static str {
                match self {
                    $(Self::$kind(_) => <$kind as Kind>::NAME,)*
                }
            }

            /// Whether the setting changes anything in streams of this model.
            pub fn understands(&self, setting: Setting) -> bool {
                match self {
                    $(Self::$kind(model) => model.own().understands(setting),)*
                }
            }

            /// Viseme weights of a frame; 0 where the model has no visemes.
            pub fn n_visemes(&self) -> usize {
                match self {
                    $(Self::$kind(model) => model.own().n_visemes(),)*
                }
            }
        }

        /// A stream through a model of whichever kind, see [`Stream`]. It is as large as that of the largest kind.
        #[derive(Clone, Debug)]
        #[allow(clippy::large_enum_variant, reason = "no allocation to put the large variant into")]
        pub enum AnyStream<'m> {
            $(
                #[doc = concat!($article, " model's stream.")]
                $kind(Stream<'m, $kind<'m>>),
            )*
        }

        impl<'m> AnyStream<'m> {
            /// A stream of the device's size.
            pub fn new(model: &'m AnyModel<'m>, settings: StreamSettings) -> Self {
                match model {
                    $(AnyModel::$kind(model) => Self::$kind(Stream::new(model, settings)),)*
                }
            }

            /// See [`Stream::push`].
            pub fn push(&mut self, samples: &[i16]) -> (usize, Option<ParameterFrame>) {
                match self {
                    $(Self::$kind(stream) => stream.push(samples),)*
                }
            }

            /// See [`Stream::finish`].
            pub fn finish(&mut self) -> Option<ParameterFrame> {
                match self {
                    $(Self::$kind(stream) => stream.finish(),)*
                }
            }

            /// See [`Stream::reset`].
            pub fn reset(&mut self) {
                match self {
                    $(Self::$kind(stream) => stream.reset(),)*
                }
            }

            /// See [`Stream::set`].
            pub fn set(&mut self, settings: StreamSettings) {
                match self {
                    $(Self::$kind(stream) => stream.set(settings),)*
                }
            }

            /// See [`Stream::active`].
            pub fn active(&self) -> usize {
                match self {
                    $(Self::$kind(stream) => stream.active(),)*
                }
            }

            /// See [`Stream::narrowed`].
            pub fn narrowed(&self) -> u32 {
                match self {
                    $(Self::$kind(stream) => stream.narrowed(),)*
                }
            }

            /// See [`Stream::delay_samples`].
            pub fn delay_samples(&self) -> usize {
                match self {
                    $(Self::$kind(stream) => stream.delay_samples(),)*
                }
            }
        }

        /// Name of the kind that has this number in the header of the tables.
        pub(crate) fn name_of(tag: u16) -> Option<&'static str> {
            match tag {
                $(<$kind as Kind>::TAG => Some(<$kind as Kind>::NAME),)*
                _ => None,
            }
        }
    };
}

any! {
    Likelihood: "A likelihood-trained",
    Recurrent: "A recurrent",
    Hierarchical: "A hierarchical",
}
