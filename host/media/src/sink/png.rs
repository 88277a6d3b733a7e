//! Numbered PNG files in a folder of their own, for editing and compositing programs.
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};

use super::{Film, Sink, aside, rename};

/// `000001.png` and so on, in a folder that appears when all are there.
pub struct PngFrames {
    folder: PathBuf,
    aside: tempfile::TempDir,
    width: u32,
    height: u32,
    count: usize,
}

impl PngFrames {
    /// Refuses a folder that exists: its pictures would mix with these.
    pub fn new(folder: &Path, film: &Film) -> Result<Self> {
        if folder.exists() {
            bail!("{} exists: name a folder that does not", folder.display());
        }
        Ok(Self {
            folder: folder.to_owned(),
            aside: aside(folder)?,
            width: u32::try_from(film.width)?,
            height: u32::try_from(film.height)?,
            count: 0,
        })
    }
}

impl Sink for PngFrames {
    fn picture(&mut self, rgb: &[u8]) -> Result<()> {
        self.count += 1;
        let path = self.aside.path().join(format!("{:06}.png", self.count));
        let write = || -> Result<()> {
            let mut encoder =
                png::Encoder::new(BufWriter::new(File::create(&path)?), self.width, self.height);
            encoder.set_color(png::ColorType::Rgb);
            encoder.set_depth(png::BitDepth::Eight);
            let mut writer = encoder.write_header()?;
            writer.write_image_data(rgb)?;
            Ok(writer.finish()?)
        };
        write().with_context(|| format!("cannot write picture {} of {}", self.count, self.folder.display()))
    }

    fn finish(self: Box<Self>) -> Result<()> {
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            std::fs::set_permissions(self.aside.path(), std::fs::Permissions::from_mode(0o755))?;
        }
        rename(&self.aside.keep(), &self.folder)
    }
}
