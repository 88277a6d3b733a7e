//! `lipstream check` through the program, on films of its own making.
use std::path::Path;
use std::process::{Command, Output};

mod common;

use common::program::{run_with_programs, text};

fn ffmpeg(folder: &Path, arguments: &[&str]) {
    let ran = Command::new("ffmpeg")
        .current_dir(folder)
        .args(["-nostdin", "-v", "error", "-y"])
        .args(arguments)
        .status()
        .expect("ffmpeg, which tests/run installs");
    assert!(ran.success());
}

fn check(folder: &Path, arguments: &[&str]) -> Output {
    run_with_programs(folder, &[&["check"], arguments].concat())
}

/// A test picture that speaks: there is no face, which is said, with everything that is heard.
#[test]
fn a_film_without_a_face_is_bad_and_was_checked() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("hello.wav"), lipstream::shipped::SOUND).unwrap();
    let picture = ["-f", "lavfi", "-i", "testsrc=s=320x240:r=25:d=3"];
    let encoded = ["-shortest", "-c:v", "libx264", "-pix_fmt", "yuv420p", "one.mkv"];
    let sound = ["-i", "hello.wav", "-c:a", "pcm_s16le"];
    ffmpeg(folder.path(), &[&picture[..], &sound, &encoded].concat());
    std::fs::write(
        folder.path().join("one.srt"),
        "1\n00:00:00,000 --> 00:00:02,000\nBlue bees\n",
    )
    .unwrap();

    let ran = check(folder.path(), &["one.mkv"]);
    assert!(ran.status.success(), "{}", text(&ran.stderr));
    let words = text(&ran.stdout);
    assert!(
        words.contains("no face is seen") && words.trim_end().ends_with("bad"),
        "{words}"
    );
    assert!(
        words.contains("phones are said") && words.contains("one.srt"),
        "{words}"
    );

    let ran = check(folder.path(), &["--json", "."]);
    assert!(ran.status.success(), "{}", text(&ran.stderr));
    let reports: serde_json::Value = serde_json::from_slice(&ran.stdout).unwrap();
    assert_eq!(reports.as_array().unwrap().len(), 1);
    assert_eq!(reports[0]["overall"], "bad");
    assert_eq!(reports[0]["phones"]["counts"]["b"], 2);
    assert!(reports[0]["light"].is_null() && reports[0]["sync"].is_null());
    assert!(reports[0]["sound"]["speech_dbfs"].as_f64().unwrap() > -40.0);
}

#[test]
fn what_cannot_be_checked_is_said_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    ffmpeg(
        folder.path(),
        &[
            "-f",
            "lavfi",
            "-i",
            "testsrc=s=320x240:r=25:d=1",
            "-pix_fmt",
            "yuv420p",
            "mute.mp4",
        ],
    );
    ffmpeg(
        folder.path(),
        &[
            "-i",
            "mute.mp4",
            "-f",
            "lavfi",
            "-i",
            "anullsrc=r=16000:d=1",
            "still.mkv",
        ],
    );
    for (name, complaint) in [
        ("mute.mp4", "no sound"),
        ("still.mkv", "no speech"),
        ("none.mp4", "no such file"),
    ] {
        let ran = check(folder.path(), &[name]);
        let said = text(&ran.stderr);
        assert_eq!(ran.status.code(), Some(1), "{said}");
        let last = said.lines().last().unwrap();
        assert!(
            last.starts_with("lipstream: ") && last.contains(complaint),
            "{said}"
        );
        assert!(ran.stdout.is_empty());
    }
}

/// An offset said by hand moves the sound and the times of its labels, and another one moves them anew.
#[test]
fn a_given_offset_moves_sound_and_labels() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    std::fs::create_dir(root.join("clips")).unwrap();
    std::fs::write(root.join("hello.wav"), lipstream::shipped::SOUND).unwrap();
    let film = [
        "-f",
        "lavfi",
        "-i",
        "testsrc=s=160x120:r=25:d=3",
        "-i",
        "hello.wav",
    ];
    ffmpeg(
        root,
        &[
            &film[..],
            &["-c:v", "mpeg4", "-c:a", "pcm_s16le", "clips/one.mkv"],
        ]
        .concat(),
    );
    std::fs::write(
        root.join("clips/one.lab"),
        "0 5000000 sil\n5000000 7000000 b\n7000000 42000000 sil\n",
    )
    .unwrap();
    let prepared = |offset: &str| {
        let ran = Command::new(env!("CARGO_BIN_EXE_lipstream"))
            .current_dir(root)
            .args([
                "prepare",
                "clips",
                "-o",
                "features",
                "--audio-only",
                "--sync-offset",
                offset,
            ])
            .output()
            .unwrap();
        assert!(ran.status.success(), "{}", text(&ran.stderr));
        let features = lipstream_make::features::FeatureFolder::open(&root.join("features")).unwrap();
        let begins = features.manifest.clips[0].phones[1].start;
        let sound = lipstream_media::sound::read(&features.wav_path("one")).unwrap();
        (sound.samples, begins)
    };
    let (own, begins) = prepared("0");
    assert_eq!(begins, 0.5);
    let (late, begins) = prepared("100");
    assert!((begins - 0.4).abs() < 1e-6);
    assert_eq!(late[..late.len() - 1600], own[1600..]);
    let (early, begins) = prepared("-100");
    assert!((begins - 0.6).abs() < 1e-6);
    assert_eq!(early[1600..], own[..own.len() - 1600]);
}
