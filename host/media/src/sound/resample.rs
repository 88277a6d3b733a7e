//! Any rate to 16 kHz.
use audioadapter_buffers::owned::InterleavedOwned;
use rubato::{Fft, FixedSync, Resampler};

use super::{Result, library};

/// Least number of input samples that the resampler takes at a time.
const LEAST_CHUNK: usize = 1024;

/// Samples a block: whole periods of the rate pair, and an even number of them, because the resampler's filter
/// is centred on half a block and an odd one would come out up to a sample early.
fn chunk(rate_hz: u32) -> usize {
    let (mut a, mut b) = (rate_hz, lipstream_core::SAMPLE_RATE_HZ);
    while b > 0 {
        (a, b) = (b, a % b);
    }
    let two_periods = 2 * (rate_hz / a) as usize;
    LEAST_CHUNK.div_ceil(two_periods) * two_periods
}

/// Resamples one channel to 16 kHz; n samples become ⌈n·16000/rate⌉, time 0 stays time 0.
pub(super) fn to_16_khz(samples: Vec<f64>, rate_hz: u32) -> Result<Vec<f64>> {
    if rate_hz == lipstream_core::SAMPLE_RATE_HZ {
        return Ok(samples);
    }
    let length = samples.len();
    let input = InterleavedOwned::new_from(samples, 1, length).map_err(library("cannot resample"))?;
    let mut resampler = Fft::<f64>::new(
        rate_hz as usize,
        lipstream_core::SAMPLE_RATE_HZ as usize,
        chunk(rate_hz),
        1,
        FixedSync::Both,
    )
    .map_err(library(format!("cannot resample {rate_hz} Hz")))?;
    let output = resampler
        .process_all(&input, length, None)
        .map_err(library(format!("cannot resample {rate_hz} Hz")))?;
    Ok(output.take_data())
}
