//! Landmarks with their confidence into a NumPy archive: the layout that [`crate::hierarchical::Landmarks`] reads, and `confidence`, f32 `[clips, pictures]`.
use std::io::{Cursor, Write as _};

use lipstream::npy::npy_bytes;
use lipstream_media::files;
use ndarray::{Array1, Array2, Array4, s};
use std::path::Path;

use super::label::Labels;
use crate::error::{Error, Result};

/// Writes the whole file or none.
///
/// # Errors
///
/// What the disk says.
pub(super) fn write(path: &Path, labels: &Labels) -> Result<()> {
    let clips: Vec<(&str, _)> = labels.landmarks.clips().collect();
    let lengths: Array1<i64> = clips.iter().map(|(_, points)| points.dim().0 as i64).collect();
    let most = clips.iter().map(|(_, points)| points.dim().0).max().unwrap_or(0);
    let mut points = Array4::from_elem((clips.len(), most, labels.landmarks.count(), 2), f32::NAN);
    let mut confidence = Array2::<f32>::zeros((clips.len(), most));
    for (n, (clip, of_clip)) in clips.iter().enumerate() {
        points.slice_mut(s![n, ..of_clip.dim().0, .., ..]).assign(of_clip);
        for (to, from) in confidence.row_mut(n).iter_mut().zip(labels.confidence(clip)) {
            *to = *from;
        }
    }
    let names: Vec<&str> = clips.iter().map(|(clip, _)| *clip).collect();
    let mut members = vec![
        ("clips", word_bytes(&names)),
        ("pictures", npy_bytes(&lengths).map_err(Error::other)?),
        ("points", npy_bytes(&points).map_err(Error::other)?),
        ("confidence", npy_bytes(&confidence).map_err(Error::other)?),
    ];
    let groups = labels.landmarks.groups();
    if !groups.is_empty() {
        let names: Vec<&str> = groups.iter().map(|(name, _)| name.as_str()).collect();
        let sizes: Array1<i64> = groups.iter().map(|(_, range)| range.len() as i64).collect();
        members.push(("groups", word_bytes(&names)));
        members.push(("group_sizes", npy_bytes(&sizes).map_err(Error::other)?));
    }
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in members {
        zip.start_file(format!("{name}.npy"), zip::write::SimpleFileOptions::default())
            .map_err(Error::other)?;
        zip.write_all(&bytes)?;
    }
    let bytes = zip.finish().map_err(Error::other)?.into_inner();
    files::write_bytes(path, &bytes).map_err(Error::other)
}

/// A NumPy array of Unicode strings: each as long as the longest, zeros behind a shorter one, four bytes a letter.
pub(crate) fn word_bytes(words: &[&str]) -> Vec<u8> {
    let letters = words.iter().map(|word| word.chars().count()).max();
    let letters = letters.unwrap_or(0).max(1);
    let said = format!(
        "{{'descr': '<U{letters}', 'fortran_order': False, 'shape': ({},), }}",
        words.len()
    );
    // The data begins at a multiple of 64 bytes, as the format asks for.
    let padding = (64 - (10 + said.len() + 1) % 64) % 64;
    let header = format!("{said}{}\n", " ".repeat(padding));
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    out.extend((header.len() as u16).to_le_bytes());
    out.extend(header.bytes());
    for word in words {
        let codes = word.chars().map(u32::from).chain(std::iter::repeat(0));
        codes
            .take(letters)
            .for_each(|code| out.extend(code.to_le_bytes()));
    }
    out
}
