//! Pictures to H.264 (ITU-T H.264, Constrained Baseline: the profile that every player decodes).
use rusty_h264_common::YuvFrame;
use rusty_h264_encoder::{Encoder, EncoderConfig, Preset};

use super::EncodeError;
use super::colour::Picture;

/// Quantiser, 0..51: 22 keeps mouth pictures 48 dB above the coding error (docs/rendering.md).
const QP: u8 = 22;

/// A track that grows picture by picture. The encoded pictures are handed out, not kept.
pub struct VideoEncoder {
    encoder: Encoder,
    video: Video,
}

/// What an MP4 header says of an H.264 track whose encoded pictures lie elsewhere.
#[derive(Clone, Debug)]
pub struct Video {
    /// Width in pixels.
    pub width: u16,
    /// Height in pixels.
    pub height: u16,
    /// Pictures a second.
    pub fps: u32,
    /// Sequence and picture parameter sets, without start codes.
    pub sps: Vec<u8>,
    /// Picture parameter set, without start code.
    pub pps: Vec<u8>,
    /// Bytes of each picture's sample.
    pub sizes: Vec<u32>,
    /// Whether playing can start at the sample.
    pub key: Vec<bool>,
}

mod nal {
    pub(super) const IDR: u8 = 5;
    pub(super) const SPS: u8 = 7;
    pub(super) const PPS: u8 = 8;
}

impl VideoEncoder {
    /// `fps` pictures a second; a key picture every second, so that seeking is quick.
    ///
    /// # Errors
    ///
    /// That the encoder refuses the size, or that a file cannot hold it.
    pub fn new(width: usize, height: usize, fps: u32) -> Result<Self, EncodeError> {
        let mut config = EncoderConfig::baseline(width, height);
        config.preset = Preset::Balanced;
        config.qp = QP;
        config.gop_size = fps;
        config.framerate = fps as f32;
        let encoder = Encoder::new(config).map_err(|e| EncodeError::Video(e.to_string()))?;
        let side = |side: usize| u16::try_from(side).map_err(|_| EncodeError::Size { width, height });
        Ok(Self {
            encoder,
            video: Video {
                width: side(width)?,
                height: side(height)?,
                fps,
                sps: Vec::new(),
                pps: Vec::new(),
                sizes: Vec::new(),
                key: Vec::new(),
            },
        })
    }

    /// Encodes the next picture and gives its sample as MP4 holds it: NAL units, each after its length in 4 bytes, big-endian.
    ///
    /// # Errors
    ///
    /// That the encoder refuses the picture.
    pub fn push(&mut self, picture: Picture) -> Result<Vec<u8>, EncodeError> {
        let frame = YuvFrame {
            width: picture.width,
            height: picture.height,
            y: picture.y,
            u: picture.cb,
            v: picture.cr,
        };
        let unit = self
            .encoder
            .try_encode(&frame)
            .map_err(|e| EncodeError::Picture {
                picture: self.video.sizes.len(),
                said: e.to_string(),
            })?;
        let (mut sample, mut key) = (Vec::new(), false);
        for nal in nal_units(&unit) {
            match nal[0] & 31 {
                nal::SPS => self.video.sps = nal.to_vec(),
                nal::PPS => self.video.pps = nal.to_vec(),
                kind => {
                    key |= kind == nal::IDR;
                    sample.extend((nal.len() as u32).to_be_bytes());
                    sample.extend(nal);
                }
            }
        }
        if sample.is_empty() {
            return Err(EncodeError::NothingOf(self.video.sizes.len()));
        }
        self.video.sizes.push(sample.len() as u32);
        self.video.key.push(key);
        Ok(sample)
    }

    /// The finished track.
    ///
    /// # Errors
    ///
    /// That no picture came.
    pub fn finish(self) -> Result<Video, EncodeError> {
        if self.video.sps.len() < 4 || self.video.pps.is_empty() {
            return Err(EncodeError::NoPicture);
        }
        Ok(self.video)
    }
}

/// The units of an Annex B byte stream, start codes and the zeros around them taken off; none is empty.
fn nal_units(stream: &[u8]) -> Vec<&[u8]> {
    let mut starts = Vec::new();
    let mut i = 0;
    while i + 3 <= stream.len() {
        if stream[i..i + 3] == [0, 0, 1] {
            starts.push(i);
            i += 3;
        } else {
            i += 1;
        }
    }
    let mut units = Vec::new();
    for (k, &start) in starts.iter().enumerate() {
        let end = starts.get(k + 1).copied().unwrap_or(stream.len());
        let mut unit = &stream[start + 3..end];
        while let [rest @ .., 0] = unit {
            unit = rest;
        }
        if !unit.is_empty() {
            units.push(unit);
        }
    }
    units
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::encode::colour;

    #[test]
    fn start_codes_of_both_lengths() {
        let stream = [
            0, 0, 0, 1, 0x67, 1, 2, 0, 0, 1, 0x68, 3, 0, 0, 0, 1, 0x65, 0, 0, 3, 9,
        ];
        let units: Vec<_> = nal_units(&stream).iter().map(|u| u.to_vec()).collect();
        assert_eq!(units, [vec![0x67, 1, 2], vec![0x68, 3], vec![0x65, 0, 0, 3, 9]]);
    }

    #[test]
    fn another_decoder_sees_the_pictures() {
        let (width, height) = (64, 48);
        let pictures: Vec<Picture> = (0..30).map(|t| blob(width, height, t)).collect();
        let mut encoder = VideoEncoder::new(width, height, 25).unwrap();
        let samples: Vec<Vec<u8>> = pictures
            .iter()
            .map(|p| encoder.push(p.clone()).unwrap())
            .collect();
        let video = encoder.finish().unwrap();
        let sizes: Vec<u32> = samples.iter().map(|s| s.len() as u32).collect();
        assert_eq!(video.sizes, sizes);
        assert_eq!(video.sizes.len(), 30);
        let keys: Vec<usize> = (0..30).filter(|&i| video.key[i]).collect();
        assert_eq!(keys, [0, 25]);

        let mut decoder = rusty_h264_decoder::Decoder::new();
        for (t, sample) in samples.iter().enumerate() {
            let mut stream = Vec::new();
            for set in [&video.sps, &video.pps] {
                stream.extend([0, 0, 0, 1]);
                stream.extend(set);
            }
            let mut rest = &sample[..];
            while let Some((length, tail)) = rest.split_first_chunk::<4>() {
                let (unit, after) = tail.split_at(u32::from_be_bytes(*length) as usize);
                stream.extend([0, 0, 0, 1]);
                stream.extend(unit);
                rest = after;
            }
            let back = decoder.decode(&stream).unwrap().expect("one picture a sample");
            let error: f64 = back
                .y
                .iter()
                .zip(&pictures[t].y)
                .map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2))
                .sum::<f64>()
                / back.y.len() as f64;
            let psnr = 10.0 * (255.0f64.powi(2) / error.max(1e-9)).log10();
            assert!(psnr > 38.0, "picture {t}: {psnr} dB");
        }
    }

    /// A soft dark ellipse that opens and closes on a skin-like ground.
    fn blob(width: usize, height: usize, t: usize) -> Picture {
        let open = 4.0 + 8.0 * (t as f32 * 0.4).sin().abs();
        let mut rgb = Vec::new();
        for row in 0..height {
            for column in 0..width {
                let x = (column as f32 - 32.0) / 20.0;
                let y = (row as f32 - 24.0) / open;
                let inside = 1.0 / (1.0 + ((x * x + y * y - 1.0) * 6.0).exp());
                for (skin, mouth) in [(210.0, 90.0), (160.0, 30.0), (140.0, 40.0)] {
                    rgb.push((skin + inside * (mouth - skin)) as u8);
                }
            }
        }
        colour::from_rgb(&rgb, width, height)
    }
}
