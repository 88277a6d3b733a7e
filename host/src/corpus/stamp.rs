//! Notes of what a prepared file was made from, so that an interrupted `prepare` continues where it was.
//!
//! `cache/ID.KIND` holds one line: size and time of the inputs and the settings that matter. It is written
//! after the file it vouches for, and both are whole or absent: a file without its note is made again.
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use anyhow::{Context, Result};

use crate::files;

/// Changes when files of the same inputs and settings come out differently.
const VERSION: u32 = 1;

/// Size and modification time of a file.
pub(super) fn of_file(path: &Path) -> Result<String> {
    let meta = std::fs::metadata(path).with_context(|| format!("cannot read {}", path.display()))?;
    let modified = meta
        .modified()
        .ok()
        .and_then(|t| t.duration_since(UNIX_EPOCH).ok())
        .map_or(0, |d| d.as_nanos());
    Ok(format!("{} {} {modified}", path.display(), meta.len()))
}

/// The notes of one clip.
pub(super) struct Notes {
    folder: PathBuf,
    id: String,
}

impl Notes {
    pub(super) fn new(out: &Path, id: &str) -> Self {
        Self {
            folder: out.join("cache"),
            id: id.to_owned(),
        }
    }

    fn path(&self, kind: &str) -> PathBuf {
        self.folder.join(format!("{}.{kind}", self.id))
    }

    fn line(stamp: &str) -> String {
        format!("{VERSION} {stamp}\n")
    }

    /// True if `product` is there and was made from what `stamp` says.
    pub(super) fn vouch(&self, kind: &str, stamp: &str, product: &Path) -> bool {
        product.is_file()
            && std::fs::read_to_string(self.path(kind)).is_ok_and(|noted| noted == Self::line(stamp))
    }

    /// Takes the note back, before its product changes.
    pub(super) fn forget(&self, kind: &str) {
        // A note that is not there is what is wanted; one that cannot be removed is overwritten later.
        let _ = std::fs::remove_file(self.path(kind));
    }

    /// Notes that the product was made from what `stamp` says.
    pub(super) fn note(&self, kind: &str, stamp: &str) -> Result<()> {
        files::write_bytes(&self.path(kind), Self::line(stamp).as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_note_vouches_for_these_inputs_only() {
        let folder = tempfile::tempdir().unwrap();
        let product = folder.path().join("a.npy");
        let notes = Notes::new(folder.path(), "a");
        assert!(!notes.vouch("audio", "x", &product));
        notes.note("audio", "x").unwrap();
        assert!(!notes.vouch("audio", "x", &product), "the product is missing");
        std::fs::write(&product, b"1").unwrap();
        assert!(notes.vouch("audio", "x", &product));
        assert!(!notes.vouch("audio", "y", &product));
        assert!(!notes.vouch("visual", "x", &product));
        notes.forget("audio");
        assert!(!notes.vouch("audio", "x", &product));
    }

    #[test]
    fn a_changed_file_has_another_stamp() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::write(&path, b"1").unwrap();
        let before = of_file(&path).unwrap();
        std::fs::write(&path, b"12").unwrap();
        assert_ne!(before, of_file(&path).unwrap());
        assert!(of_file(&folder.path().join("b")).is_err());
    }
}
