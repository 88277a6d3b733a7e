//! Any rate to 16 kHz, piece by piece.
use audioadapter_buffers::owned::InterleavedOwned;
use rubato::{Fft, FixedSync, Indexing, Resampler as _};

use super::{RATES_HZ, Result, SoundError, library, to_i16};

/// Least number of input samples that the resampler takes at a time.
const LEAST_CHUNK: usize = 1024;

/// Samples a block: whole periods of the rate pair, and an even number of them, because the resampler's filter
/// is centred on half a block and an odd one would come out up to a sample early.
pub(super) fn chunk(rate_hz: u32) -> usize {
    let (mut a, mut b) = (rate_hz, lipstream_core::SAMPLE_RATE_HZ);
    while b > 0 {
        (a, b) = (b, a % b);
    }
    let two_periods = 2 * (rate_hz / a) as usize;
    LEAST_CHUNK.div_ceil(two_periods) * two_periods
}

/// Resamples one channel to 16 kHz; n samples become ⌈n·16000/rate⌉, time 0 stays time 0.
pub(super) struct To16Khz {
    rate_hz: u32,
    /// None where the rate is 16 kHz already.
    fft: Option<Box<Blocks>>,
}

/// Sound that somebody else hands over as it comes, at any rate, to what the front end takes: 16 kHz, i16. What comes out does not depend on how the
/// samples are cut, and is what [`Reader`](super::Reader) makes of a file with the same samples.
pub struct Resampler {
    to_16_khz: To16Khz,
    taken: Vec<f64>,
    given: Vec<f64>,
}

impl Resampler {
    /// For sound of `rate_hz`, 8 to 192 kHz.
    ///
    /// # Errors
    ///
    /// [`SoundError::Rate`]: the rate is none that is read.
    pub fn new(rate_hz: u32) -> Result<Self> {
        Ok(Self {
            to_16_khz: To16Khz::new(rate_hz)?,
            taken: Vec::new(),
            given: Vec::new(),
        })
    }

    /// Takes mono samples, full scale ±1, and appends what they bring out: nothing until a block of 5 to 130 ms is full.
    ///
    /// # Errors
    ///
    /// That the resampler refuses them.
    pub fn push(&mut self, samples: &[f32], out: &mut Vec<i16>) -> Result<()> {
        self.taken.clear();
        self.taken.extend(samples.iter().copied().map(f64::from));
        self.given.clear();
        self.to_16_khz.push(&self.taken, &mut self.given)?;
        out.extend(self.given.iter().copied().map(to_i16));
        Ok(())
    }

    /// The sound has ended: appends what is still owed.
    ///
    /// # Errors
    ///
    /// As [`Resampler::push`].
    pub fn finish(mut self, out: &mut Vec<i16>) -> Result<()> {
        self.given.clear();
        self.to_16_khz.finish(&mut self.given)?;
        out.extend(self.given.iter().copied().map(to_i16));
        Ok(())
    }
}

/// A resampler that takes whole blocks.
struct Blocks {
    fft: Fft<f64>,
    /// Samples that fill no block yet.
    waiting: Vec<f64>,
    /// Samples of the output that are still to be left out: the filter's delay.
    trim: usize,
    taken: u64,
    given: u64,
}

impl To16Khz {
    pub(super) fn new(rate_hz: u32) -> Result<Self> {
        if !RATES_HZ.contains(&rate_hz) {
            return Err(SoundError::Rate { rate_hz });
        }
        if rate_hz == lipstream_core::SAMPLE_RATE_HZ {
            return Ok(Self { rate_hz, fft: None });
        }
        let fft = Fft::<f64>::new(
            rate_hz as usize,
            lipstream_core::SAMPLE_RATE_HZ as usize,
            chunk(rate_hz),
            1,
            FixedSync::Both,
        )
        .map_err(library(format!("cannot resample {rate_hz} Hz")))?;
        Ok(Self {
            rate_hz,
            fft: Some(Box::new(Blocks {
                trim: fft.output_delay(),
                fft,
                waiting: Vec::new(),
                taken: 0,
                given: 0,
            })),
        })
    }

    /// Takes `samples`, cut anywhere, and appends what they bring out.
    pub(super) fn push(&mut self, samples: &[f64], out: &mut Vec<f64>) -> Result<()> {
        let Some(blocks) = &mut self.fft else {
            out.extend(samples);
            return Ok(());
        };
        blocks.taken += samples.len() as u64;
        blocks.waiting.extend(samples);
        let mut rest = std::mem::take(&mut blocks.waiting);
        let block = blocks.fft.input_frames_next();
        let whole = rest.len() / block * block;
        for block in rest[..whole].chunks_exact(block) {
            blocks.block(block, self.rate_hz, out)?;
        }
        rest.drain(..whole);
        blocks.waiting = rest;
        Ok(())
    }

    /// The sound has ended: appends what is still owed.
    pub(super) fn finish(&mut self, out: &mut Vec<f64>) -> Result<()> {
        let Some(blocks) = &mut self.fft else {
            return Ok(());
        };
        let all = (blocks.fft.resample_ratio() * blocks.taken as f64).ceil() as u64;
        let mut last = std::mem::take(&mut blocks.waiting);
        let before = out.len();
        let owed = all.saturating_sub(blocks.given) as usize;
        while out.len() - before < owed {
            last.resize(blocks.fft.input_frames_next(), 0.0);
            blocks.block(&last, self.rate_hz, out)?;
            last.clear();
        }
        out.truncate(before + owed);
        Ok(())
    }
}

impl Blocks {
    fn block(&mut self, samples: &[f64], rate_hz: u32, out: &mut Vec<f64>) -> Result<()> {
        let failed = || library(format!("cannot resample {rate_hz} Hz"));
        let input = InterleavedOwned::new_from(samples.to_vec(), 1, samples.len())
            .map_err(library(format!("cannot resample {rate_hz} Hz")))?;
        let mut output = InterleavedOwned::new(0.0, 1, self.fft.output_frames_max());
        let (_, given) = self
            .fft
            .process_into_buffer(&input, &mut output, None::<&Indexing>)
            .map_err(failed())?;
        let output = output.take_data();
        let late = self.trim.min(given);
        self.trim -= late;
        self.given += (given - late) as u64;
        out.extend(&output[late..given]);
        Ok(())
    }
}
