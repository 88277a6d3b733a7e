//! Video formats other than MP4, through the `ffmpeg` program.
use std::ffi::OsString;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result, anyhow, bail};
use ndarray::ArrayView2;

use super::{Painter, Settings, pictures_for};
use crate::mouth::MouthSpace;
use lipstream_media::sound;

/// Like [`super::to_mp4`], for whatever format `ffmpeg` makes of the ending of `path`. Returns the pictures drawn.
pub fn write(
    path: &Path,
    space: &MouthSpace,
    tracks: ArrayView2<f32>,
    sound: Option<&[i16]>,
    settings: &Settings,
    mut progress: impl FnMut(usize, usize),
) -> Result<usize> {
    let pictures = pictures_for(space, tracks, sound, settings)?;
    let mut painter = Painter::new(space, settings)?;
    let (width, height) = painter.size();
    let ending = path
        .extension()
        .ok_or_else(|| anyhow!("{} has no ending: write .mp4, .webm, .gif …", path.display()))?;
    let gif = ending.eq_ignore_ascii_case("gif");

    let parent = path
        .parent()
        .filter(|p| !p.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    std::fs::create_dir_all(parent).with_context(|| format!("cannot make folder {}", parent.display()))?;
    let aside = tempfile::Builder::new()
        .prefix(".lipstream-")
        .tempdir_in(parent)
        .with_context(|| format!("cannot write in {}", parent.display()))?;
    let mut name = OsString::from("video.");
    name.push(ending);
    let unfinished = aside.path().join(name);

    let mut ffmpeg = Command::new("ffmpeg");
    ffmpeg.args(["-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]);
    ffmpeg.args([
        "-s",
        &format!("{width}x{height}"),
        "-r",
        &settings.fps.to_string(),
    ]);
    ffmpeg.args(["-i", "-"]);
    if let Some(samples) = sound.filter(|_| !gif) {
        let wav = aside.path().join("sound.wav");
        sound::write(&wav, samples)?;
        ffmpeg.arg("-i").arg(wav);
    }
    if gif {
        ffmpeg.args([
            "-vf",
            "split[a][b];[a]palettegen[p];[b][p]paletteuse=dither=bayer",
        ]);
    }
    ffmpeg
        .arg(&unfinished)
        .stdin(Stdio::piped())
        .stderr(Stdio::piped());
    let mut running = ffmpeg.spawn().map_err(|e| {
        anyhow!(
            "cannot run ffmpeg ({e}), which every format but .mp4 needs: install it (Debian: apt install ffmpeg) \
             or write .mp4"
        )
    })?;
    let mut stdin = running.stdin.take().expect("stdin is a pipe");
    let mut broken = None;
    for (n, weights) in pictures.outer_iter().enumerate() {
        if let Err(error) = stdin.write_all(&painter.paint(weights)?) {
            broken = Some(error);
            break;
        }
        progress(n + 1, pictures.nrows());
    }
    drop(stdin);
    let ended = running.wait_with_output().context("ffmpeg did not end")?;
    if !ended.status.success() || broken.is_some() {
        let said = String::from_utf8_lossy(&ended.stderr);
        bail!(
            "ffmpeg cannot write {}: {}",
            path.display(),
            said.lines().last().unwrap_or("it ended without a word")
        );
    }
    std::fs::rename(&unfinished, path).with_context(|| format!("cannot write {}", path.display()))?;
    Ok(pictures.nrows())
}
