//! How a WAV file's `fmt ` chunk says that samples are written, and samples out of bytes.
//!
//! Tags are those of Microsoft's `mmreg.h`. An extensible format (tag 0xFFFE) names its coding in the first two bytes of a GUID, and says beside
//! the bytes that a sample takes how many of its bits are valid: these are the upper ones, so that a sample is worth the same read whole.
use super::super::{Result, SoundError, damaged};

/// How samples lie in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Coding {
    /// Unsigned bytes, of which 128 is silence.
    Bytes,
    /// Little-endian two's complement of so many bytes.
    Integers(usize),
    /// IEEE floats of 4 bytes, full scale ±1.
    Floats,
    /// The same of 8 bytes.
    Doubles,
    /// Telephony, ITU-T G.711: 8 bits that stand for 13.
    ALaw,
    /// Telephony, ITU-T G.711: 8 bits that stand for 14.
    MuLaw,
}

/// What the `fmt ` chunk says.
#[derive(Clone, Copy, Debug)]
pub(super) struct Format {
    coding: Coding,
    pub(super) channels: usize,
    pub(super) rate_hz: u32,
    /// Bytes of one sample of one channel.
    width: usize,
}

const PCM: u16 = 1;
const FLOAT: u16 = 3;
const A_LAW: u16 = 6;
const MU_LAW: u16 = 7;
const EXTENSIBLE: u16 = 0xfffe;
/// What follows the tag in the GUID of a coding that has one.
const GUID_TAIL: [u8; 14] = [0, 0, 0, 0, 0x10, 0, 0x80, 0, 0, 0xaa, 0, 0x38, 0x9b, 0x71];

impl Format {
    pub(super) fn parse(body: &[u8]) -> Result<Self> {
        let Some(fixed) = body.first_chunk::<16>() else {
            return damaged(format!(
                "damaged WAV header: chunk 'fmt ' has {} bytes, not 16 or more",
                body.len()
            ));
        };
        let word = |at: usize| u16::from_le_bytes([fixed[at], fixed[at + 1]]);
        let (channels, block, bits) = (usize::from(word(2)), usize::from(word(12)), word(14));
        let tag = match (word(0), body.get(24..40)) {
            (EXTENSIBLE, Some(guid)) if guid[2..] == GUID_TAIL => u16::from_le_bytes([guid[0], guid[1]]),
            (EXTENSIBLE, Some(_)) => return unsupported("a coding that is known by a GUID of its own"),
            (EXTENSIBLE, None) => {
                return damaged("damaged WAV header: an extensible 'fmt ' chunk without its 40 bytes");
            }
            (tag, _) => tag,
        };
        let contradiction = |what: &str| damaged(format!("damaged WAV header: {what}"));
        if !matches!(tag, PCM | FLOAT | A_LAW | MU_LAW) {
            return unsupported(&name(tag));
        }
        if channels == 0 {
            return contradiction("it has zero channels");
        }
        let width = block / channels;
        if width == 0 || block % channels != 0 || usize::from(bits) > 8 * width || bits == 0 {
            return contradiction(&format!(
                "{block} bytes do not hold {channels} channels of {bits} bits per sample"
            ));
        }
        let coding = match (tag, width) {
            (PCM, 1) => Coding::Bytes,
            (PCM, 2..=8) if word(0) == EXTENSIBLE || usize::from(bits.div_ceil(8)) == width => {
                Coding::Integers(width)
            }
            (PCM, 2..=8) => {
                return unsupported(&format!(
                    "samples of {bits} bits in {width} bytes, without a word on which of them are meant"
                ));
            }
            (FLOAT, 4) if bits == 32 => Coding::Floats,
            (FLOAT, 8) if bits == 64 => Coding::Doubles,
            (A_LAW, 1) if bits == 8 => Coding::ALaw,
            (MU_LAW, 1) if bits == 8 => Coding::MuLaw,
            _ => {
                return unsupported(&format!(
                    "{} of {bits} bits per sample in {width} bytes",
                    name(tag)
                ));
            }
        };
        Ok(Self {
            coding,
            channels,
            rate_hz: u32::from_le_bytes([fixed[4], fixed[5], fixed[6], fixed[7]]),
            width,
        })
    }

    /// Bytes of one sample of every channel.
    pub(super) fn block(&self) -> usize {
        self.channels * self.width
    }

    /// Appends the samples in `bytes`, full scale ±1, of which the first is the file's sample `at`, all channels counted.
    pub(super) fn decode(&self, bytes: &[u8], at: u64, out: &mut Vec<f64>) -> Result<()> {
        let whole = bytes.chunks_exact(self.width);
        match self.coding {
            Coding::Bytes => out.extend(bytes.iter().map(|&b| (f64::from(b) - 128.0) / 128.0)),
            Coding::Integers(width) => out.extend(whole.map(|sample| {
                // In the upper bytes of 8, so that the sign is where it belongs and full scale is 2⁶³ for every width.
                let mut wide = [0; 8];
                wide[8 - width..].copy_from_slice(sample);
                i64::from_le_bytes(wide) as f64 / 2f64.powi(63)
            })),
            Coding::Floats => {
                out.extend(whole.map(|s| f64::from(f32::from_le_bytes([s[0], s[1], s[2], s[3]]))))
            }
            Coding::Doubles => out
                .extend(whole.map(|s| f64::from_le_bytes([s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7]]))),
            Coding::ALaw => out.extend(bytes.iter().map(|&b| a_law(b))),
            Coding::MuLaw => out.extend(bytes.iter().map(|&b| mu_law(b))),
        }
        let decoded = bytes.len() / self.width;
        let new = &out[out.len() - decoded..];
        match new.iter().position(|s| !s.is_finite()) {
            Some(n) => damaged(format!("sample {} is not a finite number", at + n as u64)),
            None => Ok(()),
        }
    }
}

/// A byte of A-law, ITU-T G.711 table 1a: sign, 3 bits of segment, 4 bits of place in it; even bits are inverted on the line.
fn a_law(byte: u8) -> f64 {
    let bits = byte ^ 0x55;
    let (segment, place) = ((bits >> 4) & 7, f64::from(bits & 15));
    let size = match segment {
        0 => 2.0 * place + 1.0,
        _ => (2.0 * place + 33.0) * f64::from(1u32 << (segment - 1)),
    };
    // The largest is 4032 of 4096.
    (if bits & 0x80 == 0 { -size } else { size }) / 4096.0
}

/// A byte of µ-law, ITU-T G.711 table 2a: the same parts, all inverted on the line.
fn mu_law(byte: u8) -> f64 {
    let bits = !byte;
    let (segment, place) = ((bits >> 4) & 7, f64::from(bits & 15));
    let size = (2.0 * place + 33.0) * f64::from(1u32 << segment) - 33.0;
    // The largest is 8031 of 8192.
    (if bits & 0x80 == 0 { size } else { -size }) / 8192.0
}

fn name(tag: u16) -> String {
    match tag {
        PCM => "integers".to_owned(),
        2 => "Microsoft ADPCM".to_owned(),
        FLOAT => "floats".to_owned(),
        A_LAW => "A-law".to_owned(),
        MU_LAW => "µ-law".to_owned(),
        0x11 => "IMA ADPCM".to_owned(),
        0x31 => "GSM 6.10".to_owned(),
        0x50 | 0x55 => "MPEG audio".to_owned(),
        0xff => "AAC".to_owned(),
        tag => format!("coding 0x{tag:04X}"),
    }
}

fn unsupported<T>(what: &str) -> Result<T> {
    Err(SoundError::Unsupported(format!(
        "a WAV file of {what}, which is not read here (convert it with `ffmpeg -i FILE -c:a pcm_s16le out.wav`)"
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of ITU-T G.711: both ends, the two smallest, and that sign and size are where they belong.
    #[test]
    fn telephony_is_what_g711_says() {
        for (byte, size) in [
            (0xd5, 1.0),
            (0x55, -1.0),
            (0xaa, 4032.0),
            (0x2a, -4032.0),
            (0xd4, 3.0),
        ] {
            assert_eq!(a_law(byte) * 4096.0, size, "{byte:x}");
        }
        for (byte, size) in [
            (0xff, 0.0),
            (0x80, 8031.0),
            (0x00, -8031.0),
            (0xfe, 2.0),
            (0x7e, -2.0),
        ] {
            assert_eq!(mu_law(byte) * 8192.0, size, "{byte:x}");
        }
    }
}
