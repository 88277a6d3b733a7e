//! Notes of what a prepared file was made from, so that an interrupted `prepare` continues where it was.
//!
//! `cache/ID.KIND` holds one line: size and time of the inputs and the settings that matter. It is written
//! after the file it vouches for, and both are whole or absent: a file without its note is made again.
use crate::hash::fnv1a;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use crate::error::{Context as _, Error, Result};
use lipstream_media::files;

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

/// Long lists of stamps in one short word.
pub(super) fn digest(text: &str) -> u64 {
    fnv1a(text.bytes())
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

    /// What was noted about `product`, if it is there and was made from what `stamp` says.
    pub(super) fn vouched(&self, kind: &str, stamp: &str, product: &Path) -> Option<String> {
        if !product.is_file() {
            return None;
        }
        let noted = std::fs::read_to_string(self.path(kind)).ok()?;
        let rest = noted.strip_prefix(&format!("{VERSION} {stamp}\n"))?;
        Some(rest.trim_end().to_owned())
    }

    /// What was noted of what has no file of its own.
    pub(super) fn noted(&self, kind: &str, stamp: &str) -> Option<String> {
        self.vouched(kind, stamp, &self.path(kind))
    }

    /// Takes the note back, before its product changes.
    pub(super) fn forget(&self, kind: &str) {
        // A note that is not there is what is wanted; one that cannot be removed is overwritten later.
        let _ = std::fs::remove_file(self.path(kind));
    }

    /// Notes that the product was made from what `stamp` says.
    pub(super) fn note(&self, kind: &str, stamp: &str) -> Result<()> {
        self.note_with(kind, stamp, "")
    }

    /// [`Notes::note`] with something about the product to remember.
    pub(super) fn note_with(&self, kind: &str, stamp: &str, about: &str) -> Result<()> {
        files::write_bytes(&self.path(kind), format!("{VERSION} {stamp}\n{about}").as_bytes())
            .map_err(Error::other)
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
        let vouch = |kind: &str, stamp: &str| notes.vouched(kind, stamp, &product).is_some();
        assert!(!vouch("audio", "x"));
        notes.note("audio", "x").unwrap();
        assert!(!vouch("audio", "x"), "the product is missing");
        std::fs::write(&product, b"1").unwrap();
        assert!(vouch("audio", "x"));
        assert!(!vouch("audio", "y") && !vouch("audio", "") && !vouch("visual", "x"));
        notes.note_with("visual", "z", "25").unwrap();
        assert_eq!(notes.vouched("visual", "z", &product).as_deref(), Some("25"));
        notes.forget("audio");
        assert!(!vouch("audio", "x"));
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
