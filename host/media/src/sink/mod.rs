//! Where pictures go: a video file, another program, a folder, a pipe. A sink knows nothing of what was drawn.
//!
//! To add one: a file here with its [`Sink`]. Pictures are handed over one by one and not kept. What a sink makes is whole or absent.
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};

mod ffmpeg;
mod mp4;
mod png;
mod raw;

pub use ffmpeg::Ffmpeg;
pub use mp4::{Mp4, Mp4Bytes};
pub use png::PngFrames;
pub use raw::RawFrames;

/// What every sink has to know before the first picture.
#[derive(Clone, Copy, Debug)]
pub struct Film<'a> {
    /// Width and height of a picture in pixels.
    pub width: usize,
    pub height: usize,
    /// Pictures a second.
    pub fps: u32,
    /// 16 kHz mono; sample 0 is heard when picture 0 is seen. Sinks that hold no sound leave it out.
    pub sound: Option<&'a [i16]>,
}

/// Where pictures go.
pub trait Sink {
    /// The next picture: rows of interleaved R, G, B.
    ///
    /// # Errors
    ///
    /// What the encoder, the file or the program behind it says.
    fn picture(&mut self, rgb: &[u8]) -> Result<()>;

    /// All pictures have come: what was made gets its name.
    ///
    /// # Errors
    ///
    /// As [`Sink::picture`].
    fn finish(self: Box<Self>) -> Result<()>;
}

/// A folder beside `path` for what is not whole yet; it is removed with everything in it unless it is renamed.
fn aside(path: &Path) -> Result<tempfile::TempDir> {
    let parent = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    std::fs::create_dir_all(parent).with_context(|| format!("cannot make folder {}", parent.display()))?;
    tempfile::Builder::new()
        .prefix(".lipstream-")
        .tempdir_in(parent)
        .with_context(|| format!("cannot write in {}", parent.display()))
}

/// Gives what is whole its name.
fn rename(from: &Path, to: &PathBuf) -> Result<()> {
    std::fs::rename(from, to).with_context(|| format!("cannot write {}", to.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn film() -> Film<'static> {
        Film {
            width: 16,
            height: 16,
            fps: 25,
            sound: None,
        }
    }

    #[test]
    fn raw_frames_are_the_pictures() {
        let mut out = Vec::new();
        let mut sink: Box<dyn Sink + '_> = Box::new(RawFrames::new(&mut out));
        sink.picture(&[1; 768]).unwrap();
        sink.picture(&[2; 768]).unwrap();
        sink.finish().unwrap();
        assert_eq!(out, [[1; 768], [2; 768]].concat());
    }

    #[test]
    fn png_frames_are_read_back_and_appear_together() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("frames");
        let mut sink = Box::new(PngFrames::new(&target, &film()).unwrap());
        let picture: Vec<u8> = (0..768).map(|i| (i * 7 % 256) as u8).collect();
        sink.picture(&picture).unwrap();
        sink.picture(&[9; 768]).unwrap();
        assert!(!target.exists());
        sink.finish().unwrap();
        let mut names: Vec<_> = std::fs::read_dir(&target)
            .unwrap()
            .map(|e| e.unwrap().file_name())
            .collect();
        names.sort();
        assert_eq!(names, ["000001.png", "000002.png"]);
        let file = std::io::BufReader::new(std::fs::File::open(target.join("000001.png")).unwrap());
        let mut reader = ::png::Decoder::new(file).read_info().unwrap();
        let mut back = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut back).unwrap();
        assert_eq!(back, picture);
        // What is there is not overwritten.
        assert!(PngFrames::new(&target, &film()).is_err());
    }

    #[test]
    fn a_film_that_breaks_off_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["film.mp4", "frames"] {
            let path = folder.path().join(name);
            let mut sink: Box<dyn Sink> = match name {
                "frames" => Box::new(PngFrames::new(&path, &film()).unwrap()),
                _ => Box::new(Mp4::new(&path, &film()).unwrap()),
            };
            sink.picture(&[5; 768]).unwrap();
            drop(sink);
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "{name}");
        }
    }
}
