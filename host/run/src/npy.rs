//! Arrays of numbers as `.npy` files.
use std::path::Path;

use lipstream_media::files;
use ndarray::Array2;

use crate::error::{Context as _, Result, bail};

/// Reads a two-dimensional f32 array and refuses NaN and infinities.
///
/// # Errors
///
/// That the file cannot be read, holds something else, or a number that is none.
pub fn read_npy(path: &Path) -> Result<Array2<f32>> {
    let array: Array2<f32> =
        ndarray_npy::read_npy(path).with_context(|| format!("cannot read {}", path.display()))?;
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
pub fn npy_bytes(array: &Array2<f32>) -> Result<Vec<u8>> {
    use ndarray_npy::WriteNpyExt;
    let mut bytes = Vec::new();
    array.write_npy(&mut bytes)?;
    Ok(bytes)
}
