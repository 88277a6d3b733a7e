//! Files that are either whole or absent: written aside, then renamed.
use std::io::{BufWriter, Write};
use std::path::Path;

use anyhow::{Context, Result};

/// Calls `write` on a buffered temporary file beside `path`, then renames it to `path`.
///
/// A failure or an interrupt leaves whatever was at `path` untouched. Missing parent folders are made.
pub fn write_whole(path: &Path, write: impl FnOnce(&mut dyn Write) -> Result<()>) -> Result<()> {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make folder {}", folder.display()))?;
    let aside = tempfile::Builder::new()
        .prefix(".lipstream-")
        .suffix(".tmp")
        .tempfile_in(folder)
        .with_context(|| format!("cannot write in {}", folder.display()))?;
    let mut buffered = BufWriter::new(aside);
    write(&mut buffered).with_context(|| format!("cannot write {}", path.display()))?;
    let aside = buffered.into_inner().map_err(|e| e.into_error())?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        aside
            .as_file()
            .set_permissions(std::fs::Permissions::from_mode(0o644))?;
    }
    aside
        .persist(path)
        .with_context(|| format!("cannot write {}", path.display()))?;
    Ok(())
}

/// [`write_whole`] for bytes already in memory.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    write_whole(path, |file| Ok(file.write_all(bytes)?))
}

/// Reads a whole file; the error names it.
pub fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))
}
