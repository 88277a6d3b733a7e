//! Parameter files: `.npy` of mouth parameters, `[frames, D]` at 100 Hz, f32 or f64.
use std::path::Path;

use ndarray::{Array2, ArrayView2, Ix2};

use crate::error::{Context as _, Error, Result};
use crate::npy;

/// What keeps mouth parameters from being drawn.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ParameterError {
    /// A sound shorter than one window has no frame.
    #[error("there is no frame in them: a sound must be as long as one window, 25 ms")]
    NoFrame,
    /// A parameter is no number.
    #[error("parameter {parameter} of frame {frame} is {value}")]
    Value {
        /// Which one of the frame, counted from 0.
        parameter: usize,
        /// Counted from 0.
        frame: usize,
        /// What it is instead.
        value: f32,
    },
    /// Frames have another number of parameters than the mouth that they are to move.
    #[error(
        "the parameters are {width} a frame, the model's mouth has {wanted}: they come from another model"
    )]
    Width {
        /// Parameters of a frame.
        width: usize,
        /// Numbers that the mouth is drawn from.
        wanted: usize,
    },
}

/// Reads and checks parameters.
///
/// # Errors
///
/// That the file cannot be read or holds something else; [`ParameterError`] as the cause of what cannot be drawn.
pub fn read(path: &Path) -> Result<Array2<f32>> {
    let tracks = match npy::read_array::<f32, Ix2>(path) {
        Ok(tracks) => tracks,
        Err(single @ Error::Disk(_)) => return Err(single),
        Err(single) => npy::read_array::<f64, Ix2>(path)
            .map(|tracks| tracks.mapv(|v| v as f32))
            .map_err(|_| {
                Error::File(format!(
                    "{} holds no parameters: expected .npy of f32, [frames, D] at 100 Hz ({single})",
                    path.display()
                ))
            })?,
    };
    check(tracks.view()).with_context(|| format!("{} holds no usable parameters", path.display()))?;
    Ok(tracks)
}

/// Refuses nothing at all and numbers that are none.
///
/// # Errors
///
/// [`ParameterError::NoFrame`] and [`ParameterError::Value`].
pub fn check(tracks: ArrayView2<f32>) -> Result<(), ParameterError> {
    if tracks.is_empty() {
        return Err(ParameterError::NoFrame);
    }
    for (t, row) in tracks.outer_iter().enumerate() {
        check_frame(t, row)?;
    }
    Ok(())
}

/// Refuses numbers that are none.
pub(crate) fn check_frame<'p>(
    frame: usize,
    parameters: impl IntoIterator<Item = &'p f32>,
) -> Result<(), ParameterError> {
    match parameters.into_iter().enumerate().find(|(_, v)| !v.is_finite()) {
        None => Ok(()),
        Some((parameter, &value)) => Err(ParameterError::Value {
            parameter,
            frame,
            value,
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::chain;
    use ndarray::array;
    use ndarray_npy::WriteNpyExt as _;

    #[test]
    fn both_widths_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.npy");
        let want = array![[1.0f32, -2.5], [3.0, 4.0]];
        want.write_npy(std::fs::File::create(&path).unwrap()).unwrap();
        assert_eq!(read(&path).unwrap(), want);
        want.mapv(f64::from)
            .write_npy(std::fs::File::create(&path).unwrap())
            .unwrap();
        assert_eq!(read(&path).unwrap(), want);
    }

    #[test]
    fn bad_files_are_refused_in_one_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.npy");
        let refused = |path: &Path| {
            let line = chain(&read(path).unwrap_err());
            assert!(line.contains("p.npy") && !line.contains('\n'), "{line}");
            line
        };
        assert!(refused(&path).contains("cannot read"));
        std::fs::write(&path, b"RIFF....").unwrap();
        refused(&path);
        let write = |tracks: Array2<f32>| {
            tracks.write_npy(std::fs::File::create(&path).unwrap()).unwrap();
        };
        write(Array2::zeros((0, 4)));
        assert!(refused(&path).contains("no frame"));
        write(array![[0.0, 1.0], [2.0, f32::NAN]]);
        assert!(refused(&path).contains("parameter 1 of frame 1 is NaN"));
        ndarray::array![1.0f32, 2.0]
            .write_npy(std::fs::File::create(&path).unwrap())
            .unwrap();
        refused(&path);
    }
}
