//! What is there of a film whose making was interrupted: `film.mp4.part` beside `film.mp4`, until that is whole.
//!
//! A part knows which film it is of by a key that the caller makes of everything the pictures depend on. It holds encoded pictures one after
//! another, each after its length; of those only whole groups from one key picture to the next are gone on from, since a group is encoded in one go.
use std::fs::{File, OpenOptions};
use std::io::{self, BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::Film;

/// How much of a film was there before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Begun {
    /// Nothing.
    Nothing,
    /// A part of another film, or of the same one otherwise made: it gives way.
    Another,
    /// So many pictures of this film, behind which the next one is expected.
    Pictures(usize),
}

impl Begun {
    /// Pictures that need not be made again.
    pub fn pictures(self) -> usize {
        match self {
            Self::Nothing | Self::Another => 0,
            Self::Pictures(count) => count,
        }
    }
}

/// A file or folder for what is not whole yet. It goes away when it is dropped, but not when the program is killed.
pub(super) struct Part {
    path: PathBuf,
    kept: bool,
}

impl Part {
    /// The name of the part of `path`.
    pub(super) fn beside(path: &Path) -> PathBuf {
        let mut name = path.file_name().unwrap_or_default().to_owned();
        name.push(".part");
        path.with_file_name(name)
    }

    pub(super) fn new(path: PathBuf) -> Self {
        Self { path, kept: false }
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// All pictures are in it: whatever happens now, they need not be made again.
    pub(super) fn keep(&mut self) {
        self.kept = true;
    }

    /// The film is whole.
    pub(super) fn remove(mut self) {
        self.kept = false;
    }
}

impl Drop for Part {
    fn drop(&mut self) {
        if !self.kept {
            // Whatever is left behind tells its own name.
            let _ = match self.path.is_dir() {
                true => std::fs::remove_dir_all(&self.path),
                false => std::fs::remove_file(&self.path),
            };
        }
    }
}

/// The first bytes of every part of this program's.
const MAGIC: &[u8; 16] = b"lipstream part 1";

/// What a part begins with: whose it is and which film it is of.
fn header(film: &Film, key: u64) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    bytes.extend(key.to_le_bytes());
    for number in [film.width as u64, film.height as u64, u64::from(film.fps)] {
        bytes.extend(number.to_le_bytes());
    }
    bytes
}

/// What is there of a film's pictures.
pub(super) struct Spool {
    pub(super) part: Part,
    /// Stands behind the last picture.
    pub(super) file: File,
    /// Where the first picture lies.
    pub(super) start: u64,
    /// Bytes of each picture, its length included.
    pub(super) sizes: Vec<u32>,
    pub(super) begun: Begun,
}

/// Opens the part of the film at `path`, or begins one. None: its name is taken by a file of somebody else's, or another run is making the same film.
///
/// # Errors
///
/// What the disk says.
pub(super) fn open(path: &Path, film: &Film, key: u64) -> io::Result<Option<Spool>> {
    let name = Part::beside(path);
    let opened = OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .open(&name);
    let mut file = match opened {
        Ok(file) if file.metadata()?.is_file() => file,
        Ok(_) => return Ok(None),
        Err(_) if name.exists() => return Ok(None),
        Err(error) => return Err(error),
    };
    if file.try_lock().is_err() {
        return Ok(None);
    }
    let header = header(film, key);
    let mut there = Vec::new();
    (&mut file).take(header.len() as u64).read_to_end(&mut there)?;
    if !there.is_empty() && !there.starts_with(MAGIC) {
        return Ok(None);
    }
    let start = header.len() as u64;
    let (sizes, begun) = if there == header {
        let sizes = whole_groups(&file, start, film.fps as usize)?;
        let begun = match sizes.len() {
            0 => Begun::Nothing,
            count => Begun::Pictures(count),
        };
        (sizes, begun)
    } else {
        file.set_len(0)?;
        file.rewind()?;
        file.write_all(&header)?;
        let another = if there.is_empty() {
            Begun::Nothing
        } else {
            Begun::Another
        };
        (Vec::new(), another)
    };
    let end = start + sizes.iter().map(|size| u64::from(*size)).sum::<u64>();
    file.set_len(end)?;
    file.seek(SeekFrom::Start(end))?;
    Ok(Some(Spool {
        part: Part::new(name),
        file,
        start,
        sizes,
        begun,
    }))
}

/// Sizes of the pictures that lie behind `start`, up to the last whole group of `group` pictures.
fn whole_groups(file: &File, start: u64, group: usize) -> io::Result<Vec<u32>> {
    let length = file.metadata()?.len();
    let mut reader = BufReader::new(file);
    reader.seek(SeekFrom::Start(start))?;
    let (mut at, mut sizes) = (start, Vec::new());
    let mut word = [0; 4];
    while at + 4 < length {
        reader.read_exact(&mut word)?;
        let size = u32::from_be_bytes(word);
        // A length of nothing is a piece of disk that was never written.
        if size == 0 || at + 4 + u64::from(size) > length {
            break;
        }
        reader.seek_relative(i64::from(size))?;
        at += 4 + u64::from(size);
        sizes.push(4 + size);
    }
    sizes.truncate(sizes.len() / group.max(1) * group.max(1));
    Ok(sizes)
}
