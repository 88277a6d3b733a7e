//! Pictures and sound of a video file, through the `ffmpeg` and `ffprobe` programs.
//!
//! Both are laid on one clock that starts with the file: the pictures at a constant rate, the sound padded or trimmed at
//! its start, so that a stream that begins late stays in step with the other.
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde::Deserialize;

use crate::Cause;

/// Pictures whose shorter side has more pixels than this are scaled down while decoding: a mouth is never kept larger than that needs.
pub const MAX_LINES: usize = 576;
/// A clip is one utterance. Beyond this size its pictures do not fit in memory side by side with others.
const MAX_BYTES: usize = 4 << 30;
const GET_FFMPEG: &str = "lipstream reads video through it: install it (Debian, Ubuntu: `apt install ffmpeg`; Fedora: \
     `dnf install ffmpeg-free`; macOS: `brew install ffmpeg`; Windows: `winget install ffmpeg`)";

/// Why a video was not read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VideoError {
    /// A program that reads video is not installed.
    #[error("the program `{0}` is not there; {GET_FFMPEG}")]
    NoProgram(&'static str),
    /// A program that reads video is there and does not start.
    #[error("cannot start `{program}`")]
    NotStarted {
        /// Its name.
        program: &'static str,
        /// What happened.
        source: io::Error,
    },
    /// There is no such file.
    #[error("{}: no such file", .0.display())]
    NoFile(PathBuf),
    /// ffmpeg or ffprobe refuses the file: what it could not do, and its last line.
    #[error("{0}")]
    Refused(String),
    /// What ffmpeg or ffprobe gave cannot be understood or is cut off.
    #[error("{0}")]
    Answer(String),
    /// The clip is readable and cannot be worked with: without pictures or a rate, of varying size, too long.
    #[error("{0}")]
    Unsuitable(String),
    /// What was being done, or what it was done to, when `source` happened.
    #[error("{what}")]
    Context {
        /// What was being done.
        what: String,
        /// What happened.
        source: Cause,
    },
    /// A pipe broke.
    #[error(transparent)]
    Io(#[from] io::Error),
}

/// What everything here that can fail returns.
type Result<T, E = VideoError> = std::result::Result<T, E>;

/// Says what was being done when an error happened.
fn context<E: Into<Cause>>(what: impl Into<String>) -> impl FnOnce(E) -> VideoError {
    |source| VideoError::Context {
        what: what.into(),
        source: source.into(),
    }
}

/// The pictures of one clip.
#[derive(Clone, Debug)]
pub struct Frames {
    /// Width of a picture in pixels.
    pub width: usize,
    /// Height of a picture in pixels.
    pub height: usize,
    /// Pictures a second.
    pub rate_hz: f32,
    /// `[n, height, width, 3]`, R, G, B in 0..=255.
    pub rgb: Vec<u8>,
}

impl Frames {
    /// Number of pictures.
    pub fn len(&self) -> usize {
        self.rgb.len() / self.stride().max(1)
    }

    /// Whether there is no picture.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Picture `index`, `[height, width, 3]`.
    pub fn frame(&self, index: usize) -> &[u8] {
        &self.rgb[index * self.stride()..][..self.stride()]
    }

    /// Every `step`-th picture: enough to learn a face from, in a fraction of the memory.
    pub fn thinned(&self, step: usize) -> Frames {
        let step = step.max(1);
        Frames {
            width: self.width,
            height: self.height,
            rate_hz: self.rate_hz / step as f32,
            rgb: (0..self.len())
                .step_by(step)
                .flat_map(|i| self.frame(i))
                .copied()
                .collect(),
        }
    }

    fn stride(&self) -> usize {
        self.width * self.height * 3
    }
}

/// A part of a video.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// Where it begins, seconds.
    pub begins_s: f64,
    /// How long it is.
    pub seconds: f64,
}

/// All pictures of a video at its own rate, upright, square pixels, the shorter side at most [`MAX_LINES`].
pub fn decode(path: &Path) -> Result<Frames> {
    decode_part(path, None)
}

/// [`decode`], of a part of it where one is given.
pub fn decode_part(path: &Path, part: Option<Part>) -> Result<Frames> {
    let rate = picture_rate(path, probe(path)?)?;
    let (width, height, rgb) = through_ffmpeg(path, &rate, part, MAX_LINES, read_pictures)?;
    if rgb.is_empty() {
        return Err(VideoError::Refused(format!(
            "ffmpeg finds no picture in {}",
            path.display()
        )));
    }
    Ok(Frames {
        width,
        height,
        rate_hz: rate_hz(path, &rate)?,
        rgb,
    })
}

/// Hands out the pictures of a video, or of a part of it, one by one: `each(width, height, rgb)`. Upright, square pixels, the shorter side at most `lines`.
/// Gives the number of pictures a second.
///
/// # Errors
///
/// As [`decode`], and what `each` says, which ends it.
pub fn each_picture<E: From<VideoError>>(
    path: &Path,
    part: Option<Part>,
    lines: usize,
    mut each: impl FnMut(usize, usize, &[u8]) -> Result<(), E>,
) -> Result<f32, E> {
    let rate = picture_rate(path, probe(path)?)?;
    let mut said = Ok(());
    let read = through_ffmpeg(path, &rate, part, lines, |out| {
        let mut rgb = Vec::new();
        while let Some((width, height)) = read_ppm_header(out)? {
            rgb.resize(width * height * 3, 0);
            out.read_exact(&mut rgb)
                .map_err(context("the last picture is cut off"))?;
            said = each(width, height, &rgb);
            if said.is_err() {
                // Its words are those of `each`.
                return Err(VideoError::Answer(String::new()));
            }
        }
        Ok(())
    });
    said?;
    read?;
    Ok(rate_hz(path, &rate)?)
}

/// Lets ffmpeg write pictures as PPM, and `read` read them.
fn through_ffmpeg<T>(
    path: &Path,
    rate: &str,
    part: Option<Part>,
    lines: usize,
    read: impl FnOnce(&mut BufReader<std::process::ChildStdout>) -> Result<T>,
) -> Result<T> {
    // What stands upright, as phones film, has its shorter side across.
    let smaller = format!("min(1,{lines}/min(iw*sar,ih))");
    let filter = format!(
        "fps={rate}:start_time=0,scale=w='trunc(iw*sar*{smaller}/2+0.5)*2':h='if(lt({smaller},1),trunc(ih*{smaller}/2+0.5)*2,ih)',setsar=1"
    );
    let times = part.map_or(Vec::new(), |part| {
        let (begins, seconds) = (format!("{:.4}", part.begins_s), format!("{:.4}", part.seconds));
        vec!["-ss".to_owned(), begins, "-t".to_owned(), seconds]
    });
    let mut child = program("ffmpeg")
        .args(["-nostdin", "-v", "error"])
        .args(times)
        .args(named_alone(path))
        .args(["-map", "0:v:0", "-an", "-sn", "-vf", &filter])
        .args([
            "-sws_flags",
            "area+accurate_rnd+full_chroma_int",
            "-pix_fmt",
            "rgb24",
            "-f",
            "image2pipe",
            "-c:v",
            "ppm",
            "-",
        ])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(|e| not_started("ffmpeg", e))?;
    let (out, mut err) = (
        child.stdout.take().expect("piped"),
        child.stderr.take().expect("piped"),
    );
    // Read aside: a full pipe of messages would stop ffmpeg while we wait for pictures.
    let messages = std::thread::spawn(move || {
        let mut text = Vec::new();
        // Lost messages only make an error less talkative.
        let _ = err.read_to_end(&mut text);
        text
    });
    let pictures = read(&mut BufReader::with_capacity(1 << 20, out));
    if pictures.is_err() {
        let _ = child.kill();
    }
    let status = child.wait()?;
    let messages = messages.join().unwrap_or_default();
    let pictures = pictures.map_err(context(format!("cannot decode {}", path.display())))?;
    if !status.success() {
        return Err(VideoError::Refused(format!(
            "ffmpeg cannot decode {}: {}",
            path.display(),
            last_line(&messages)
        )));
    }
    Ok(pictures)
}

/// The picture rate as a number.
fn rate_hz(path: &Path, rate: &str) -> Result<f32> {
    ratio(rate).ok_or_else(|| {
        VideoError::Answer(format!(
            "{}: ffprobe calls its picture rate {rate:?}",
            path.display()
        ))
    })
}

/// The sound of a video, or of any sound file, as a WAV file in memory: 16 bit, its own rate and channels.
pub fn decode_sound(path: &Path) -> Result<Vec<u8>> {
    if !path.is_file() {
        return Err(VideoError::NoFile(path.to_owned()));
    }
    let out = program("ffmpeg")
        .args(["-nostdin", "-v", "error"])
        .args(named_alone(path))
        .args([
            "-map",
            "0:a:0",
            "-vn",
            "-sn",
            "-map_metadata",
            "-1",
            "-fflags",
            "+bitexact",
        ])
        .args([
            "-af",
            "aresample=async=1:first_pts=0",
            "-c:a",
            "pcm_s16le",
            "-f",
            "wav",
            "-",
        ])
        .output()
        .map_err(|e| not_started("ffmpeg", e))?;
    if !out.status.success() {
        return Err(VideoError::Refused(format!(
            "ffmpeg finds no sound in {}: {}",
            path.display(),
            last_line(&out.stderr)
        )));
    }
    let mut wav = out.stdout;
    state_lengths(&mut wav).map_err(context(format!("the sound of {}", path.display())))?;
    Ok(wav)
}

/// Writes the true lengths into a WAV header that was written to a pipe.
fn state_lengths(wav: &mut [u8]) -> Result<()> {
    let too_long = || VideoError::Unsuitable("longer than a WAV file can be".to_owned());
    let riff = u32::try_from(wav.len().saturating_sub(8)).map_err(|_| too_long())?;
    if wav.len() < 12 || &wav[..4] != b"RIFF" || &wav[8..12] != b"WAVE" {
        return Err(VideoError::Answer("ffmpeg wrote no WAV file".to_owned()));
    }
    wav[4..8].copy_from_slice(&riff.to_le_bytes());
    let mut at = 12;
    while at + 8 <= wav.len() {
        let size = u32::from_le_bytes([wav[at + 4], wav[at + 5], wav[at + 6], wav[at + 7]]) as usize;
        if &wav[at..at + 4] == b"data" {
            let true_size = u32::try_from(wav.len() - at - 8).map_err(|_| too_long())?;
            wav[at + 4..at + 8].copy_from_slice(&true_size.to_le_bytes());
            return Ok(());
        }
        at += 8 + size + size % 2;
    }
    Err(VideoError::Answer(
        "ffmpeg wrote a WAV file without samples".to_owned(),
    ))
}

#[derive(Deserialize)]
struct Probe {
    #[serde(default)]
    streams: Vec<ProbeStream>,
}

#[derive(Deserialize)]
struct ProbeStream {
    r_frame_rate: String,
    avg_frame_rate: String,
    width: usize,
    height: usize,
    sample_aspect_ratio: Option<String>,
}

/// What is known of a video's pictures before any is decoded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Facts {
    /// Pictures a second.
    pub rate_hz: f32,
    /// How many of the video's own pixels, made square, lie side by side in one pixel of its decoded pictures: 1 unless they are reduced to
    /// [`MAX_LINES`].
    pub reduction: f32,
}

/// Asks ffprobe.
///
/// # Errors
///
/// That the file cannot be read, or has no pictures.
pub fn facts(path: &Path) -> Result<Facts> {
    let stream = probe(path)?;
    let wide = stream.sample_aspect_ratio.as_deref().and_then(quotient);
    let width = stream.width as f32 * wide.filter(|wide| *wide > 0.0).unwrap_or(1.0);
    let reduction = (width.min(stream.height as f32) / MAX_LINES as f32).max(1.0);
    let rate = picture_rate(path, stream)?;
    Ok(Facts {
        rate_hz: as_hz(&rate, path)?,
        reduction,
    })
}

/// What ffprobe says of the first stream of pictures.
fn probe(path: &Path) -> Result<ProbeStream> {
    if !path.is_file() {
        return Err(VideoError::NoFile(path.to_owned()));
    }
    let out = program("ffprobe")
        .args([
            "-v",
            "error",
            "-select_streams",
            "v:0",
            "-of",
            "json",
            "-show_entries",
        ])
        .arg("stream=r_frame_rate,avg_frame_rate,width,height,sample_aspect_ratio")
        .args(named_alone(path))
        .output()
        .map_err(|e| not_started("ffprobe", e))?;
    if !out.status.success() {
        return Err(VideoError::Refused(format!(
            "ffprobe cannot read {}: {}",
            path.display(),
            last_line(&out.stderr)
        )));
    }
    let probe: Probe = serde_json::from_slice(&out.stdout).map_err(context(format!(
        "{}: ffprobe's answer is not understood",
        path.display()
    )))?;
    let stream = probe.streams.into_iter().next();
    stream.ok_or_else(|| VideoError::Unsuitable(format!("{}: there is no video in it", path.display())))
}

/// The picture rate as ffmpeg writes it, `25/1`.
fn picture_rate(path: &Path, stream: ProbeStream) -> Result<String> {
    // The nominal rate, unless it is only the clock of a video of varying rate.
    match (ratio(&stream.r_frame_rate), ratio(&stream.avg_frame_rate)) {
        (Some(nominal), Some(average)) if nominal > 1.05 * average => Ok(stream.avg_frame_rate),
        (Some(_), _) => Ok(stream.r_frame_rate),
        (None, Some(_)) => Ok(stream.avg_frame_rate),
        (None, None) => Err(VideoError::Unsuitable(format!(
            "{}: the video has no picture rate",
            path.display()
        ))),
    }
}

/// The picture rate as a number.
fn as_hz(rate: &str, path: &Path) -> Result<f32> {
    ratio(rate).ok_or_else(|| {
        VideoError::Answer(format!(
            "{}: ffprobe calls its picture rate {rate:?}",
            path.display()
        ))
    })
}

/// `25/1` as 25; nothing for 0/0, negative or absurd rates.
fn ratio(text: &str) -> Option<f32> {
    let rate = quotient(text)?;
    (1.0..=1000.0).contains(&rate).then_some(rate)
}

/// `12/11` or `12:11` as a number; nothing where it is none.
fn quotient(text: &str) -> Option<f32> {
    let (up, down) = text.split_once(['/', ':'])?;
    let quotient = up.parse::<f32>().ok()? / down.parse::<f32>().ok()?;
    quotient.is_finite().then_some(quotient)
}

/// Width, height and all pictures of a stream of binary PPM pictures of one size.
fn read_pictures(from: &mut impl Read) -> Result<(usize, usize, Vec<u8>)> {
    let mut rgb: Vec<u8> = Vec::new();
    let mut size = None;
    while let Some((width, height)) = read_ppm_header(from)? {
        let (width0, height0) = *size.get_or_insert((width, height));
        if (width, height) != (width0, height0) {
            return Err(VideoError::Unsuitable(format!(
                "the picture changes size from {width0}×{height0} to {width}×{height}"
            )));
        }
        let start = rgb.len();
        let end = start + width * height * 3;
        if end > MAX_BYTES {
            return Err(VideoError::Unsuitable(format!(
                "longer than {} pictures of {width}×{height}: cut it into utterances of some seconds",
                MAX_BYTES / (width * height * 3)
            )));
        }
        rgb.resize(end, 0);
        from.read_exact(&mut rgb[start..])
            .map_err(context("the last picture is cut off"))?;
    }
    let (width, height) = size.unwrap_or((0, 0));
    Ok((width, height, rgb))
}

/// `P6 width height 255`; nothing at the end of the stream.
fn read_ppm_header(from: &mut impl Read) -> Result<Option<(usize, usize)>> {
    let mut words: Vec<String> = vec![String::new()];
    let mut byte = [0u8];
    while words.len() <= 4 {
        if from.read(&mut byte)? == 0 {
            if words.len() == 1 && words[0].is_empty() {
                return Ok(None);
            }
            return Err(VideoError::Answer("a picture's header is cut off".to_owned()));
        }
        let word = words.last_mut().expect("never empty");
        if byte[0].is_ascii_whitespace() {
            words.push(String::new());
        } else if word.len() < 8 {
            word.push(char::from(byte[0]));
        } else {
            return Err(VideoError::Answer(
                "ffmpeg wrote something that is no picture".to_owned(),
            ));
        }
    }
    let number = |word: &str| word.parse::<usize>().ok().filter(|n| (1..=16384).contains(n));
    match (&words[0][..], number(&words[1]), number(&words[2]), &words[3][..]) {
        ("P6", Some(width), Some(height), "255") => Ok(Some((width, height))),
        _ => Err(VideoError::Answer(format!(
            "ffmpeg wrote a picture of an unknown kind: {}",
            words.join(" ").trim()
        ))),
    }
}

/// Whether video can be read here at all; the error says how to get what is missing.
pub fn available() -> Result<()> {
    for name in ["ffmpeg", "ffprobe"] {
        let ran = program(name)
            .arg("-version")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
        ran.map_err(|e| not_started(name, e))?;
    }
    Ok(())
}

fn program(name: &str) -> Command {
    let mut command = Command::new(name);
    command.stdin(Stdio::null());
    command
}

/// Demuxers of files that hold what they play. Playlists and scripts (hls, dash, concat, …) are left out: they read other files than the one that was named, or
/// play on without end.
const DEMUXERS: &str = "aac,ac3,aiff,amr,ape,asf,au,av1,avi,caf,dv,eac3,flac,flv,gif,gxf,h261,h263,h264,hevc,ivf,m4v,matroska,webm,mjpeg,mov,mp4,m4a,3gp,3g2,mj2,mp3,mpeg,mpegts,\
mpegvideo,mxf,nut,obu,ogg,rawvideo,rm,tta,vc1,voc,w64,wav,wtv,wv,yuv4mpegpipe";

/// The file at `path` as ffmpeg's input, by a name that is neither an option nor a protocol, and nothing else that it speaks of.
fn named_alone(path: &Path) -> [std::ffi::OsString; 6] {
    let mut name = std::ffi::OsString::from("file:");
    name.push(path);
    [
        "-protocol_whitelist".into(),
        "file,pipe".into(),
        "-format_whitelist".into(),
        DEMUXERS.into(),
        "-i".into(),
        name,
    ]
}

fn not_started(program: &'static str, source: io::Error) -> VideoError {
    match source.kind() {
        io::ErrorKind::NotFound => VideoError::NoProgram(program),
        _ => VideoError::NotStarted { program, source },
    }
}

fn last_line(text: &[u8]) -> String {
    let text = String::from_utf8_lossy(text);
    text.lines()
        .rfind(|l| !l.trim().is_empty())
        .unwrap_or("it gave no reason")
        .trim()
        .to_owned()
}

#[cfg(test)]
mod tests;
