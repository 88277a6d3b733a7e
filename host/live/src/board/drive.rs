//! The drive as which a boot loader shows itself: finding it, and copying a UF2 file to it.
use std::fs::File;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use super::Drive;

/// What every such drive holds.
const INFO: &str = "INFO_UF2.TXT";
/// Folders in which systems show drives; a star is any name.
const PLACES: [&str; 5] = ["/media/*", "/media/*/*", "/run/media/*/*", "/mnt/*", "/Volumes/*"];

impl Drive {
    /// Whether the folder is the drive of a board of this kind; an error where it is a boot loader's drive, but of another kind, or none.
    ///
    /// # Errors
    ///
    /// Words that say what the folder is instead.
    pub fn is_at(&self, folder: &Path) -> Result<(), String> {
        let info = std::fs::read(folder.join(INFO)).map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => format!("it has no {INFO}: it is not the drive of a boot loader"),
            _ => format!("{INFO} cannot be read: {error}"),
        })?;
        let info = String::from_utf8_lossy(&info);
        let id = info
            .lines()
            .find_map(|line| line.strip_prefix("Board-ID:"))
            .unwrap_or_default()
            .trim();
        let lower = id.to_lowercase();
        match self.id.iter().all(|word| lower.contains(word)) && !lower.is_empty() {
            true => Ok(()),
            false => Err(format!("it is the drive of another board ({id:?})")),
        }
    }

    /// Drives of boards of this kind that are there now.
    pub fn find(&self) -> Vec<PathBuf> {
        self.among(&places())
    }

    fn among(&self, folders: &[PathBuf]) -> Vec<PathBuf> {
        let mut drives: Vec<PathBuf> = folders
            .iter()
            .filter(|folder| self.is_at(folder).is_ok())
            .cloned()
            .collect();
        drives.sort();
        drives.dedup();
        drives
    }
}

fn places() -> Vec<PathBuf> {
    if cfg!(windows) {
        return ('D'..='Z')
            .map(|letter| PathBuf::from(format!("{letter}:\\")))
            .collect();
    }
    PLACES.iter().flat_map(|place| expand(place)).collect()
}

/// The folders that a pattern of whole names stands for.
fn expand(pattern: &str) -> Vec<PathBuf> {
    let mut folders = vec![PathBuf::from("/")];
    for name in pattern.split('/').filter(|name| !name.is_empty()) {
        folders = folders
            .into_iter()
            .flat_map(|folder| match name {
                "*" => std::fs::read_dir(&folder)
                    .into_iter()
                    .flatten()
                    .flatten()
                    .map(|entry| entry.path())
                    .collect(),
                name => vec![folder.join(name)],
            })
            .collect();
    }
    folders
}

/// Copies a file to a boot loader's drive. The board starts anew with the last block, and its drive goes away, which is no error.
///
/// # Errors
///
/// That not everything could be written.
pub fn copy(bytes: &[u8], folder: &Path, name: &str) -> io::Result<()> {
    let mut file = File::create(folder.join(name))?;
    file.write_all(bytes)?;
    match file.sync_all() {
        Err(error) if folder.join(INFO).exists() => Err(error),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::Board;

    #[test]
    fn a_drive_is_known_by_what_it_says() {
        let top = tempfile::tempdir().unwrap();
        let folder = |name: &str, info: Option<&str>| {
            let folder = top.path().join(name);
            std::fs::create_dir(&folder).unwrap();
            if let Some(info) = info {
                std::fs::write(folder.join(INFO), info).unwrap();
            }
            folder
        };
        let pico = folder(
            "a",
            Some("UF2 Bootloader v3.0\r\nModel: Raspberry Pi RP2\r\nBoard-ID: RPI-RP2\r\n"),
        );
        let pico2 = folder(
            "b",
            Some("UF2 Bootloader v1.0\nModel: Raspberry Pi RP2350\nBoard-ID: RP2350\n"),
        );
        let xiao = folder(
            "c",
            Some(
                "UF2 Bootloader 0.6.1\r\nModel: Seeed XIAO nRF52840\r\nBoard-ID: nRF52840-SeeedXiaoSense-v1\r\n",
            ),
        );
        let stick = folder("d", None);
        let empty = folder("e", Some(""));
        let all = [&pico, &pico2, &xiao, &stick, &empty].map(Clone::clone);
        for (name, want) in [("pico", &pico), ("pico2", &pico2), ("xiao-sense", &xiao)] {
            let drive = Board::named(name).unwrap().drive.as_ref().unwrap();
            assert_eq!(drive.among(&all), std::slice::from_ref(want), "{name}");
        }
        let drive = Board::named("pico").unwrap().drive.as_ref().unwrap();
        assert!(drive.is_at(&pico2).unwrap_err().contains("RP2350"));
        assert!(drive.is_at(&stick).unwrap_err().contains(INFO));
        copy(b"blocks", &pico, "lipstream.uf2").unwrap();
        assert_eq!(std::fs::read(pico.join("lipstream.uf2")).unwrap(), b"blocks");
    }
}
