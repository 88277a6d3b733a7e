//! Videos as phones and the web have them, made by ffmpeg and decoded here: their size, their pictures, their colours.
use std::path::{Path, PathBuf};

mod common;

use common::ffmpeg;
use lipstream_media::video::{self, Frames, MAX_LINES};

/// A second of a picture whose upper half is red and whose lower half is blue, after these words.
fn made(folder: &Path, name: &str, size: &str, rate: &str, options: &[&str]) -> PathBuf {
    let path = folder.join(name);
    let half = |colour: &str| {
        let (width, height) = size.split_once('x').unwrap();
        let height: usize = height.parse().unwrap();
        format!("color=c={colour}:s={width}x{}:r={rate}:d=1", height / 2)
    };
    let colours = [half("red"), half("blue")];
    let input = [
        "-f",
        "lavfi",
        "-i",
        &colours[0],
        "-f",
        "lavfi",
        "-i",
        &colours[1],
        "-filter_complex",
        "[0][1]vstack",
    ];
    ffmpeg(folder, &[&input[..], options, &[name]].concat());
    path
}

/// The colour in the middle of a part of the picture, given in sixteenths of its sides.
fn colour(frames: &Frames, x: usize, y: usize) -> [u8; 3] {
    let middle = frames.frame(frames.len() / 2);
    let at = (y * frames.height / 16 * frames.width + x * frames.width / 16) * 3;
    [middle[at], middle[at + 1], middle[at + 2]]
}

fn is_red([r, g, b]: [u8; 3]) -> bool {
    r > 200 && g < 60 && b < 60
}

fn is_blue([r, g, b]: [u8; 3]) -> bool {
    b > 200 && r < 60 && g < 60
}

#[test]
fn every_codec_and_depth_becomes_eight_bits() {
    let folder = tempfile::tempdir().unwrap();
    let kinds: [(&str, &[&str]); 5] = [
        (
            "hevc10.mp4",
            &[
                "-c:v",
                "libx265",
                "-x265-params",
                "log-level=error",
                "-pix_fmt",
                "yuv420p10le",
            ],
        ),
        ("h264.mp4", &["-c:v", "libx264", "-pix_fmt", "yuv420p"]),
        ("h264-10.mkv", &["-c:v", "libx264", "-pix_fmt", "yuv422p10le"]),
        ("vp9.webm", &["-c:v", "libvpx-vp9"]),
        ("av1.mkv", &["-c:v", "libaom-av1", "-cpu-used", "8"]),
    ];
    for (name, options) in kinds {
        let frames = video::decode(&made(folder.path(), name, "320x240", "30", options)).unwrap();
        assert_eq!(
            (frames.width, frames.height, frames.len()),
            (320, 240, 30),
            "{name}"
        );
        assert_eq!(frames.rgb.len(), 320 * 240 * 3 * 30);
        assert!(
            is_red(colour(&frames, 8, 2)) && is_blue(colour(&frames, 8, 14)),
            "{name}"
        );
    }
}

#[test]
fn phones_films_stand_upright_and_keep_their_detail() {
    let folder = tempfile::tempdir().unwrap();
    // Filmed lying, to be turned by a quarter.
    made(
        folder.path(),
        "lying.mp4",
        "640x360",
        "30",
        &["-c:v", "libx264", "-pix_fmt", "yuv420p"],
    );
    let turned = folder.path().join("turned.mp4");
    ffmpeg(
        folder.path(),
        &[
            "-i",
            "lying.mp4",
            "-c",
            "copy",
            "-metadata:s:v:0",
            "rotate=90",
            "turned.mp4",
        ],
    );
    let frames = video::decode(&turned).unwrap();
    if (frames.width, frames.height) != (640, 360) {
        // From ffmpeg 7 on the old word for turning is not written any more.
        assert_eq!((frames.width, frames.height), (360, 640));
        let (left, right) = (colour(&frames, 2, 8), colour(&frames, 14, 8));
        assert!(is_red(left) && is_blue(right) || is_blue(left) && is_red(right));
    }
    // The shorter side is what is limited: a standing picture is not made three times smaller than a lying one.
    for (size, want, reduction) in [
        ("1080x1920", (576, 1024), 1.875),
        ("1920x1080", (1024, 576), 1.875),
        ("576x1024", (576, 1024), 1.0),
        ("360x288", (360, 288), 1.0),
    ] {
        let path = made(
            folder.path(),
            &format!("{size}.mp4"),
            size,
            "30",
            &["-c:v", "libx264", "-preset", "ultrafast", "-pix_fmt", "yuv420p"],
        );
        let frames = video::decode(&path).unwrap();
        assert_eq!((frames.width, frames.height), want, "{size}");
        assert!(frames.width.min(frames.height) <= MAX_LINES);
        let facts = video::facts(&path).unwrap();
        assert_eq!((facts.rate_hz, facts.reduction), (30.0, reduction), "{size}");
    }
}

#[test]
fn any_rate_is_kept_and_a_changing_one_made_even() {
    let folder = tempfile::tempdir().unwrap();
    let h264 = ["-c:v", "libx264", "-pix_fmt", "yuv420p"];
    for (rate, hz, count) in [("24000/1001", 23.976, 24), ("25", 25.0, 25), ("60", 60.0, 60)] {
        let frames = video::decode(&made(folder.path(), "rate.mp4", "160x120", rate, &h264)).unwrap();
        assert!(
            (frames.rate_hz - hz).abs() < 0.01 && frames.len().abs_diff(count) <= 1,
            "{rate}: {}",
            frames.len()
        );
    }
    // Half of the pictures of the second half are missing, as phones do in bad light.
    let uneven = folder.path().join("uneven.mkv");
    let input = [
        "-f",
        "lavfi",
        "-i",
        "testsrc=s=160x120:r=30:d=2",
        "-vf",
        "select='lt(t,1)+mod(n,2)'",
        "-vsync",
        "vfr",
    ];
    ffmpeg(folder.path(), &[&input[..], &h264, &["uneven.mkv"]].concat());
    let frames = video::decode(&uneven).unwrap();
    let seconds = frames.len() as f32 / frames.rate_hz;
    assert!(
        (seconds - 2.0).abs() < 0.1,
        "{} pictures at {} Hz",
        frames.len(),
        frames.rate_hz
    );
}

/// A playlist names other files, and a live one goes on without end: neither is a film that was named, whatever it is called.
#[test]
fn playlists_and_pipes_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    made(folder.path(), "film.ts", "64x64", "25", &["-c:v", "mpeg2video"]);
    assert_eq!(video::decode(&folder.path().join("film.ts")).unwrap().width, 64);
    for (name, text) in [
        (
            "list.m3u8",
            "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nfilm.ts\n",
        ),
        (
            "list.mp4",
            "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nfilm.ts\n#EXT-X-ENDLIST\n",
        ),
        ("list.ffconcat", "ffconcat version 1.0\nfile film.ts\n"),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        let error = video::decode(&path).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains(name) && error.contains("cannot"), "{error}");
        let error = video::decode_sound(&path).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains(name), "{error}");
    }
    #[cfg(unix)]
    {
        let pipe = folder.path().join("pipe.mp4");
        assert!(
            std::process::Command::new("mkfifo")
                .arg(&pipe)
                .status()
                .unwrap()
                .success()
        );
        for said in [
            video::decode(&pipe).map(|_| ()),
            video::decode_sound(&pipe).map(|_| ()),
        ] {
            assert!(said.unwrap_err().to_string().contains("pipe.mp4"));
        }
    }
}
