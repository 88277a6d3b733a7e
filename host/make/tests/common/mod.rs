//! What tests on the research data share: where they lie, videos, NumPy archives.
#![allow(dead_code)] // each test program uses its part
use std::io::Read;
use std::path::{Path, PathBuf};

/// The research data.
pub(crate) fn data() -> PathBuf {
    let shared =
        std::env::var_os("LIPSTREAM_RESEARCH").expect("LIPSTREAM_RESEARCH names the folder that holds data/");
    Path::new(&shared).join("data")
}

/// The videos of a folder, by name.
pub(crate) fn videos(folder: &Path) -> Vec<PathBuf> {
    let mut all: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| {
            path.extension()
                .is_some_and(|ending| ending == "mpg" || ending == "mp4")
        })
        .collect();
    all.sort();
    all
}

/// One array of an `.npz`.
pub(crate) fn member(npz: &Path, name: &str) -> Vec<u8> {
    let file = std::fs::File::open(npz).unwrap_or_else(|e| panic!("{}: {e}", npz.display()));
    let mut archive = zip::ZipArchive::new(file).unwrap();
    let mut bytes = Vec::new();
    archive.by_name(name).unwrap().read_to_end(&mut bytes).unwrap();
    bytes
}

/// Strings of a `<U6` array.
pub(crate) fn names(npy: &[u8]) -> Vec<String> {
    let header = usize::from(u16::from_le_bytes([npy[8], npy[9]])) + 10;
    assert!(npy[..header].windows(3).any(|w| w == b"<U6"));
    let letters = |word: &[u8]| {
        let codes = word.chunks(4).map(|c| u32::from_le_bytes(c.try_into().unwrap()));
        codes
            .filter(|c| *c != 0)
            .map(|c| char::from_u32(c).unwrap())
            .collect()
    };
    npy[header..].chunks(24).map(letters).collect()
}
