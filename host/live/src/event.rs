//! What happens on the line, as everyone who watches gets it.
use std::sync::Arc;

use lipstream::link::Losses;
use lipstream::opening::{Opening, OpeningReader};
use lipstream_core::wire::{Frame, Hello, Profile, Status};

/// Something that happened.
#[derive(Clone, Debug)]
pub enum Event {
    /// How to read the frames that follow. What came before belongs to another run: the samples are counted anew.
    Hello(Arc<Announcement>),
    /// A frame of parameters.
    Frame(Arc<Timed>),
    /// Sound that goes with the frames, where the host has it.
    Sound(Arc<Sound>),
    /// How the device and the line are doing, about once a second.
    Status(Health),
    /// Something that a person should read.
    Notice(Notice),
    /// The source has come to its end.
    End(Arc<str>),
}

/// Who speaks, and how to read it.
#[derive(Clone, Debug, PartialEq)]
pub struct Announcement {
    /// What the source is called, for people.
    pub source: String,
    /// What the device said.
    pub hello: Hello,
    /// The profile that the device was last asked for, where the host knows.
    pub profile: Option<Profile>,
    /// Whether [`Event::Sound`] comes.
    pub sound: bool,
    /// Whether it speaks now.
    pub running: bool,
    /// What reads how open the mouth is, where the mouth of the device's model is known.
    pub opening: Option<Arc<OpeningReader>>,
}

/// A frame, and when it was.
#[derive(Clone, Debug, PartialEq)]
pub struct Timed {
    /// What came over the line.
    pub frame: Frame,
    /// Real units of one LSB of each parameter, as the device's `Hello` says.
    pub hello: Arc<Announcement>,
    /// `frame.sample` without its wrapping at 2³².
    pub sample: u64,
    /// When it came, host's clock, milliseconds.
    pub arrived_ms: f64,
    /// When its sample was heard or sent to the device, where the host knows.
    pub heard_ms: Option<f64>,
}

impl Timed {
    /// The parameters in real units.
    pub fn parameters(&self) -> impl ExactSizeIterator<Item = f32> {
        let scales = &self.hello.hello.scales;
        self.frame
            .parameters
            .iter()
            .zip(scales)
            .map(|(value, scale)| f32::from(*value) * scale)
    }

    /// How open and how wide the mouth is, where the mouth of the device's model is known.
    pub fn opening(&self) -> Option<Opening> {
        let reader = self.hello.opening.as_ref()?;
        Some(reader.read(&self.parameters().collect::<Vec<f32>>()))
    }

    /// The viseme weights, 0 to 1; none where the model has none.
    pub fn visemes(&self) -> impl ExactSizeIterator<Item = f32> {
        self.frame.viseme_weights.iter().map(|w| f32::from(*w) / 255.0)
    }
}

/// A piece of the sound.
#[derive(Clone, Debug, PartialEq)]
pub struct Sound {
    /// Number of its first sample, counted as the frames count.
    pub sample: u64,
    /// 16 kHz mono.
    pub samples: Vec<i16>,
    /// When its first sample was heard, host's clock, milliseconds.
    pub heard_ms: f64,
}

/// How it goes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Health {
    /// What the device says of itself.
    pub device: Status,
    /// What has been lost on the line.
    pub losses: Losses,
}

/// How much a notice matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// Good to know.
    Info,
    /// Something is not as it should be, and may mend itself.
    Warning,
    /// Nothing will come until somebody does something.
    Error,
}

/// Something that a person should read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Notice {
    /// How much it matters.
    pub level: Level,
    /// A sentence or part of one, without a full stop.
    pub text: Arc<str>,
}

/// What a watcher asks of the source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// Begin, or begin anew.
    Start,
    /// End, and give what is still owed.
    Stop,
    /// Trade delay against quality in another way, from a clean start.
    Profile(Profile),
}
