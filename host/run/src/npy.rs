//! Arrays of numbers as `.npy` files.
//!
//! What a header promises (NumPy's format specification, `numpy/lib/format.py`) is held against the bytes that are there before room is made for it.
use std::fs::File;
use std::io::Read;
use std::path::Path;

use lipstream_media::files::{self, FileError};
use ndarray::{Array, Array2, Dimension};
use ndarray_npy::{ReadNpyExt as _, ReadableElement, WritableElement, WriteNpyExt as _};

use crate::error::{Error, Result, bail};

/// Bytes of the longest header that is read; those of plain arrays have 128.
const MOST_HEADER: usize = 1 << 16;

/// What is wrong with the bytes of a `.npy` file, in one line.
type Wrong = String;

/// Reads an array whose numbers are of one kind.
///
/// # Errors
///
/// That the file cannot be read, is none, promises other than it has, or holds another kind of numbers or of shape.
pub fn read_array<T: ReadableElement, D: Dimension>(path: &Path) -> Result<Array<T, D>> {
    let unread = |source| FileError::Read {
        path: path.to_owned(),
        source,
    };
    let mut file = File::open(path).map_err(unread)?;
    let mut bytes = Vec::new();
    (&mut file)
        .take(MOST_HEADER as u64)
        .read_to_end(&mut bytes)
        .map_err(unread)?;
    let said = promised(&bytes).and_then(|length| {
        // One byte more than was promised shows that there is more.
        let more = (length as u64 + 1).saturating_sub(bytes.len() as u64);
        let read = file.take(more).read_to_end(&mut bytes);
        read.map_err(|e| e.to_string())?;
        parse(&bytes)
    });
    said.map_err(|wrong| Error::File(format!("cannot read {}: {wrong}", path.display())))
}

/// An array in memory.
///
/// # Errors
///
/// What is wrong with it.
pub fn parse<T: ReadableElement, D: Dimension>(bytes: &[u8]) -> Result<Array<T, D>, Wrong> {
    let length = promised(bytes)?;
    if length != bytes.len() {
        return Err(match bytes.len() > length {
            true => format!("its header says that it ends at byte {length}, but more bytes follow"),
            false => format!(
                "its header promises {length} bytes, the file has {}: it is cut short, or the header lies",
                bytes.len()
            ),
        });
    }
    Array::read_npy(bytes).map_err(|error| {
        // Parsers point at the place over several lines, and repeat what they were given.
        let said = error.to_string();
        let first = said.lines().next().unwrap_or_default();
        first.chars().take(160).collect()
    })
}

/// Bytes of the whole file, after its header, of which `start` has at least all or [`MOST_HEADER`].
fn promised(start: &[u8]) -> Result<usize, Wrong> {
    let none = || "it is no .npy file".to_owned();
    if !start.starts_with(b"\x93NUMPY") {
        return Err(none());
    }
    let (length, at) = match start.get(6..12) {
        Some(&[1, _, low, high, ..]) => (u32::from(u16::from_le_bytes([low, high])), 10),
        Some(&[2 | 3, _, a, b, c, d]) => (u32::from_le_bytes([a, b, c, d]), 12),
        _ => return Err(none()),
    };
    let end = at + length as usize;
    if end > MOST_HEADER {
        return Err(format!(
            "its header has {length} bytes: no plain array's has as many"
        ));
    }
    let header = start.get(at..end).ok_or("its header is cut short")?;
    let header = std::str::from_utf8(header).map_err(|_| none())?;
    let unknown = || "its header does not say the shape and the kind of its numbers as NumPy does".to_owned();
    let after = |key: &str| {
        Some(
            header
                .split_once(key)?
                .1
                .trim_start()
                .strip_prefix(':')?
                .trim_start(),
        )
    };
    let kind = after("'descr'")
        .and_then(|rest| rest.strip_prefix('\'')?.split_once('\''))
        .ok_or_else(unknown)?
        .0;
    let width = kind.trim_start_matches(|c: char| !c.is_ascii_digit());
    let shape = after("'shape'")
        .and_then(|rest| rest.strip_prefix('(')?.split_once(')'))
        .ok_or_else(unknown)?
        .0;
    let mut sides = vec![width.parse::<usize>().map_err(|_| unknown())?];
    for side in shape.split(',').map(str::trim).filter(|side| !side.is_empty()) {
        sides.push(
            side.parse()
                .map_err(|_| format!("its header says a shape of ({shape})"))?,
        );
    }
    // Whoever walks a shape multiplies its sides, also where one of them is 0.
    let beside_zeros = sides.iter().filter(|side| **side > 0);
    let most = beside_zeros.copied().try_fold(1usize, usize::checked_mul);
    let most = most.filter(|bytes| isize::try_from(*bytes).is_ok());
    let size = if sides.contains(&0) { most.map(|_| 0) } else { most };
    size.and_then(|size| end.checked_add(size))
        .ok_or_else(|| format!("its header promises a shape of ({shape}), more than any computer has"))
}

/// Reads a two-dimensional f32 array and refuses NaN and infinities.
///
/// # Errors
///
/// That the file cannot be read, holds something else, or a number that is none.
pub fn read_npy(path: &Path) -> Result<Array2<f32>> {
    let array: Array2<f32> = read_array(path)?;
    if let Some(((row, column), _)) = array.indexed_iter().find(|(_, v)| !v.is_finite()) {
        bail!(
            File,
            "{}: the number in row {row}, column {column} is not finite",
            path.display()
        );
    }
    // A file in column order becomes row order: everything else walks frames as slices.
    Ok(array.as_standard_layout().into_owned())
}

/// Writes a two-dimensional f32 array, whole or not at all.
///
/// # Errors
///
/// What the disk says.
pub fn write_npy(path: &Path, array: &Array2<f32>) -> Result<()> {
    use ndarray_npy::WriteNpyExt;
    Ok(files::write_whole(path, |file| array.write_npy(file))?)
}

/// An array as the bytes of a `.npy` file.
///
/// # Errors
///
/// None for arrays of any shape that fits in memory; the writer's interface has them.
pub fn npy_bytes<T: WritableElement, D: Dimension>(array: &Array<T, D>) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    array.write_npy(&mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file with this header and so many bytes behind it.
    fn file(header: &str, bytes: usize) -> Vec<u8> {
        let mut out = b"\x93NUMPY\x01\x00".to_vec();
        out.extend((header.len() as u16).to_le_bytes());
        out.extend(header.as_bytes());
        out.resize(out.len() + bytes, 0);
        out
    }

    fn shaped(shape: &str, bytes: usize) -> Vec<u8> {
        file(
            &format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({shape}), }}\n"),
            bytes,
        )
    }

    #[test]
    fn a_header_is_held_against_the_bytes_that_are_there() {
        let whole: Array2<f32> = parse(&shaped("2, 3", 24)).unwrap();
        assert_eq!(whole.dim(), (2, 3));
        let none: Array2<f32> = parse(&shaped("0, 3", 0)).unwrap();
        assert_eq!(none.dim(), (0, 3));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let long = format!("{{'descr': {}'<f4'}}", "(".repeat(50_000));
        for (bytes, words) in [
            (shaped("2, 3", 20), "cut short"),
            (shaped("2, 3", 25), "more bytes follow"),
            (shaped("1000000000000, 30", 24), "cut short"),
            (shaped("18446744073709551615, 0", 0), "more than any computer has"),
            (shaped("18446744073709551615, 2", 0), "more than any computer has"),
            (shaped("4611686018427387904, 0", 0), "more than any computer has"),
            (shaped("99999999999999999999999", 0), "a shape of"),
            (shaped("-1, 3", 0), "a shape of"),
            (shaped("6,", 24), "ndim"),
            (file(&long, 0), "does not say the shape"),
            (b"\x93NUMPY\x02\x00\xff\xff\xff\xff".to_vec(), "no plain array"),
            (b"\x93NUMPY\x01\x00\xff\x00{}".to_vec(), "header is cut short"),
            (b"words".to_vec(), "no .npy file"),
        ] {
            let wrong = parse::<f32, ndarray::Ix2>(&bytes).unwrap_err();
            std::fs::write(&path, &bytes).unwrap();
            let read = read_npy(&path).unwrap_err().to_string();
            assert!(wrong.contains(words) && read.contains(words), "{wrong}; {read}");
            assert!(!read.contains('\n') && read.len() < 400, "{read}");
        }
        // What has no end is no array, and said so at once.
        read_npy(Path::new("/dev/zero")).unwrap_err();
    }
}
