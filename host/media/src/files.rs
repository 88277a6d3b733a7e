//! Files that are either whole or absent: written aside, then renamed.
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Read as _, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

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

/// Files that are being written aside.
static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Notes a file that is being written aside for as long as this lives.
struct Unfinished(PathBuf);

impl Unfinished {
    fn note(path: &Path) -> Self {
        UNFINISHED
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(path.to_owned());
        Self(path.to_owned())
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        UNFINISHED
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .retain(|path| *path != self.0);
    }
}

/// Removes every file that [`write_whole`] is just writing, for a program that ends before they are whole. No more of them come into being afterwards: whoever begins one
/// waits for the end.
pub fn abandon_unfinished() {
    let unfinished = UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner);
    for path in unfinished.iter() {
        // One that has got its name meanwhile is whole.
        let _ = std::fs::remove_file(path);
    }
    std::mem::forget(unfinished);
}

/// Links that are followed before they are taken for a ring; Linux stops at as many.
const MOST_LINKS: usize = 40;

/// Where a file that is to be whole or absent comes to lie.
pub(crate) enum Target {
    /// An ordinary file, there already or not: it is replaced when the new one is whole. The path is that behind any symbolic links.
    Replaced(PathBuf),
    /// A device, a named pipe or a socket. Who named it wants its reader to get the bytes, so they are written into it.
    Through(PathBuf),
}

impl Target {
    /// Looks at what is at `path`, through symbolic links, also those that lead to a file that is not there yet.
    pub(crate) fn at(path: &Path) -> Self {
        match std::fs::metadata(path) {
            Ok(about) if !about.is_file() && !about.is_dir() => return Self::Through(path.to_owned()),
            _ => {}
        }
        let mut behind = path.to_owned();
        for _ in 0..MOST_LINKS {
            let Ok(next) = std::fs::read_link(&behind) else {
                break;
            };
            // A relative link is meant from the folder that it lies in.
            behind = behind.parent().unwrap_or(Path::new("")).join(next);
        }
        match behind.is_symlink() {
            // Whoever opens a ring of links is told that it is one.
            true => Self::Through(path.to_owned()),
            false => Self::Replaced(behind),
        }
    }

    /// A folder for what is not whole yet: that of the file, which is made if it is missing, so that a rename is all that is left to do.
    pub(crate) fn folder(&self) -> Result<PathBuf, FileError> {
        match self {
            Self::Replaced(path) => Ok(folder_of(path)?.to_owned()),
            Self::Through(_) => Ok(std::env::temp_dir()),
        }
    }

    /// Gives a whole file, of [`Target::folder`], its name and the permissions of the one that it replaces.
    pub(crate) fn put(&self, from: &Path) -> Result<(), FileError> {
        match self {
            Self::Replaced(path) => {
                keep_permissions(path, || File::open(from)).map_err(|e| FileError::write(path, e))?;
                std::fs::rename(from, path).map_err(|e| FileError::write(path, e))
            }
            Self::Through(path) => {
                let copied = File::open(from).and_then(|mut from| {
                    io::copy(&mut from, &mut OpenOptions::new().write(true).open(path)?)
                });
                copied.map(drop).map_err(|e| FileError::write(path, e))
            }
        }
    }
}

/// Gives a new file the mode of the one at `path`, if there is one, and its owner where this program may do so.
fn keep_permissions(path: &Path, new: impl FnOnce() -> io::Result<File>) -> io::Result<()> {
    let Ok(old) = std::fs::metadata(path) else {
        return Ok(());
    };
    let new = new()?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::{MetadataExt as _, fchown};
        // Only root may give files away; for everybody else the new file is as much theirs as one that they had made anew.
        let _ = fchown(&new, Some(old.uid()), Some(old.gid()));
    }
    new.set_permissions(old.permissions())
}

/// Calls `write` on a buffered temporary file beside `path`, then renames it to `path`.
///
/// A failure or an interrupt leaves whatever was at `path` untouched. Missing parent folders are made. A file that is replaced hands on its
/// mode; a new one gets what the umask says. Symbolic links are followed, and what is no ordinary file, a device or a named pipe, stays what it
/// is: the bytes are written into it as they come.
///
/// # Errors
///
/// What the disk says, and what `write` says as the cause of [`FileError::Write`].
pub fn write_whole<E: Into<Cause>>(
    path: &Path,
    write: impl FnOnce(&mut dyn Write) -> Result<(), E>,
) -> Result<(), FileError> {
    let target = Target::at(path);
    let Target::Replaced(behind) = &target else {
        let through = OpenOptions::new().write(true).open(path);
        let mut buffered = BufWriter::new(through.map_err(|e| FileError::write(path, e))?);
        write(&mut buffered).map_err(|e| FileError::write(path, e))?;
        return buffered.flush().map_err(|e| FileError::write(path, e));
    };
    let folder = target.folder()?;
    let mut aside = tempfile::Builder::new();
    aside.prefix(".lipstream-").suffix(".tmp");
    #[cfg(unix)]
    // As every program that makes files asks; the umask takes off what it takes off.
    aside.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let aside = aside.tempfile_in(&folder).map_err(aside_error(&folder))?;
    let _unfinished = Unfinished::note(aside.path());
    let mut buffered = BufWriter::new(aside);
    write(&mut buffered).map_err(|e| FileError::write(path, e))?;
    let aside = buffered
        .into_inner()
        .map_err(|e| FileError::write(path, e.into_error()))?;
    keep_permissions(behind, || aside.as_file().try_clone()).map_err(|e| FileError::write(path, e))?;
    aside.persist(behind).map_err(|e| FileError::write(path, e))?;
    Ok(())
}

/// Opens a file that is written as time goes on, and that must not be there yet; a device or a named pipe is opened as it is.
///
/// # Errors
///
/// That there is a file already, and what the disk says.
pub fn create_anew(path: &Path) -> io::Result<File> {
    match Target::at(path) {
        Target::Through(path) => OpenOptions::new().write(true).open(path),
        Target::Replaced(path) => File::create_new(path),
    }
}

/// [`write_whole`] for bytes already in memory.
///
/// # Errors
///
/// As [`write_whole`].
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    write_whole(path, |file| file.write_all(bytes))
}

/// Most bytes that [`read_bytes`] takes from what is no ordinary file: a device or a pipe says nowhere how much is to come, and may never end.
pub const MOST_OF_A_STREAM: u64 = 256 << 20;
/// Most bytes of a text, labels or a dictionary: the words of weeks.
pub const MOST_OF_A_TEXT: u64 = 64 << 20;

/// Reads a whole file; the error names it.
///
/// # Errors
///
/// [`FileError::Read`], also of a device or a pipe with more than [`MOST_OF_A_STREAM`].
pub fn read_bytes(path: &Path) -> Result<Vec<u8>, FileError> {
    read_up_to(path, None)
}

/// [`read_bytes`] of a text, of at most [`MOST_OF_A_TEXT`].
///
/// # Errors
///
/// [`FileError::Read`].
pub fn read_text(path: &Path) -> Result<Vec<u8>, FileError> {
    read_up_to(path, Some(MOST_OF_A_TEXT))
}

/// A whole file of at most `most` bytes.
fn read_up_to(path: &Path, most: Option<u64>) -> Result<Vec<u8>, FileError> {
    let read = || {
        let mut file = File::open(path)?;
        let about = file.metadata()?;
        let most = match about.is_file() {
            true => most,
            false => Some(most.unwrap_or(MOST_OF_A_STREAM)),
        };
        let mut bytes = Vec::new();
        match most {
            None => file.read_to_end(&mut bytes)?,
            // One more tells whether that was all.
            Some(most) => file.take(most + 1).read_to_end(&mut bytes)?,
        };
        match most.filter(|most| bytes.len() as u64 > *most) {
            Some(most) => Err(io::Error::other(format!("more than {} MiB", most >> 20))),
            None => Ok(bytes),
        }
    };
    read().map_err(|source| FileError::Read {
        path: path.to_owned(),
        source,
    })
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::{FileTypeExt as _, PermissionsExt as _, symlink};
    use std::process::Command;

    use super::*;

    fn mode(path: &Path) -> u32 {
        std::fs::metadata(path).unwrap().permissions().mode() & 0o777
    }

    #[test]
    fn symbolic_links_are_followed() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("deep")).unwrap();
        std::fs::write(at("deep/there"), b"old").unwrap();
        symlink("deep/there", at("near")).unwrap();
        symlink("near", at("far")).unwrap();
        symlink("deep/not-yet", at("dangling")).unwrap();
        for (link, file) in [("far", "deep/there"), ("dangling", "deep/not-yet")] {
            write_bytes(&at(link), b"new").unwrap();
            assert!(at(link).is_symlink(), "{link}");
            assert!(!at(file).is_symlink(), "{file}");
            assert_eq!(std::fs::read(at(file)).unwrap(), b"new");
        }
        symlink("ring", at("ring")).unwrap();
        write_bytes(&at("ring"), b"new").unwrap_err();
    }

    #[test]
    fn a_file_keeps_its_mode_and_a_new_one_has_the_umasks() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("ordinary"), b"").unwrap();
        write_bytes(&at("new"), b"x").unwrap();
        assert_eq!(mode(&at("new")), mode(&at("ordinary")));
        for wanted in [0o600, 0o664, 0o755] {
            std::fs::set_permissions(at("new"), std::fs::Permissions::from_mode(wanted)).unwrap();
            write_bytes(&at("new"), b"y").unwrap();
            assert_eq!(mode(&at("new")), wanted);
            std::fs::write(at("made elsewhere"), b"z").unwrap();
            Target::at(&at("new")).put(&at("made elsewhere")).unwrap();
            assert_eq!(mode(&at("new")), wanted);
            assert_eq!(std::fs::read(at("new")).unwrap(), b"z");
        }
    }

    #[test]
    fn what_never_ends_is_refused() {
        let zero = Path::new("/dev/zero");
        for (read, said) in [
            (read_bytes(zero), "more than 256 MiB"),
            (read_text(zero), "more than 64 MiB"),
        ] {
            let error = read.unwrap_err();
            assert_eq!(error.to_string(), "cannot read /dev/zero");
            assert_eq!(std::error::Error::source(&error).unwrap().to_string(), said);
        }
        assert_eq!(read_bytes(Path::new("/dev/null")).unwrap(), b"");
        let folder = tempfile::tempdir().unwrap();
        let huge = folder.path().join("huge");
        File::create(&huge).unwrap().set_len(MOST_OF_A_TEXT + 1).unwrap();
        read_text(&huge).unwrap_err();
        File::create(&huge).unwrap().set_len(1000).unwrap();
        assert_eq!(read_text(&huge).unwrap(), [0; 1000]);
    }

    #[test]
    fn a_named_pipe_is_written_into() {
        let folder = tempfile::tempdir().unwrap();
        let (pipe, link, film) = (
            folder.path().join("pipe"),
            folder.path().join("link"),
            folder.path().join("film"),
        );
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        symlink(&pipe, &link).unwrap();
        std::fs::write(&film, b"film").unwrap();
        type Way<'a> = &'a dyn Fn(&Path) -> Result<(), FileError>;
        let ways: [(Way, &[u8]); 3] = [
            (&|path| write_bytes(path, b"words"), b"words"),
            (&|path| Target::at(path).put(&film), b"film"),
            (
                &|path| {
                    create_anew(path).unwrap().write_all(b"anew").unwrap();
                    Ok(())
                },
                b"anew",
            ),
        ];
        for path in [&pipe, &link] {
            for (write, wanted) in ways {
                let reader = std::thread::spawn({
                    let pipe = pipe.clone();
                    move || std::fs::read(pipe).unwrap()
                });
                write(path).unwrap();
                assert_eq!(reader.join().unwrap(), wanted);
                assert!(std::fs::metadata(&pipe).unwrap().file_type().is_fifo());
            }
        }
        let full = write_bytes(Path::new("/dev/full"), b"words").unwrap_err();
        assert_eq!(full.to_string(), "cannot write /dev/full");
        create_anew(&film).unwrap_err();
    }
}
