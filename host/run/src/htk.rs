//! HTK parameter files: a header of 12 bytes, then frames of big-endian `f32` (The HTK Book, section 5.10.1).
//!
//! | bytes | content |
//! |---|---|
//! | 0..4 | frames |
//! | 4..8 | frame period in 100 ns |
//! | 8..10 | bytes of a frame |
//! | 10..12 | kind: 6 (MFCC) + 0o100 (`_E`) + 0o400 (`_D`) + 0o1000 (`_A`) |
use std::path::Path;

use lipstream_core::{HOP_SAMPLES, N_OBSERVATION, SAMPLE_RATE_HZ};
use ndarray::Array2;

use lipstream_media::files;

use crate::error::{Context as _, Result, bail};

/// `MFCC_E_D_A`.
pub const KIND_MFCC_E_D_A: u16 = 6 + 0o100 + 0o400 + 0o1000;
/// 10 ms.
pub const PERIOD: u32 = (HOP_SAMPLES as u32) * (10_000_000 / SAMPLE_RATE_HZ);

const HEADER: usize = 12;

/// Writes observations, `[frames, 39]`, whole or not at all.
///
/// # Errors
///
/// As [`bytes`], and what the disk says.
pub fn write(path: &Path, observations: &Array2<f32>) -> Result<()> {
    Ok(files::write_bytes(path, &bytes(observations)?)?)
}

/// A file's bytes for observations `[frames, 39]`.
///
/// # Errors
///
/// Another number of columns, or more frames than a header can say.
pub fn bytes(observations: &Array2<f32>) -> Result<Vec<u8>> {
    let (frames, columns) = observations.dim();
    if columns != N_OBSERVATION {
        bail!(Data, "MFCC_E_D_A has {N_OBSERVATION} columns, not {columns}");
    }
    let mut bytes = Vec::with_capacity(HEADER + 4 * frames * columns);
    bytes.extend(u32::try_from(frames).context("too many frames")?.to_be_bytes());
    bytes.extend(PERIOD.to_be_bytes());
    bytes.extend((4 * N_OBSERVATION as u16).to_be_bytes());
    bytes.extend(KIND_MFCC_E_D_A.to_be_bytes());
    for value in observations {
        bytes.extend(value.to_be_bytes());
    }
    Ok(bytes)
}

/// Reads an uncompressed `MFCC_E_D_A` file at 10 ms.
///
/// # Errors
///
/// That the file cannot be read or holds something else.
pub fn read(path: &Path) -> Result<Array2<f32>> {
    let bytes = files::read_bytes(path)?;
    parse(&bytes).with_context(|| format!("cannot read {} as HTK parameters", path.display()))
}

fn parse(bytes: &[u8]) -> Result<Array2<f32>> {
    let Some((header, body)) = bytes.split_at_checked(HEADER) else {
        bail!(File, "{} bytes are too few for a header", bytes.len());
    };
    let word = |at: usize| u32::from_be_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
    let half = |at: usize| u16::from_be_bytes([header[at], header[at + 1]]);
    let frames = word(0) as usize;
    let (period, size, kind) = (word(4), half(8), half(10));
    if (period, usize::from(size), kind) != (PERIOD, 4 * N_OBSERVATION, KIND_MFCC_E_D_A) {
        bail!(
            File,
            "period {period}, frame size {size}, kind {kind:#o} are not those of MFCC_E_D_A at 10 ms"
        );
    }
    if Some(body.len()) != frames.checked_mul(4 * N_OBSERVATION) {
        bail!(
            File,
            "the header promises {frames} frames, {} bytes follow",
            body.len()
        );
    }
    let values = body
        .chunks_exact(4)
        .map(|v| f32::from_be_bytes([v[0], v[1], v[2], v[3]]))
        .collect();
    Ok(Array2::from_shape_vec((frames, N_OBSERVATION), values)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn written_files_have_the_header_and_are_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.htk");
        let array = Array2::from_shape_fn((3, N_OBSERVATION), |(t, i)| t as f32 - 0.25 * i as f32);
        write(&path, &array).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(bytes[..12], [0, 0, 0, 3, 0, 1, 0x86, 0xa0, 0, 156, 3, 0x46]);
        assert_eq!(read(&path).unwrap(), array);
        for cut in [0, 5, 12, bytes.len() - 1] {
            assert!(parse(&bytes[..cut]).is_err());
        }
    }
}
