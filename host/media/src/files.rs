//! Files that are either whole or absent: written aside, then renamed.
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::Cause;

/// Why a file was not read or not written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FileError {
    /// A folder that is missing cannot be made.
    #[error("cannot make folder {}", folder.display())]
    Folder {
        /// Which folder.
        folder: PathBuf,
        /// What happened.
        source: io::Error,
    },
    /// Nothing can be written beside what is to be written.
    #[error("cannot write in {}", folder.display())]
    Aside {
        /// Which folder.
        folder: PathBuf,
        /// What happened.
        source: io::Error,
    },
    /// A file cannot be written: what the disk says, or whoever writes what is in it.
    #[error("cannot write {}", path.display())]
    Write {
        /// Which file.
        path: PathBuf,
        /// What happened.
        source: Cause,
    },
    /// A file cannot be read.
    #[error("cannot read {}", path.display())]
    Read {
        /// Which file.
        path: PathBuf,
        /// What happened.
        source: io::Error,
    },
}

impl FileError {
    pub(crate) fn write(path: &Path, source: impl Into<Cause>) -> Self {
        Self::Write {
            path: path.to_owned(),
            source: source.into(),
        }
    }
}

/// The folder in which `path` lies, which is made if it is missing.
pub(crate) fn folder_of(path: &Path) -> Result<&Path, FileError> {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    std::fs::create_dir_all(folder).map_err(|source| FileError::Folder {
        folder: folder.to_owned(),
        source,
    })?;
    Ok(folder)
}

/// Says in which folder nothing can be written.
pub(crate) fn aside_error(folder: &Path) -> impl FnOnce(io::Error) -> FileError {
    |source| FileError::Aside {
        folder: folder.to_owned(),
        source,
    }
}

/// Calls `write` on a buffered temporary file beside `path`, then renames it to `path`.
///
/// A failure or an interrupt leaves whatever was at `path` untouched. Missing parent folders are made.
///
/// # Errors
///
/// What the disk says, and what `write` says as the cause of [`FileError::Write`].
pub fn write_whole<E: Into<Cause>>(
    path: &Path,
    write: impl FnOnce(&mut dyn Write) -> Result<(), E>,
) -> Result<(), FileError> {
    let folder = folder_of(path)?;
    let aside = tempfile::Builder::new()
        .prefix(".lipstream-")
        .suffix(".tmp")
        .tempfile_in(folder)
        .map_err(aside_error(folder))?;
    let mut buffered = BufWriter::new(aside);
    write(&mut buffered).map_err(|e| FileError::write(path, e))?;
    let aside = buffered
        .into_inner()
        .map_err(|e| FileError::write(path, e.into_error()))?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        aside
            .as_file()
            .set_permissions(std::fs::Permissions::from_mode(0o644))
            .map_err(|e| FileError::write(path, e))?;
    }
    aside.persist(path).map_err(|e| FileError::write(path, e))?;
    Ok(())
}

/// [`write_whole`] for bytes already in memory.
///
/// # Errors
///
/// As [`write_whole`].
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    write_whole(path, |file| file.write_all(bytes))
}

/// Reads a whole file; the error names it.
///
/// # Errors
///
/// [`FileError::Read`].
pub fn read_bytes(path: &Path) -> Result<Vec<u8>, FileError> {
    std::fs::read(path).map_err(|source| FileError::Read {
        path: path.to_owned(),
        source,
    })
}
