//! Packets of a container into samples: Opus through ropus, everything else through symphonia's decoders.
use ropus::{DecodeMode, Decoder as OpusDecoder};
use symphonia::core::codecs::audio::well_known::CODEC_ID_OPUS;
use symphonia::core::codecs::audio::{AudioCodecParameters, AudioDecoder, AudioDecoderOptions};
use symphonia::core::errors::Error;
use symphonia::core::packet::PacketRef;
use symphonia::core::units::{Duration, Timestamp};

use super::{Result, SoundError, damaged, library};

/// Opus always decodes to this rate here; it is written at lower ones, but time is counted in this.
const OPUS_HZ: u32 = 48_000;
/// The longest packet of Opus: 120 ms.
const OPUS_MOST: usize = 5760;
/// The first bytes of an Opus stream's header.
const OPUS_HEAD: &[u8; 8] = b"OpusHead";

/// A decoder that is ready for packets.
pub(super) enum Codec {
    Opus(Box<Opus>),
    Other {
        decoder: Box<dyn AudioDecoder>,
        rate_hz: u32,
        channels: usize,
        samples: Vec<f64>,
    },
}

/// An Opus stream of one or two channels.
pub(super) struct Opus {
    decoder: OpusDecoder,
    channels: usize,
    /// Samples of every channel that the encoder put before the sound.
    pub(super) pre_skip: u64,
    samples: Vec<f32>,
}

impl Opus {
    /// `head` is the stream's header, RFC 7845 section 5.1.
    pub(super) fn new(head: &[u8]) -> Result<Self> {
        let (Some(head), true) = (head.first_chunk::<19>(), head.starts_with(OPUS_HEAD)) else {
            return damaged("damaged Opus header");
        };
        let channels = match head[9] {
            1 => ropus::Channels::Mono,
            2 => ropus::Channels::Stereo,
            many => {
                return Err(SoundError::Unsupported(format!(
                    "Opus of {many} channels, of which 1 or 2 are read here (convert it with `ffmpeg -i FILE -ac 1 out.wav`)"
                )));
            }
        };
        let decoder = OpusDecoder::new(OPUS_HZ, channels)
            .map_err(|e| SoundError::Damaged(format!("damaged Opus header: {e}")))?;
        Ok(Self {
            decoder,
            channels: channels.count(),
            pre_skip: u64::from(u16::from_le_bytes([head[10], head[11]])),
            samples: Vec::new(),
        })
    }

    fn decode(&mut self, packet: &[u8], out: &mut Vec<f64>) -> Result<()> {
        if packet.is_empty() {
            return damaged("an empty Opus packet");
        }
        self.samples.resize(OPUS_MOST * self.channels, 0.0);
        let decoded = self
            .decoder
            .decode_float(packet, &mut self.samples, DecodeMode::Normal)
            .map_err(|e| SoundError::Damaged(format!("an Opus packet cannot be decoded: {e}")))?;
        out.extend(
            self.samples[..decoded * self.channels]
                .iter()
                .map(|&s| f64::from(s)),
        );
        Ok(())
    }
}

impl Codec {
    /// The decoder that a container's words about a track ask for.
    pub(super) fn new(parameters: &AudioCodecParameters) -> Result<Self> {
        if parameters.codec == CODEC_ID_OPUS {
            return Ok(Self::Opus(Box::new(Opus::new(
                parameters.extra_data.as_deref().unwrap_or_default(),
            )?)));
        }
        let registry = symphonia::default::get_codecs();
        let decoder = registry
            .make_audio_decoder(parameters, &AudioDecoderOptions::default())
            .map_err(said("its sound cannot be decoded"))?;
        Ok(Self::Other {
            decoder,
            rate_hz: parameters.sample_rate.unwrap_or(0),
            channels: parameters
                .channels
                .as_ref()
                .map_or(0, |channels| channels.count()),
            samples: Vec::new(),
        })
    }

    /// Samples a second.
    pub(super) fn rate_hz(&self) -> u32 {
        match self {
            Self::Opus(_) => OPUS_HZ,
            Self::Other { rate_hz, .. } => *rate_hz,
        }
    }

    /// Channels.
    pub(super) fn channels(&self) -> usize {
        match self {
            Self::Opus(opus) => opus.channels,
            Self::Other { channels, .. } => *channels,
        }
    }

    /// Samples that encoders are known to put before the sound: an Opus stream says it, AAC's of ffmpeg and of Apple have these.
    pub(super) fn usual_delays(&self) -> Vec<u64> {
        match self {
            Self::Opus(opus) => vec![opus.pre_skip],
            Self::Other { .. } => vec![1024, 2112],
        }
    }

    /// Appends a packet's samples, interleaved, full scale ±1.
    pub(super) fn decode(&mut self, packet: &[u8], out: &mut Vec<f64>) -> Result<()> {
        match self {
            Self::Opus(opus) => opus.decode(packet, out),
            Self::Other {
                decoder,
                rate_hz,
                channels,
                samples,
            } => {
                let packet = PacketRef::new(0, Timestamp::ZERO, Duration::ZERO, packet);
                let decoded = decoder
                    .decode_ref(&packet)
                    .map_err(said("a packet of sound cannot be decoded"))?;
                let spec = decoded.spec();
                let new = (spec.rate(), spec.channels().count());
                // Some containers leave the rate or the channels to the codec; afterwards they stay.
                if decoded.frames() > 0 && new != (*rate_hz, *channels) {
                    if !samples.is_empty() {
                        return damaged(format!(
                            "{rate_hz} Hz and {channels} channels turn into {} Hz and {}",
                            new.0, new.1
                        ));
                    }
                    (*rate_hz, *channels) = new;
                }
                if decoded.frames() > 0 {
                    decoded.copy_to_vec_interleaved(samples);
                    out.extend_from_slice(samples);
                }
                Ok(())
            }
        }
    }
}

/// What symphonia says: that it reads no such thing, or what is wrong.
pub(super) fn said(what: &str) -> impl FnOnce(Error) -> SoundError {
    move |error| match error {
        Error::Unsupported(why) => SoundError::Unsupported(format!(
            "{what}: {why} (convert it with `ffmpeg -i FILE out.wav`)"
        )),
        Error::IoError(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => {
            SoundError::Damaged("the file is cut short".to_owned())
        }
        other => library(what.to_owned())(other),
    }
}
