//! Parameters to a moving mouth: pictures (eq. 16 of X&L), video with sound, a page.
//!
//! Time: parameters of frame t belong to sample 160·t + 200 of the sound; picture n is on the
//! screen from n/fps to (n + 1)/fps seconds and shows the parameters of the middle of that time, as training takes picture n
//! of a recording for the middle of its exposure.
use anyhow::{Result, bail};
use lipstream_core::{FRAME_SAMPLES, HOP_SAMPLES, SAMPLE_RATE_HZ};
use ndarray::{Array2, ArrayView2};

use crate::mouth::MouthSpace;
use crate::parameters;
use lipstream_media::encode::{aac, colour, h264, mp4};

pub mod drawn;
pub mod foreign;
pub mod page;
mod painter;

pub use painter::Painter;

/// How pictures are made.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Pictures a second.
    pub fps: u32,
    /// Times the size of the eigenmouths; `None`: about 384 pixels wide.
    pub scale: Option<usize>,
    /// Standard deviation of the camera noise in levels of 0..255 (X&L section 6.1).
    pub noise: f32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            fps: 25,
            scale: None,
            noise: 0.0,
        }
    }
}

/// Largest side of a picture.
const MAX_SIDE: usize = 4096;

impl Settings {
    /// Width and height of the pictures of `space`: multiples of 16, as video codecs like them.
    pub fn size(&self, space: &MouthSpace) -> Result<(usize, usize)> {
        if !(1..=100).contains(&self.fps) {
            bail!("{} pictures a second: choose 1 to 100", self.fps);
        }
        let scale = match self.scale {
            Some(0) => bail!("a scale of 0 leaves nothing to see: choose 1 or more"),
            Some(scale) => scale,
            None => (384 / space.width).max(1),
        };
        let side = |native: usize| (native.saturating_mul(scale).saturating_add(8) / 16 * 16).max(16);
        let (width, height) = (side(space.width), side(space.height));
        if width > MAX_SIDE || height > MAX_SIDE {
            bail!("pictures of {width}×{height}: choose a smaller scale (largest side {MAX_SIDE})");
        }
        Ok((width, height))
    }
}

/// Number of pictures that last as long as `samples` samples of sound.
pub fn picture_count(samples: usize, fps: u32) -> usize {
    (samples as u64 * u64::from(fps)).div_ceil(u64::from(SAMPLE_RATE_HZ)) as usize
}

/// Samples that `frames` parameter frames cover, first window to last.
pub fn samples_covered(frames: usize) -> usize {
    match frames {
        0 => 0,
        n => (n - 1) * HOP_SAMPLES + FRAME_SAMPLES,
    }
}

/// Rows of `tracks`, at 100 Hz, as they are in the middle of each of `pictures` pictures' time; linear in between.
pub fn at_pictures(tracks: ArrayView2<f32>, fps: u32, pictures: usize) -> Array2<f32> {
    let last = tracks.nrows().saturating_sub(1) as f32;
    let mut out = Array2::zeros((pictures, tracks.ncols()));
    for n in 0..pictures {
        let sample = (n as f64 + 0.5) * f64::from(SAMPLE_RATE_HZ) / f64::from(fps);
        let frame = (sample - FRAME_SAMPLES as f64 / 2.0) / HOP_SAMPLES as f64;
        let frame = (frame as f32).clamp(0.0, last);
        let (before, part) = (frame.floor() as usize, frame.fract());
        let after = (before + 1).min(last as usize);
        for ((o, a), b) in out
            .row_mut(n)
            .iter_mut()
            .zip(tracks.row(before))
            .zip(tracks.row(after))
        {
            *o = a + part * (b - a);
        }
    }
    out
}

/// A finished video and what was drawn for it.
pub struct Rendered {
    pub mp4: Vec<u8>,
    pub width: usize,
    pub height: usize,
    pub pictures: usize,
}

/// Draws parameters `[frames, D]` at 100 Hz and writes them as MP4, with `sound` (16 kHz) where there is one.
///
/// `progress` is called with the number of pictures done and of all pictures.
pub fn to_mp4(
    space: &MouthSpace,
    tracks: ArrayView2<f32>,
    sound: Option<&[i16]>,
    settings: &Settings,
    mut progress: impl FnMut(usize, usize),
) -> Result<Rendered> {
    let pictures = pictures_for(space, tracks, sound, settings)?;
    let mut painter = Painter::new(space, settings)?;
    let (width, height) = painter.size();
    let mut encoder = h264::VideoEncoder::new(width, height, settings.fps)?;
    for (n, weights) in pictures.outer_iter().enumerate() {
        encoder.push(colour::from_rgb(&painter.paint(weights)?, width, height))?;
        progress(n + 1, pictures.nrows());
    }
    let sound = match sound {
        Some(samples) if !samples.is_empty() => Some(aac::encode(samples, SAMPLE_RATE_HZ)?),
        _ => None,
    };
    Ok(Rendered {
        mp4: mp4::write(&encoder.finish()?, sound.as_ref())?,
        width,
        height,
        pictures: pictures.nrows(),
    })
}

/// The parameters of each picture; refuses what does not fit the mouth.
fn pictures_for(
    space: &MouthSpace,
    tracks: ArrayView2<f32>,
    sound: Option<&[i16]>,
    settings: &Settings,
) -> Result<Array2<f32>> {
    parameters::check(tracks)?;
    if tracks.ncols() != space.size() {
        bail!(
            "the parameters are {} a frame, the model's mouth has {}: they come from another model",
            tracks.ncols(),
            space.size()
        );
    }
    let samples = sound.map_or(samples_covered(tracks.nrows()), <[i16]>::len);
    let count = picture_count(samples, settings.fps).max(1);
    Ok(at_pictures(tracks, settings.fps, count))
}

#[cfg(test)]
mod tests;
