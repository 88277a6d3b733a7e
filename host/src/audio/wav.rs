//! WAV: 8, 16, 24 and 32 bit integers, 32 bit floats.
use std::io::Cursor;

use anyhow::{Context, Result, bail};
use hound::{SampleFormat, WavReader};

use super::{Decoded, mix_down};

/// Decodes a whole WAV file.
pub(super) fn decode(bytes: &[u8]) -> Result<Decoded> {
    let reader = WavReader::new(Cursor::new(bytes)).context("damaged or unusual WAV header")?;
    let spec = reader.spec();
    if spec.channels == 0 {
        bail!("the WAV header says 0 channels");
    }
    let promised = reader.len() as usize;
    let interleaved = match spec.sample_format {
        SampleFormat::Int => {
            let full_scale = 2f64.powi(i32::from(spec.bits_per_sample) - 1);
            gather(
                reader
                    .into_samples::<i32>()
                    .map(|s| Ok(f64::from(s?) / full_scale)),
            )
        }
        SampleFormat::Float => gather(reader.into_samples::<f32>().enumerate().map(|(i, s)| {
            let s = s?;
            if !s.is_finite() {
                bail!("sample {i} is not a finite number");
            }
            Ok(f64::from(s))
        })),
    };
    let (samples, error) = interleaved;
    if let Some(error) = error {
        // hound reports the end of the file as a failed read.
        if error.downcast_ref::<hound::Error>().is_some() && samples.len() < promised {
            bail!(
                "the header promises {promised} samples, the file ends after {}: it is cut short",
                samples.len()
            );
        }
        return Err(error);
    }
    Ok(Decoded {
        samples: mix_down(&samples, usize::from(spec.channels)),
        rate_hz: spec.sample_rate,
        channels: usize::from(spec.channels),
    })
}

/// Collects until the first error; the header's length is not believed in advance.
fn gather(samples: impl Iterator<Item = Result<f64>>) -> (Vec<f64>, Option<anyhow::Error>) {
    let mut out = Vec::new();
    for sample in samples {
        match sample {
            Ok(sample) => out.push(sample),
            Err(error) => return (out, Some(error)),
        }
    }
    (out, None)
}
