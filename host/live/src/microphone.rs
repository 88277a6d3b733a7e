//! A microphone of this computer, through cpal.
use std::io;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

use cpal::traits::{DeviceTrait as _, HostTrait as _, StreamTrait as _};
use cpal::{
    BufferSize, Device, ErrorKind, FromSample, SampleFormat, SizedSample, SupportedBufferSize,
    SupportedStreamConfig,
};
use lipstream_core::SAMPLE_RATE_HZ;
use lipstream_media::sound::Reader;

use crate::feed::SpeechError;

/// Blocks of sound that wait at most, about a second of them: who is slower loses sound, and the system's own thread is never held up.
const WAITING: usize = 100;
/// Samples a second that are asked for where the microphone can give them: nothing has to be resampled then, which takes 20 to 30 ms.
const WANTED_HZ: u32 = SAMPLE_RATE_HZ;
/// How long opening may take.
const PATIENCE: Duration = Duration::from_secs(5);

/// What comes from the system's thread.
enum Said {
    Samples(Vec<f64>),
    Broken(String),
}

/// Opens the microphone whose name has `wanted` in it, or the system's default one.
pub(crate) fn open(wanted: Option<&str>) -> Result<Reader<'static>, SpeechError> {
    let device = find(wanted)?;
    let name = name_of(&device);
    let fails = |error: cpal::Error| SpeechError::Microphone {
        name: name.clone(),
        why: error.to_string(),
    };
    let config = configuration(&device).map_err(fails)?;
    let (say, said) = sync_channel(WAITING);
    let stream = match config.sample_format() {
        SampleFormat::I16 => listen::<i16>(&device, &config, say),
        SampleFormat::U16 => listen::<u16>(&device, &config, say),
        SampleFormat::I32 => listen::<i32>(&device, &config, say),
        SampleFormat::F32 => listen::<f32>(&device, &config, say),
        other => {
            return Err(SpeechError::Microphone {
                name,
                why: format!("its samples are {other}, which is not read"),
            });
        }
    }
    .map_err(fails)?;
    stream.play().map_err(fails)?;
    let channels = usize::from(config.channels());
    // The stream lives as long as somebody reads.
    let next = move |out: &mut Vec<f64>| {
        let _ = &stream;
        take(&said, out)
    };
    Ok(Reader::of_live(&name, config.sample_rate(), channels, next)?)
}

/// Names of all microphones, for people.
pub(crate) fn names() -> Vec<String> {
    let devices = cpal::default_host().input_devices();
    devices.map_or_else(
        |_| Vec::new(),
        |devices| devices.map(|device| name_of(&device)).collect(),
    )
}

fn name_of(device: &Device) -> String {
    device.description().map_or_else(
        |_| "a microphone without a name".to_owned(),
        |about| about.name().to_owned(),
    )
}

fn find(wanted: Option<&str>) -> Result<Device, SpeechError> {
    let host = cpal::default_host();
    let Some(wanted) = wanted else {
        return host.default_input_device().ok_or(SpeechError::NoMicrophone);
    };
    let low = wanted.to_lowercase();
    let devices = host.input_devices().into_iter().flatten();
    let found = devices
        .into_iter()
        .find(|device| name_of(device).to_lowercase().contains(&low));
    found.ok_or_else(|| match names() {
        names if names.is_empty() => SpeechError::NoMicrophone,
        names => SpeechError::OtherMicrophones {
            wanted: wanted.to_owned(),
            names,
        },
    })
}

/// At 16 kHz with as few channels as there are, where the microphone can; else what it does by itself.
fn configuration(device: &Device) -> Result<SupportedStreamConfig, cpal::Error> {
    let known = |format| {
        matches!(
            format,
            SampleFormat::I16 | SampleFormat::U16 | SampleFormat::I32 | SampleFormat::F32
        )
    };
    let best = device
        .supported_input_configs()?
        .filter(|range| known(range.sample_format()))
        .filter_map(|range| range.try_with_sample_rate(WANTED_HZ))
        .min_by_key(|config| (config.channels(), config.sample_format() != SampleFormat::I16));
    best.map_or_else(|| device.default_input_config(), Ok)
}

/// Starts a stream of blocks of 10 ms, or as near to it as the microphone allows.
fn listen<T: SizedSample>(
    device: &Device,
    config: &SupportedStreamConfig,
    say: SyncSender<Said>,
) -> Result<cpal::Stream, cpal::Error>
where
    f64: FromSample<T>,
{
    let channels = usize::from(config.channels()).max(1);
    let mut wanted = config.config();
    if let SupportedBufferSize::Range { min, max } = *config.buffer_size() {
        wanted.buffer_size = BufferSize::Fixed((config.sample_rate() / 100).clamp(min, max));
    }
    let broken = say.clone();
    device.build_input_stream(
        wanted,
        move |samples: &[T], _| {
            let mix =
                |frame: &[T]| frame.iter().map(|s| f64::from_sample_(*s)).sum::<f64>() / channels as f64;
            let block = samples.chunks_exact(channels).map(mix).collect();
            // Nobody who is too slow, or has gone, is waited for.
            let _ = say.try_send(Said::Samples(block));
        },
        move |error| {
            // Some sound is lost, or comes with less haste, or from elsewhere: it goes on.
            if matches!(
                error.kind(),
                ErrorKind::Xrun | ErrorKind::RealtimeDenied | ErrorKind::DeviceChanged
            ) {
                return;
            }
            let _ = broken.try_send(Said::Broken(error.to_string()));
        },
        Some(PATIENCE),
    )
}

/// The next block; in error when the microphone has broken off.
fn take(said: &Receiver<Said>, out: &mut Vec<f64>) -> io::Result<bool> {
    match said.recv() {
        Ok(Said::Samples(samples)) => {
            out.extend(samples);
            Ok(true)
        }
        Ok(Said::Broken(why)) => Err(io::Error::other(why)),
        Err(_) => Ok(false),
    }
}
