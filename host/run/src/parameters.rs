//! Parameter files: `.npy` of mouth parameters, `[frames, D]` at 100 Hz, f32 or f64.
use std::path::Path;

use anyhow::{Context as _, Result, anyhow, bail};
use ndarray::{Array2, ArrayView2};
use ndarray_npy::ReadNpyExt as _;

use lipstream_media::files;

/// Reads and checks parameters.
pub fn read(path: &Path) -> Result<Array2<f32>> {
    let bytes = files::read_bytes(path)?;
    let tracks = match Array2::<f32>::read_npy(&bytes[..]) {
        Ok(tracks) => tracks,
        Err(single) => Array2::<f64>::read_npy(&bytes[..])
            .map(|tracks| tracks.mapv(|v| v as f32))
            .map_err(|_| {
                anyhow!(
                    "{} holds no parameters: expected .npy of f32, [frames, D] at 100 Hz ({single})",
                    path.display()
                )
            })?,
    };
    check(tracks.view()).with_context(|| format!("{} holds no usable parameters", path.display()))?;
    Ok(tracks)
}

/// Refuses nothing at all and numbers that are none.
pub fn check(tracks: ArrayView2<f32>) -> Result<()> {
    if tracks.is_empty() {
        bail!("there is no frame in them");
    }
    for (t, row) in tracks.outer_iter().enumerate() {
        if let Some(k) = row.iter().position(|v| !v.is_finite()) {
            bail!("parameter {k} of frame {t} is {}", row[k]);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
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
            let line = format!("{:#}", read(path).unwrap_err());
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
