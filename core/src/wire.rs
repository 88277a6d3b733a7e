//! Messages between device and host: COBS frames, postcard payloads, CRC-16 (`docs/wire.md` is the specification).
//!
//! ```text
//! message → payload (postcard) → payload ‖ CRC-16, low byte first → COBS → 0
//! ```
//!
//! A zero byte ends every frame and is nowhere else, so a receiver that has lost its place finds it again at the
//! next zero. Nothing here allocates or panics, whatever the bytes.
#![deny(
    clippy::indexing_slicing,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic
)]

use core::fmt;

use cobs::{DecodeResult, DecoderState};
use crc::{CRC_16_IBM_3740, Crc, Digest};
use heapless::{String, Vec};
use postcard::ser_flavors::{Cobs, Flavor, Slice};
use serde::{Deserialize, Serialize};

use crate::HOP_SAMPLES;
use crate::frame::{MAX_GROUPS, MAX_PARAMETERS, N_VISEMES, ParameterFrame, VisemeWeights};
use crate::model::Head;
use crate::model::common::GROUP_NAME_SIZE;

/// Version of everything in this file; both ends' `Hello` carry it in their second byte, whatever else changes.
pub const PROTOCOL: u8 = 3;
/// Most samples that a [`ToDevice::Pcm`] carries: one hop.
pub const MAX_PCM_SAMPLES: usize = HOP_SAMPLES;
/// Most bytes of a group's name.
pub const MAX_GROUP_NAME: usize = GROUP_NAME_SIZE;

/// Longest `Pcm`: its number 1, the sequence up to 5, the number of sound bytes 2, the sound 320.
const MAX_PCM: usize = 1 + 5 + 2 + 2 * MAX_PCM_SAMPLES;
/// Longest payload of a `Hello` of so many groups and parameters: its number and the protocol 2, the model up to 5, the rate and the lag up to
/// 3 each, visemes 1, the number of groups 1, each group's name with its length 9 and its size 1, the number of scales 1, the scales 4 each.
pub const fn longest_hello(groups: usize, parameters: usize) -> usize {
    2 + 5 + 3 + 3 + 1 + 1 + groups * (1 + MAX_GROUP_NAME + 1) + 1 + 4 * parameters
}
/// Longest payload of a `Frame` of so many parameters and viseme weights: its number 1, sequence and sample up to 5 each, the number of
/// parameters 1, the parameters up to 3 each, the number of weights 1, the weights.
pub const fn longest_frame(parameters: usize, visemes: usize) -> usize {
    1 + 5 + 5 + 1 + 3 * parameters + 1 + visemes
}
/// Longest payload of a `Status`: its number 1, the load up to 3, four counts up to 5 each.
pub const LONGEST_STATUS: usize = 1 + 3 + 4 * 5;

/// Most bytes of words in a [`Notice`].
pub const MAX_NOTICE: usize = 200;
/// Longest payload of a `Notice`: its number 1, the number of bytes up to 2, the words.
const LONGEST_NOTICE: usize = 1 + 2 + MAX_NOTICE;

/// Longest payload, without its CRC, in bytes: a full `Hello`, 440 (96 parameters in 4 groups of the longest names). A full `Pcm`
/// takes 328, a full `Frame` 314.
pub const MAX_PAYLOAD: usize = longest_hello(MAX_GROUPS, MAX_PARAMETERS);
const _: () = assert!(MAX_PCM <= MAX_PAYLOAD && longest_frame(MAX_PARAMETERS, N_VISEMES) <= MAX_PAYLOAD);
const _: () = assert!(LONGEST_NOTICE <= MAX_PAYLOAD);
/// Longest frame on the line in bytes: payload 440, CRC 2, one COBS byte for the start and each 254 of these (2), the zero: 445.
pub const MAX_ENCODED: usize = encoded_size(MAX_PAYLOAD);

/// Bytes on the line of a frame whose payload has `payload` bytes, at most (a frame whose bytes happen to have zeros in the right
/// places is one byte shorter).
pub const fn encoded_size(payload: usize) -> usize {
    let bytes = payload + CRC_BYTES;
    // COBS: one byte in front, and one for each 254 bytes without a zero.
    1 + bytes + bytes / 254 + 1
}

const CRC_BYTES: usize = 2;
/// CRC-16/IBM-3740 (polynomial 1021, start ffff): check value 29b1.
static CRC: Crc<u16> = Crc::<u16>::new(&CRC_16_IBM_3740);
/// Numbers of messages: the first byte of a payload.
mod number {
    /// The device's `Hello`.
    pub(super) const HELLO_TO_HOST: u8 = 0;
    /// Messages to the host have numbers below this.
    pub(super) const END_TO_HOST: u8 = 4;
    /// The host's `Hello`.
    pub(super) const HELLO_TO_DEVICE: u8 = 4;
    /// Messages to the device have numbers below this.
    pub(super) const END_TO_DEVICE: u8 = 5;
}

/// Device → host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(
    clippy::large_enum_variant,
    reason = "no allocation to put the large variant into"
)]
pub enum ToHost {
    /// What the device is and how to read its frames.
    Hello(Hello),
    /// One frame of parameters.
    Frame(Frame),
    /// How the device is doing.
    Status(Status),
    /// What people should know of the device.
    Notice(Notice),
}

/// What the device is and how to read its frames. Sent at `Start`, after `Profile`, when the host asks, and about once a second.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Hello {
    /// [`PROTOCOL`]. Stays the first field in every version.
    pub protocol: u8,
    /// Which model made the parameters; the host must have the same one to draw them.
    pub model: u32,
    /// Parameter frames a second.
    pub rate_hz: u16,
    /// Samples that the device must hear after a frame's `sample` before it sends that frame.
    pub lag_samples: u16,
    /// Viseme weights in a frame: 0 where the model has no visemes.
    pub visemes: u8,
    /// The named parts of a frame, in the order in which their parameters stand there.
    pub groups: Vec<Group, MAX_GROUPS>,
    /// Real units of one LSB of each parameter, all groups one after another. Carried, not computed with.
    pub scales: Vec<f32, MAX_PARAMETERS>,
}

/// A named part of a frame's parameters.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Group {
    /// Short, lower-case ASCII letters, such as `mouth`.
    pub name: String<MAX_GROUP_NAME>,
    /// Parameters in it.
    pub size: u8,
}

impl Hello {
    /// What a device says that runs this model: `head` of it, `visemes` its viseme weights in a frame.
    pub fn new(head: &Head, visemes: usize, rate_hz: u16, lag_samples: u16) -> Self {
        let groups = head.groups().map(|group| Group {
            // Names fit, as the checked tables have them from the same limit.
            name: String::try_from(group.name).unwrap_or_default(),
            size: group.place.len().min(MAX_PARAMETERS) as u8,
        });
        Self {
            protocol: PROTOCOL,
            model: head.id(),
            rate_hz,
            lag_samples,
            visemes: visemes.min(N_VISEMES) as u8,
            groups: groups.collect(),
            scales: head.parameter_scales().collect(),
        }
    }

    /// Whether the groups' sizes add up to the scales, every group has a name and a size, and the visemes are as many as a frame has
    /// room for.
    fn is_sound(&self) -> bool {
        let sum: usize = self.groups.iter().map(|group| usize::from(group.size)).sum();
        let named = |group: &Group| {
            let letters = group.name.bytes().all(|b| b.is_ascii_lowercase());
            letters && !group.name.is_empty() && group.size > 0
        };
        sum == self.scales.len() && self.groups.iter().all(named) && usize::from(self.visemes) <= N_VISEMES
    }
}

/// One frame of parameters.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Frame {
    /// Counts the frames made since `Start`, sent or not, modulo 2³²: a gap is a loss.
    pub sequence: u32,
    /// Sample at the centre of the frame's window since `Start`, modulo 2³².
    pub sample: u32,
    /// The parameters of all groups one after another, in units of `Hello`'s scales.
    pub parameters: Vec<i16, MAX_PARAMETERS>,
    /// Occupancy of each viseme, 255 = 1, as many as `Hello` says; none where the model has no visemes.
    pub viseme_weights: VisemeWeights,
}

impl Frame {
    /// The message for one frame out of the converter.
    pub fn new(sequence: u32, frame: &ParameterFrame) -> Self {
        Self {
            sequence,
            sample: frame.sample,
            parameters: frame.values.clone(),
            viseme_weights: frame.viseme_weights.clone(),
        }
    }

    /// Whether the frame has as many parameters and viseme weights as `hello` says.
    pub fn fits(&self, hello: &Hello) -> bool {
        self.parameters.len() == hello.scales.len() && self.viseme_weights.len() == usize::from(hello.visemes)
    }
}

/// How the device is doing. Sent about once a second and at `Stop`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Status {
    /// Share of the time since the last `Status` that went into computing, 1000 = all of it. 0 where the board has
    /// no clock to tell.
    pub load_permille: u16,
    /// Hops of sound lost since `Start`: they came before the last was worked off, or got damaged on the line.
    pub overruns: u32,
    /// Frames lost since `Start` because the line was full.
    pub dropped: u32,
    /// Frames since `Start` in which the beam was narrowed so that the deadline holds.
    pub narrowed: u32,
    /// Whole messages since `Start` whose number this protocol does not have: skipped.
    pub unknown: u32,
}

/// What people should know of the device, in words: that it refused a model, why its servos stay where they are, or that its program has
/// ended and why. Nothing is computed with it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Notice {
    /// A sentence or part of one, without a full stop.
    pub words: String<MAX_NOTICE>,
}

impl Notice {
    /// The words that there is room for.
    pub fn new(words: fmt::Arguments) -> Self {
        struct Cut(String<MAX_NOTICE>);
        impl fmt::Write for Cut {
            fn write_str(&mut self, piece: &str) -> fmt::Result {
                // Once a character was left out nothing follows it: an error ends the writing.
                piece
                    .chars()
                    .try_for_each(|letter| self.0.push(letter).map_err(|_| fmt::Error))
            }
        }
        let mut cut = Cut(String::new());
        let _ = fmt::Write::write_fmt(&mut cut, words);
        Self { words: cut.0 }
    }
}

/// Host → device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ToDevice<'a> {
    /// Forget all sound so far and begin: `Hello`, then frames.
    Start,
    /// No more sound: the frames still held back, then `Status`.
    Stop,
    /// Use another trade-off of delay against quality, from a clean start as with `Start`.
    Profile(Profile),
    /// Sound for boards without a microphone, and for QEMU.
    #[serde(borrow)]
    Pcm(Pcm<'a>),
    /// Who asks, and please say `Hello`: the device answers whatever the host's protocol is, and stops if it is another.
    Hello {
        /// The host's [`PROTOCOL`]. Stays the first field in every version.
        protocol: u8,
    },
}

/// Delay profiles (docs/design.md section 5).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Profile {
    /// At most 45 ms of algorithmic delay: 42.5 ms with a recurrent model.
    Live,
    /// At most 80 ms: 72.5 ms with a recurrent model.
    Standard,
    /// No limit: the host delays the sound.
    Studio,
}

/// Up to [`MAX_PCM_SAMPLES`] samples, 16 kHz mono.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pcm<'a> {
    /// Counts the `Pcm` messages since `Start`, modulo 2³².
    pub sequence: u32,
    /// i16, low byte first.
    bytes: &'a [u8],
}

impl<'a> Pcm<'a> {
    /// A message whose samples are written to `bytes`; the samples that it has room for, 160 at most.
    pub fn new(sequence: u32, samples: &[i16], bytes: &'a mut [u8; 2 * MAX_PCM_SAMPLES]) -> Self {
        let mut length = 0;
        for (pair, sample) in bytes.chunks_exact_mut(2).zip(samples) {
            pair.copy_from_slice(&sample.to_le_bytes());
            length += 2;
        }
        let bytes = bytes.get(..length).unwrap_or_default();
        Self { sequence, bytes }
    }

    /// The samples in time order.
    pub fn samples(&self) -> impl ExactSizeIterator<Item = i16> + use<'a> {
        self.bytes.chunks_exact(2).map(|pair| match *pair {
            [low, high] => i16::from_le_bytes([low, high]),
            _ => 0,
        })
    }
}

/// Why bytes between two zeros are no message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum WireError {
    /// The frame ended inside a COBS run or is shorter than its CRC.
    Cut,
    /// More bytes than any message has.
    TooLong,
    /// The CRC does not fit the payload.
    Damaged,
    /// A message of this protocol whose fields do not fit, or bytes left over behind one.
    Malformed,
    /// A whole message of a number that this protocol does not have. To be skipped.
    Unknown {
        /// The number's first byte.
        number: u8,
    },
    /// A `Hello` of another protocol version.
    Protocol {
        /// The version that the other end speaks.
        theirs: u8,
    },
}

impl fmt::Display for WireError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Cut => write!(f, "frame cut short"),
            Self::TooLong => write!(f, "frame longer than any message"),
            Self::Damaged => write!(f, "frame damaged: its checksum does not fit"),
            Self::Malformed => write!(f, "frame is no message of protocol {PROTOCOL}"),
            Self::Unknown { number } => {
                write!(f, "message {number} is not one of protocol {PROTOCOL}: skipped")
            }
            Self::Protocol { theirs } => {
                write!(f, "the other end speaks protocol {theirs}, this one {PROTOCOL}")
            }
        }
    }
}

impl core::error::Error for WireError {}

/// The buffer is smaller than the message; [`MAX_ENCODED`] bytes are always enough.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BufferTooSmall;

impl fmt::Display for BufferTooSmall {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "buffer smaller than the message; {MAX_ENCODED} bytes are always enough"
        )
    }
}

impl core::error::Error for BufferTooSmall {}

/// A message of one direction.
pub trait Message<'a>: Serialize + Deserialize<'a> {
    /// The message of a payload whose CRC was right.
    fn from_payload(payload: &'a [u8]) -> Result<Self, WireError>;
}

impl<'a> Message<'a> for ToHost {
    fn from_payload(payload: &'a [u8]) -> Result<Self, WireError> {
        match *payload {
            [number::HELLO_TO_HOST, theirs, ..] if theirs != PROTOCOL => Err(WireError::Protocol { theirs }),
            [number, ..] if number >= number::END_TO_HOST => Err(WireError::Unknown { number }),
            _ => match parse(payload)? {
                Self::Hello(hello) if !hello.is_sound() => Err(WireError::Malformed),
                message => Ok(message),
            },
        }
    }
}

impl<'a> Message<'a> for ToDevice<'a> {
    fn from_payload(payload: &'a [u8]) -> Result<Self, WireError> {
        match *payload {
            [number::HELLO_TO_DEVICE, theirs, ..] if theirs != PROTOCOL => {
                Err(WireError::Protocol { theirs })
            }
            [number, ..] if number >= number::END_TO_DEVICE => Err(WireError::Unknown { number }),
            _ => match parse(payload)? {
                ToDevice::Pcm(pcm) if pcm.bytes.len() % 2 != 0 || pcm.bytes.len() > 2 * MAX_PCM_SAMPLES => {
                    Err(WireError::Malformed)
                }
                message => Ok(message),
            },
        }
    }
}

/// A whole payload, nothing left over.
fn parse<'a, M: Deserialize<'a>>(payload: &'a [u8]) -> Result<M, WireError> {
    match postcard::take_from_bytes(payload) {
        Ok((message, [])) => Ok(message),
        _ => Err(WireError::Malformed),
    }
}

/// Writes `message` as one frame, its closing zero included, to the start of `buffer` and returns that part.
pub fn encode<'b, 'a>(
    message: &impl Message<'a>,
    buffer: &'b mut [u8],
) -> Result<&'b mut [u8], BufferTooSmall> {
    let frame = Cobs::try_new(Slice::new(buffer)).and_then(|inner| {
        let digest = CRC.digest();
        postcard::serialize_with_flavor(message, WithCrc { digest, inner })
    });
    frame.map_err(|_| BufferTooSmall)
}

/// Sends bytes on and, at the end, their CRC.
struct WithCrc<F> {
    digest: Digest<'static, u16>,
    inner: F,
}

impl<F: Flavor> Flavor for WithCrc<F> {
    type Output = F::Output;

    fn try_push(&mut self, byte: u8) -> postcard::Result<()> {
        self.digest.update(&[byte]);
        self.inner.try_push(byte)
    }

    fn finalize(mut self) -> postcard::Result<F::Output> {
        self.inner.try_extend(&self.digest.finalize().to_le_bytes())?;
        self.inner.finalize()
    }
}

/// Takes bytes off a line one by one and gives messages.
#[derive(Debug)]
pub struct Receiver {
    cobs: DecoderState,
    /// Decoded so far: payload and CRC.
    bytes: Vec<u8, { MAX_PAYLOAD + CRC_BYTES }>,
    /// The frame outgrew `bytes`.
    overlong: bool,
    /// The last byte ended a frame: `bytes` holds it until the next one.
    ended: bool,
}

impl Default for Receiver {
    fn default() -> Self {
        Self::new()
    }
}

impl Receiver {
    /// At the start of a frame.
    pub const fn new() -> Self {
        Self {
            cobs: DecoderState::Idle,
            bytes: Vec::new(),
            overlong: false,
            ended: false,
        }
    }

    /// Takes one byte. `None` inside a frame and for the zeros between frames; at the end of a frame its message, or
    /// why it is none. Either way the next byte begins afresh.
    pub fn push<'a, M: Message<'a>>(&'a mut self, byte: u8) -> Option<Result<M, WireError>> {
        if core::mem::take(&mut self.ended) {
            self.bytes.clear();
            self.overlong = false;
        }
        match self.cobs.feed(byte) {
            Ok(DecodeResult::NoData) => None,
            Ok(DecodeResult::DataContinue(decoded)) => {
                self.overlong |= self.bytes.push(decoded).is_err();
                None
            }
            Ok(DecodeResult::DataComplete) => {
                self.ended = true;
                Some(self.payload().and_then(M::from_payload))
            }
            Err(_) => {
                self.ended = true;
                Some(Err(if self.overlong {
                    WireError::TooLong
                } else {
                    WireError::Cut
                }))
            }
        }
    }

    /// The payload of a whole frame, its CRC checked and taken off.
    fn payload(&self) -> Result<&[u8], WireError> {
        if self.overlong {
            return Err(WireError::TooLong);
        }
        let (payload, crc) = self.bytes.split_last_chunk::<CRC_BYTES>().ok_or(WireError::Cut)?;
        if CRC.checksum(payload) == u16::from_le_bytes(*crc) {
            Ok(payload)
        } else {
            Err(WireError::Damaged)
        }
    }
}
