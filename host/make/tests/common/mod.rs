//! What tests on the research data share: reading NumPy archives.
use std::io::Read;
use std::path::Path;

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
