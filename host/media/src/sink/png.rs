//! Numbered PNG files in a folder of their own, for editing and compositing programs.
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use super::{Film, Sink, SinkError, aside, rename};
use crate::files::{self, FileError};

/// `000001.png` and so on, in a folder that appears when all are there.
pub struct PngFrames {
    folder: PathBuf,
    aside: tempfile::TempDir,
    width: u32,
    height: u32,
    comment: Option<String>,
    count: usize,
}

impl PngFrames {
    /// Refuses a folder that exists: its pictures would mix with these.
    pub fn new(folder: &Path, film: &Film) -> Result<Self, SinkError> {
        if folder.exists() {
            return Err(SinkError::Exists(folder.to_owned()));
        }
        let side = |side: usize| {
            u32::try_from(side).map_err(|_| SinkError::Size {
                width: film.width,
                height: film.height,
            })
        };
        Ok(Self {
            folder: folder.to_owned(),
            aside: aside(folder)?,
            width: side(film.width)?,
            height: side(film.height)?,
            comment: film.comment.map(str::to_owned),
            count: 0,
        })
    }
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
        let path = self.aside.path().join(format!("{:06}.png", self.count));
        let file = File::create(&path).map_err(png::EncodingError::from);
        let (width, height, comment) = (self.width, self.height, self.comment.as_deref());
        let written = file.and_then(|file| write(BufWriter::new(file), width, height, rgb, comment));
        written.map_err(|e| SinkError::Picture {
            picture: self.count,
            folder: self.folder.clone(),
            source: e.into(),
        })
    }

    fn finish(self: Box<Self>) -> Result<(), SinkError> {
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            std::fs::set_permissions(self.aside.path(), std::fs::Permissions::from_mode(0o755))
                .map_err(|e| FileError::write(&self.folder, e))?;
        }
        Ok(rename(&self.aside.keep(), &self.folder)?)
    }
}
