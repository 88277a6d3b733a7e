//! What the tests of sound and video files share.
#![allow(dead_code, reason = "each test program uses its part")]
use std::path::Path;
use std::process::Command;

use lipstream_media::sound;

/// Runs ffmpeg in a folder; it must succeed.
pub(crate) fn ffmpeg(folder: &Path, arguments: &[&str]) {
    let output = Command::new("ffmpeg")
        .current_dir(folder)
        .args(["-nostdin", "-y", "-v", "error"])
        .args(arguments)
        .output()
        .expect("ffmpeg");
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "ffmpeg {arguments:?}: {error}");
}

/// The error of bytes that must be refused: one line.
pub(crate) fn refused(name: &str, bytes: &[u8]) -> String {
    let error = match sound::decode(bytes) {
        Ok(sound) => panic!("{name}: read as {} samples", sound.samples.len()),
        Err(error) => format!("{:#}", anyhow::Error::from(error)),
    };
    assert!(!error.contains('\n') && error.len() > 10, "{name}: {error:?}");
    error
}
