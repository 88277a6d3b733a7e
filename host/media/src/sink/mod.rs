//! Where pictures go: a video file, another program, a folder, a pipe. A sink knows nothing of what was drawn.
//!
//! To add one: a file here with its [`Sink`]. Pictures are handed over one by one and not kept. What a sink makes is whole or absent; what takes
//! long can be gone on with when the program was killed ([`Sink::begun`]).
use std::io;
use std::path::{Path, PathBuf};

use crate::Cause;
use crate::encode::EncodeError;
use crate::files::{FileError, aside_error};
use crate::sound::{self, SoundError};

mod ffmpeg;
mod mp4;
mod part;
mod png;
mod raw;

pub use ffmpeg::Ffmpeg;
pub use mp4::{Mp4, Mp4Bytes};
pub use part::Begun;
pub use png::{PngFrames, write_png};
pub use raw::RawFrames;

/// Why pictures did not get where they were to go.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SinkError {
    /// The name does not say which format is wanted.
    #[error("{} has no ending: write .mp4, .webm, .gif …", .0.display())]
    NoEnding(PathBuf),
    /// The program is missing or cannot be started.
    #[error(
        "cannot run ffmpeg ({0}), which every format but .mp4 needs: install it (Debian: apt install ffmpeg) or write .mp4"
    )]
    NoFfmpeg(io::Error),
    /// ffmpeg cannot be waited for.
    #[error("ffmpeg did not end")]
    Endless(#[source] io::Error),
    /// ffmpeg gave up; `said` is its last line.
    #[error("ffmpeg cannot write {}: {said}", path.display())]
    Ffmpeg {
        /// Which file.
        path: PathBuf,
        /// Its last line.
        said: String,
    },
    /// There is a folder already, whose pictures would mix with the new ones.
    #[error("{} exists: name a folder that does not", .0.display())]
    Exists(PathBuf),
    /// Picture `picture`, counted from 1, cannot be written.
    #[error("cannot write picture {picture} of {}", folder.display())]
    Picture {
        /// Its number, counted from 1.
        picture: usize,
        /// Which folder.
        folder: PathBuf,
        /// What happened.
        source: Cause,
    },
    /// The sides of a picture are larger than the format can say.
    #[error("pictures of {width}×{height} are too large")]
    Size {
        /// Width in pixels.
        width: usize,
        /// Height in pixels.
        height: usize,
    },
    /// The film cannot be encoded.
    #[error(transparent)]
    Encode(#[from] EncodeError),
    /// The sound cannot be handed over.
    #[error(transparent)]
    Sound(#[from] SoundError),
    /// A file cannot be written.
    #[error(transparent)]
    File(#[from] FileError),
    /// The pipe or the file behind it says.
    #[error(transparent)]
    Io(#[from] io::Error),
}

/// What every sink has to know before the first picture.
#[derive(Clone, Copy, Debug)]
pub struct Film<'a> {
    /// Width and height of a picture in pixels.
    pub width: usize,
    /// Height of a picture in pixels.
    pub height: usize,
    /// Pictures a second.
    pub fps: u32,
    /// Sample 0 is heard when picture 0 is seen. Sinks that hold no sound leave it out.
    pub sound: Option<Soundtrack<'a>>,
    /// What the file says of itself to whoever asks: one line. Sinks that hold no words leave it out.
    pub comment: Option<&'a str>,
}

/// The sound of a film, which is read from start to end as often as it is needed.
#[derive(Clone, Copy, Debug)]
pub enum Soundtrack<'a> {
    /// 16 kHz mono.
    Samples(&'a [i16]),
    /// A sound file, of which only the piece that is at work is in memory.
    File(&'a Path),
}

impl Soundtrack<'_> {
    /// Calls `take` with 16 kHz mono samples, piece by piece, and gives their number.
    ///
    /// # Errors
    ///
    /// That the file cannot be read, and what `take` says.
    pub fn each<E: From<SoundError>>(
        &self,
        mut take: impl FnMut(&[i16]) -> Result<(), E>,
    ) -> Result<usize, E> {
        match self {
            Soundtrack::Samples(samples) => {
                take(samples)?;
                Ok(samples.len())
            }
            Soundtrack::File(path) => {
                let mut reader = sound::Reader::open(path)?;
                let mut count = 0;
                while let Some(piece) = reader.piece()? {
                    take(piece)?;
                    count += piece.len();
                }
                Ok(count)
            }
        }
    }

    /// Number of samples; reads a file to its end.
    ///
    /// # Errors
    ///
    /// That the file cannot be read.
    pub fn samples(&self) -> Result<usize, SoundError> {
        self.each(|_| Ok(()))
    }
}

/// Where pictures go.
pub trait Sink {
    /// The next picture: rows of interleaved R, G, B.
    ///
    /// # Errors
    ///
    /// What the encoder, the file or the program behind it says.
    fn picture(&mut self, rgb: &[u8]) -> Result<(), SinkError>;

    /// What an interrupted run has made of the film, in whole seconds: that many pictures are not to be handed over again.
    fn begun(&self) -> Begun {
        Begun::Nothing
    }

    /// All pictures have come: what was made gets its name.
    ///
    /// # Errors
    ///
    /// As [`Sink::picture`].
    fn finish(self: Box<Self>) -> Result<(), SinkError>;
}

/// A folder in `parent` for what is not whole yet; it is removed with everything in it unless it is renamed.
fn aside(parent: &Path) -> Result<tempfile::TempDir, FileError> {
    tempfile::Builder::new()
        .prefix(".lipstream-")
        .tempdir_in(parent)
        .map_err(aside_error(parent))
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
            comment: Some("a film & its “words”"),
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
        let words = &reader.info().utf8_text[0];
        assert_eq!(
            (words.keyword.as_str(), words.get_text().unwrap().as_str()),
            ("Comment", "a film & its “words”")
        );
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
                "frames" => Box::new(PngFrames::going_on(&path, &film(), 1).unwrap()),
                _ => Box::new(Mp4::going_on(&path, &film(), 1).unwrap()),
            };
            sink.picture(&[5; 768]).unwrap();
            drop(sink);
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "{name}");
        }
    }

    #[test]
    fn a_film_in_a_file_is_the_film_in_memory() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("made/film.mp4");
        // Longer than the pictures, and than one piece of what is encoded at a time.
        let sound: Vec<i16> = (0..40_000).map(|i| (i * 37 % 5000) as i16).collect();
        let film = Film {
            sound: Some(Soundtrack::Samples(&sound)),
            ..film()
        };
        let mut file: Box<dyn Sink> = Box::new(Mp4::new(&path, &film).unwrap());
        let mut memory = Mp4Bytes::new(&film).unwrap();
        for level in 0..40 {
            file.picture(&[5 * level; 768]).unwrap();
            memory.picture(&[5 * level; 768]).unwrap();
        }
        file.finish().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), memory.bytes().unwrap());
        // Nothing is left beside it.
        assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    /// Pictures that move, no two alike.
    fn moving(number: usize) -> Vec<u8> {
        (0..768)
            .map(|i| ((i * (7 + number) + 31 * number) % 256) as u8)
            .collect()
    }

    /// What lies at `part` while `sink` is at work stays when it is dropped, as if the program had been killed.
    fn killed(sink: Mp4, part: &Path) -> Vec<u8> {
        let bytes = std::fs::read(part).unwrap();
        drop(sink);
        assert!(!part.exists());
        std::fs::write(part, &bytes).unwrap();
        bytes
    }

    #[test]
    fn a_killed_film_goes_on_behind_its_whole_groups() {
        let folder = tempfile::tempdir().unwrap();
        let (path, whole) = (folder.path().join("film.mp4"), folder.path().join("whole.mp4"));
        let part = folder.path().join("film.mp4.part");
        // Groups wait for their turn on as many cores as there are.
        let all = 25 * (std::thread::available_parallelism().map_or(1, usize::from) + 4);
        let feed = |sink: &mut Mp4, until: usize| {
            for number in sink.begun().pictures()..until {
                sink.picture(&moving(number)).unwrap();
            }
        };
        let finish = |path: &Path, key| {
            let mut sink = Mp4::going_on(path, &film(), key).unwrap();
            let begun = sink.begun();
            feed(&mut sink, all);
            Box::new(sink).finish().unwrap();
            begun
        };
        assert_eq!(finish(&whole, 1), Begun::Nothing);
        let mut sink = Mp4::going_on(&path, &film(), 1).unwrap();
        feed(&mut sink, all - 30);
        let bytes = killed(sink, &part);
        // A picture that was cut short, and a disk that was promised more than it got.
        std::fs::write(&part, [&bytes[..bytes.len() - 3], &[0; 4096]].concat()).unwrap();
        let begun = finish(&path, 1);
        assert!(
            matches!(begun, Begun::Pictures(n) if n >= 25 && n % 25 == 0),
            "{begun:?}"
        );
        assert_eq!(std::fs::read(&path).unwrap(), std::fs::read(&whole).unwrap());
        assert!(!part.exists());
        // What was begun otherwise gives way.
        let mut sink = Mp4::going_on(&path, &film(), 2).unwrap();
        feed(&mut sink, all - 30);
        killed(sink, &part);
        assert_eq!(finish(&path, 1), Begun::Another);
        assert_eq!(std::fs::read(&path).unwrap(), std::fs::read(&whole).unwrap());
    }

    #[test]
    fn a_part_of_somebody_elses_or_at_work_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("film.mp4");
        let part = folder.path().join("film.mp4.part");
        let make = || {
            let mut sink = Mp4::going_on(&path, &film(), 1).unwrap();
            let begun = sink.begun();
            sink.picture(&moving(1)).unwrap();
            Box::new(sink).finish().unwrap();
            begun
        };
        std::fs::write(&part, b"half of a download").unwrap();
        assert_eq!(make(), Begun::Nothing);
        assert_eq!(std::fs::read(&part).unwrap(), b"half of a download");
        std::fs::remove_file(&part).unwrap();
        let mut at_work = Mp4::going_on(&path, &film(), 1).unwrap();
        for number in 0..100 {
            at_work.picture(&moving(number)).unwrap();
        }
        assert_eq!(make(), Begun::Nothing);
        assert!(part.exists());
        Box::new(at_work).finish().unwrap();
        assert!(!part.exists());
    }

    #[test]
    fn a_killed_folder_goes_on_behind_its_whole_pictures() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("frames/");
        let part = folder.path().join("frames.part");
        let begin = |key| PngFrames::going_on(&target, &film(), key).unwrap();
        let mut sink = begin(1);
        for number in 0..27 {
            sink.picture(&moving(number)).unwrap();
        }
        let elsewhere = folder.path().join("elsewhere");
        std::fs::rename(&part, &elsewhere).unwrap();
        drop(sink);
        std::fs::rename(&elsewhere, &part).unwrap();
        std::fs::write(part.join("000027.png"), b"half").unwrap();
        let mut sink = Box::new(begin(1));
        assert_eq!(sink.begun(), Begun::Pictures(25));
        // Another run at the same time works elsewhere, and one that nobody can know again.
        assert_eq!(PngFrames::new(&target, &film()).unwrap().begun(), Begun::Nothing);
        assert_eq!(begin(1).begun(), Begun::Nothing);
        for number in 25..30 {
            sink.picture(&moving(number)).unwrap();
        }
        sink.finish().unwrap();
        let mut names: Vec<_> = std::fs::read_dir(&target)
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        let wanted: Vec<_> = (1..31).map(|n| format!("{n:06}.png")).collect();
        assert_eq!(names, wanted);
        assert!(!part.exists());
        let file = std::io::BufReader::new(std::fs::File::open(target.join("000027.png")).unwrap());
        let mut reader = ::png::Decoder::new(file).read_info().unwrap();
        let mut back = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut back).unwrap();
        assert_eq!(back, moving(26));
    }

    #[test]
    fn an_error_is_its_part_and_its_cause() {
        let path = Path::new("no/such/file");
        let error = crate::sound::read(path).unwrap_err();
        assert!(
            matches!(error, SoundError::File(FileError::Read { .. })),
            "{error:?}"
        );
        let line = format!("{:#}", anyhow::Error::from(error));
        assert!(line.starts_with("cannot read no/such/file: "), "{line}");
        // Each part once.
        assert_eq!(line.matches("no/such/file").count(), 1, "{line}");

        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("film.mp4");
        let nothing: Box<dyn Sink> = Box::new(Mp4::new(&path, &film()).unwrap());
        let line = format!("{:#}", anyhow::Error::from(nothing.finish().unwrap_err()));
        assert_eq!(
            line,
            format!("cannot write {}: there is no picture to encode", path.display())
        );
    }
}
