//! Every other video format, through the `ffmpeg` program.
use std::ffi::OsString;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};

use super::{Film, Sink, SinkError, aside};
use crate::files::Target;
use crate::sound;

/// A film in whatever format `ffmpeg` makes of the ending of its name.
pub struct Ffmpeg {
    path: PathBuf,
    target: Target,
    unfinished: PathBuf,
    running: Child,
    /// None once ffmpeg has stopped listening.
    stdin: Option<ChildStdin>,
    /// Where the film and its sound lie until it is whole. Last: what is in it outlives ffmpeg.
    _aside: tempfile::TempDir,
}

impl Ffmpeg {
    /// Starts `ffmpeg`.
    ///
    /// # Errors
    ///
    /// That the name has no ending, its folder cannot be written in, or there is no `ffmpeg`: then what to do.
    pub fn new(path: &Path, film: &Film) -> Result<Self, SinkError> {
        let ending = path
            .extension()
            .ok_or_else(|| SinkError::NoEnding(path.to_owned()))?;
        let gif = ending.eq_ignore_ascii_case("gif");
        let target = Target::at(path);
        let aside = aside(&target.folder()?)?;
        let mut name = OsString::from("video.");
        name.push(ending);
        let unfinished = aside.path().join(name);

        let mut ffmpeg = Command::new("ffmpeg");
        ffmpeg.args(["-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]);
        let (width, height) = (film.width, film.height);
        ffmpeg.args(["-s", &format!("{width}x{height}"), "-r", &film.fps.to_string()]);
        ffmpeg.args(["-i", "-"]);
        if let Some(sound) = film.sound.filter(|_| !gif) {
            let wav = aside.path().join("sound.wav");
            let mut writer = sound::Writer::create(&wav)?;
            sound.each(|samples| writer.write(samples))?;
            writer.finish()?;
            ffmpeg.arg("-i").arg(wav);
        }
        if gif {
            let palette = "split[a][b];[a]palettegen[p];[b][p]paletteuse=dither=bayer";
            ffmpeg.args(["-vf", palette]);
        }
        if let Some(comment) = film.comment {
            ffmpeg.args(["-metadata", &format!("comment={comment}")]);
        }
        ffmpeg
            .arg(&unfinished)
            .stdin(Stdio::piped())
            .stderr(Stdio::piped());
        let mut running = ffmpeg.spawn().map_err(SinkError::NoFfmpeg)?;
        Ok(Self {
            path: path.to_owned(),
            target,
            unfinished,
            stdin: running.stdin.take(),
            running,
            _aside: aside,
        })
    }
}

impl Sink for Ffmpeg {
    fn picture(&mut self, rgb: &[u8]) -> Result<(), SinkError> {
        // What ffmpeg did not like it says when it has ended.
        if self
            .stdin
            .as_mut()
            .is_some_and(|stdin| stdin.write_all(rgb).is_err())
        {
            self.stdin = None;
            return self.end();
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<(), SinkError> {
        self.stdin = None;
        self.end()?;
        Ok(self.target.put(&self.unfinished)?)
    }
}

impl Ffmpeg {
    /// Waits for ffmpeg's end, and says what went wrong.
    fn end(&mut self) -> Result<(), SinkError> {
        use std::io::Read as _;
        let mut said = String::new();
        if let Some(mut stderr) = self.running.stderr.take() {
            // Words that cannot be read only make the error less talkative.
            let _ = stderr.read_to_string(&mut said);
        }
        let status = self.running.wait().map_err(SinkError::Endless)?;
        if !status.success() {
            return Err(SinkError::Ffmpeg {
                path: self.path.clone(),
                said: said
                    .lines()
                    .last()
                    .unwrap_or("it ended without a word")
                    .to_owned(),
            });
        }
        Ok(())
    }
}

impl Drop for Ffmpeg {
    /// A film that breaks off takes its ffmpeg with it.
    fn drop(&mut self) {
        self.stdin = None;
        // One that has ended already cannot be killed, which is as well.
        let _ = self.running.kill();
        let _ = self.running.wait();
    }
}
