//! Numbered PNG files in a folder of their own, for editing and compositing programs.
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Read as _, Seek as _, Write};
use std::path::{Path, PathBuf};

use super::part::{Begun, Part};
use super::{Film, Sink, SinkError, aside};
use crate::files::{self, FileError, aside_error, folder_of};

/// `000001.png` and so on, in a folder that appears when all are there.
pub struct PngFrames {
    folder: PathBuf,
    part: Part,
    /// Locked as long as pictures are made; None where nobody will go on with them.
    note: Option<File>,
    begun: Begun,
    width: u32,
    height: u32,
    comment: Option<String>,
    count: usize,
}

impl PngFrames {
    /// Refuses a folder that exists: its pictures would mix with these. Until they are all there they are in a hidden folder beside it.
    ///
    /// # Errors
    ///
    /// That the folder is there, that there is no room beside it, or that pictures are too large.
    pub fn new(folder: &Path, film: &Film) -> Result<Self, SinkError> {
        Self::begin(folder, film, |folder| {
            Ok((Part::new(aside(folder_of(folder)?)?.keep()), None, Begun::Nothing))
        })
    }

    /// The same in a folder with `.part` behind its name. Should the program be killed, that stays, and the next call with this `key`, a number for everything that the
    /// pictures depend on, goes on behind them: see [`Sink::begun`].
    ///
    /// # Errors
    ///
    /// As [`PngFrames::new`].
    pub fn going_on(folder: &Path, film: &Film, key: u64) -> Result<Self, SinkError> {
        Self::begin(folder, film, |folder| open(folder, key, film.fps as usize))
    }

    fn begin(
        folder: &Path,
        film: &Film,
        place: impl FnOnce(&Path) -> Result<(Part, Option<File>, Begun), FileError>,
    ) -> Result<Self, SinkError> {
        if folder.exists() {
            return Err(SinkError::Exists(folder.to_owned()));
        }
        let side = |side: usize| {
            u32::try_from(side).map_err(|_| SinkError::Size {
                width: film.width,
                height: film.height,
            })
        };
        let (width, height) = (side(film.width)?, side(film.height)?);
        let (part, note, begun) = place(folder)?;
        Ok(Self {
            folder: folder.to_owned(),
            part,
            note,
            width,
            height,
            comment: film.comment.map(str::to_owned),
            count: begun.pictures(),
            begun,
        })
    }
}

/// Holds the key of the film whose pictures a part has, and is locked by the run that makes them.
const NOTE: &str = "lipstream-key";

/// The part of a folder, or a new one; and its note.
fn open(folder: &Path, key: u64, fps: usize) -> Result<(Part, Option<File>, Begun), FileError> {
    let beside = folder_of(folder)?;
    let path = Part::beside(folder);
    let there = path.exists();
    let (part, mut note) = match note_of(&path, !there) {
        Ok(Some(note)) => (Part::new(path), note),
        // It is somebody else's folder, or another run is at work in it: pictures go into one whose name nobody has.
        _ if there => {
            let aside = aside(beside)?.keep();
            let note = note_of(&aside, true).map_err(aside_error(beside))?;
            (
                Part::new(aside),
                note.ok_or_else(taken).map_err(aside_error(beside))?,
            )
        }
        Ok(None) => return Err(aside_error(beside)(taken())),
        Err(error) => return Err(aside_error(beside)(error)),
    };
    let begun = claim(&part, &mut note, key, fps).map_err(aside_error(part.path()))?;
    Ok((part, Some(note), begun))
}

fn taken() -> io::Error {
    io::Error::new(io::ErrorKind::ResourceBusy, "another run is at work in it")
}

/// The note in a part, which is made if `make` says so. None: another run has locked it.
fn note_of(part: &Path, make: bool) -> io::Result<Option<File>> {
    if make {
        std::fs::create_dir_all(part)?;
    }
    let note = OpenOptions::new()
        .read(true)
        .write(true)
        .create(make)
        .truncate(false)
        .open(part.join(NOTE))?;
    Ok(note.try_lock().is_ok().then_some(note))
}

/// Counts the pictures that are there of the film with this key, whole seconds of `fps`; those of another give way.
fn claim(part: &Part, note: &mut File, key: u64, fps: usize) -> io::Result<Begun> {
    let key = format!("{key:016x}\n");
    let mut there = String::new();
    note.read_to_string(&mut there)?;
    let pictures = (1..)
        .take_while(|number| part.path().join(name(*number)).is_file())
        .count();
    if there == key {
        // The last one may be half written.
        let whole = pictures.saturating_sub(1) / fps.max(1) * fps;
        return Ok(match whole {
            0 => Begun::Nothing,
            whole => Begun::Pictures(whole),
        });
    }
    for number in 1..=pictures {
        std::fs::remove_file(part.path().join(name(number)))?;
    }
    note.set_len(0)?;
    note.rewind()?;
    note.write_all(key.as_bytes())?;
    Ok(match there.is_empty() {
        true => Begun::Nothing,
        false => Begun::Another,
    })
}

/// Name of picture `number`, from 1.
fn name(number: usize) -> String {
    format!("{number:06}.png")
}

fn write(
    to: impl Write,
    width: u32,
    height: u32,
    rgb: &[u8],
    comment: Option<&str>,
) -> Result<(), png::EncodingError> {
    let mut encoder = png::Encoder::new(to, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    if let Some(comment) = comment {
        encoder.add_itxt_chunk("Comment".into(), comment.into())?;
    }
    let mut writer = encoder.write_header()?;
    writer.write_image_data(rgb)?;
    writer.finish()
}

/// Writes one picture, rows of R, G, B, whole or not at all.
///
/// # Errors
///
/// [`FileError`]: what the disk says, or that the bytes are no picture of this size.
pub fn write_png(path: &Path, width: usize, height: usize, rgb: &[u8]) -> Result<(), FileError> {
    let side = |side: usize| u32::try_from(side).unwrap_or(u32::MAX);
    files::write_whole(path, |file| {
        write(file, side(width), side(height), rgb, None).map_err(std::io::Error::other)
    })
}

impl Sink for PngFrames {
    fn picture(&mut self, rgb: &[u8]) -> Result<(), SinkError> {
        self.count += 1;
        let path = self.part.path().join(name(self.count));
        let file = File::create(&path).map_err(png::EncodingError::from);
        let (width, height, comment) = (self.width, self.height, self.comment.as_deref());
        let written = file.and_then(|file| write(BufWriter::new(file), width, height, rgb, comment));
        written.map_err(|e| SinkError::Picture {
            picture: self.count,
            folder: self.folder.clone(),
            source: e.into(),
        })
    }

    fn begun(&self) -> Begun {
        self.begun
    }

    fn finish(self: Box<Self>) -> Result<(), SinkError> {
        let Self {
            folder,
            mut part,
            note,
            ..
        } = *self;
        part.keep();
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            std::fs::set_permissions(part.path(), std::fs::Permissions::from_mode(0o755))
                .map_err(|e| FileError::write(&folder, e))?;
        }
        if note.is_some() {
            let note = part.path().join(NOTE);
            std::fs::remove_file(&note).map_err(|e| FileError::write(&note, e))?;
        }
        std::fs::rename(part.path(), &folder).map_err(|e| FileError::write(&folder, e))?;
        Ok(())
    }
}
