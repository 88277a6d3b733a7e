//! Sound for the video: AAC-LC access units (ISO/IEC 14496-3) without a container.
use std::io::Write;

use super::EncodeError;

/// Samples of one access unit.
pub const FRAME_SAMPLES: u32 = 1024;
/// Bits a second: at 16 kHz mono the decoded speech is 30 dB and more above its error (docs/rendering.md).
const BITRATE: u32 = 64_000;

/// Samples that are encoded at a time: a second's worth, which bounds the memory that a long sound takes.
const PIECE: usize = 16_384;

/// What an MP4 header says of one mono sound track whose access units lie elsewhere.
#[derive(Clone, Debug)]
pub struct Sound {
    /// Samples a second.
    pub rate_hz: u32,
    /// AudioSpecificConfig, for the container's header.
    pub config: Vec<u8>,
    /// Bytes of each access unit.
    pub sizes: Vec<u32>,
    /// Samples that a decoder yields before the first real one.
    pub priming: u32,
    /// Real samples.
    pub samples: u64,
}

/// Encodes mono samples and writes their access units one after the other, nothing between them.
pub struct SoundEncoder {
    rate_hz: u32,
    encoder: syom::Encoder,
    sizes: Vec<u32>,
    samples: u64,
    plane: Vec<f32>,
    /// The encoder's callback cannot say that a disk is full, so units are written between its calls.
    bytes: Vec<u8>,
}

impl SoundEncoder {
    /// An encoder of one channel.
    ///
    /// # Errors
    ///
    /// That it does not know the rate.
    pub fn new(rate_hz: u32) -> Result<Self, EncodeError> {
        let mut options = syom::EncodeOptions::raw();
        options.bitrate_bps = BITRATE;
        options.band_refine = true;
        options.lookahead = true;
        Ok(Self {
            rate_hz,
            encoder: syom::Encoder::new(rate_hz, 1, &options)
                .map_err(|e| EncodeError::SoundRate(e.into()))?,
            sizes: Vec::new(),
            samples: 0,
            plane: Vec::new(),
            bytes: Vec::new(),
        })
    }

    /// Encodes samples, cut anywhere, and writes the units that are whole to `out`.
    ///
    /// # Errors
    ///
    /// That the encoder refuses the samples, and what `out` says.
    pub fn feed(&mut self, samples: &[i16], out: &mut dyn Write) -> Result<(), EncodeError> {
        for piece in samples.chunks(PIECE) {
            self.plane.clear();
            self.plane.extend(piece.iter().map(|&s| f32::from(s) / 32768.0));
            self.encoder
                .feed(&[&self.plane], |unit| {
                    self.sizes.push(unit.payload.len() as u32);
                    self.bytes.extend(unit.payload);
                    Ok(())
                })
                .map_err(|e| EncodeError::Sound(e.into()))?;
            self.samples += piece.len() as u64;
            out.write_all(&self.bytes)?;
            self.bytes.clear();
        }
        Ok(())
    }

    /// The sound has ended: writes the last units.
    ///
    /// # Errors
    ///
    /// That there were no samples, and what `out` says.
    pub fn finish(mut self, out: &mut dyn Write) -> Result<Sound, EncodeError> {
        let info = self
            .encoder
            .finish(|unit| {
                self.sizes.push(unit.payload.len() as u32);
                self.bytes.extend(unit.payload);
                Ok(())
            })
            .map_err(|e| EncodeError::Sound(e.into()))?;
        out.write_all(&self.bytes)?;
        Ok(Sound {
            rate_hz: self.rate_hz,
            config: self.encoder.asc().to_vec(),
            sizes: self.sizes,
            priming: info.priming as u32,
            samples: self.samples,
        })
    }
}

/// ADTS header of one mono 16 kHz AAC-LC unit (ISO/IEC 13818-7).
pub fn adts_header(payload: usize) -> [u8; 7] {
    let length = payload + 7;
    let rate_index = 8;
    [
        0xff,
        0xf1,
        (1 << 6) | (rate_index << 2),
        (1 << 6) | (length >> 11) as u8,
        (length >> 3) as u8,
        ((length & 7) << 5) as u8 | 0x1f,
        0xfc,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tone_comes_back_at_its_place() {
        // A burst of 440 Hz from sample 8000 to 12000: what is decoded must start and stop there.
        let tone: Vec<i16> = (0..20_000)
            .map(|i| {
                let inside = (8000..12_000).contains(&i);
                let phase = i as f32 * 440.0 * std::f32::consts::TAU / 16_000.0;
                if inside {
                    (phase.sin() * 12_000.0) as i16
                } else {
                    0
                }
            })
            .collect();
        let mut units = Vec::new();
        let mut encoder = SoundEncoder::new(16_000).unwrap();
        encoder.feed(&tone, &mut units).unwrap();
        let sound = encoder.finish(&mut units).unwrap();
        let covered = sound.sizes.len() as u64 * u64::from(FRAME_SAMPLES);
        assert!(covered >= u64::from(sound.priming) + sound.samples);

        let mut adts = Vec::new();
        let mut rest = &units[..];
        for &size in &sound.sizes {
            let (unit, after) = rest.split_at(size as usize);
            adts.extend(adts_header(unit.len()));
            adts.extend(unit);
            rest = after;
        }
        assert!(rest.is_empty());
        let back = syom::decode_with(&adts, &syom::DecodeOptions::unbounded()).unwrap();
        let (mut error, mut power) = (0.0f64, 0.0f64);
        for (i, &s) in tone.iter().enumerate() {
            let want = f64::from(s) / 32768.0;
            let have = f64::from(back.channels[0][i + sound.priming as usize]);
            error += (want - have).powi(2);
            power += want * want;
        }
        assert!(10.0 * (power / error).log10() > 25.0, "{power} {error}");
    }
}
