//! `check` on real videos whose sound is moved by known times, or is another's. Needs LIPSTREAM_RESEARCH and `ffmpeg`.
use std::path::{Path, PathBuf};
use std::process::Command;

use lipstream_make::check::{CheckSettings, Report, check};

mod common;

use common::{data, videos};

fn ffmpeg(arguments: &[&str]) {
    let ran = Command::new("ffmpeg")
        .args(["-nostdin", "-v", "error", "-y"])
        .args(arguments)
        .status()
        .expect("ffmpeg");
    assert!(ran.success(), "{arguments:?}");
}

fn word(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// One take of several GRID clips, each of exactly three seconds, with the sound of others where `sound` says so.
fn take(to: &Path, pictures: &[PathBuf], sound: &[PathBuf]) {
    let folder = tempfile::tempdir().unwrap();
    let mut list = String::new();
    for (n, (picture, sound)) in pictures.iter().zip(sound).enumerate() {
        let clip = folder.path().join(format!("{n}.mkv"));
        let of = [
            "-i",
            word(picture),
            "-i",
            word(sound),
            "-map",
            "0:v:0",
            "-map",
            "1:a:0",
        ];
        let even = [
            "-vf",
            "fps=25:start_time=0,tpad=stop_mode=clone:stop=5",
            "-af",
            "aresample=async=1:first_pts=0,apad",
            "-t",
            "3",
        ];
        let coded = [
            "-c:v",
            "libx264",
            "-preset",
            "veryfast",
            "-crf",
            "14",
            "-c:a",
            "pcm_s16le",
        ];
        ffmpeg(&[&of[..], &even, &coded, &[word(&clip)]].concat());
        list += &format!("file '{}'\n", clip.display());
    }
    let names = folder.path().join("list");
    std::fs::write(&names, list).unwrap();
    ffmpeg(&[
        "-f",
        "concat",
        "-safe",
        "0",
        "-i",
        word(&names),
        "-c",
        "copy",
        word(to),
    ]);
}

/// The same video with its sound later by so many milliseconds.
fn later(from: &Path, to: &Path, ms: i32) {
    let filter = match ms {
        ms if ms >= 0 => format!("adelay={ms}:all=1"),
        ms => format!("atrim=start={},asetpts=PTS-STARTPTS", f64::from(-ms) / 1000.0),
    };
    let of = ["-i", word(from), "-map", "0:v:0", "-map", "0:a:0", "-c:v", "copy"];
    ffmpeg(&[&of[..], &["-af", &filter, "-c:a", "pcm_s16le", word(to)]].concat());
}

fn checked(path: &Path) -> Report {
    check(path, &CheckSettings::default(), &()).unwrap()
}

/// Median and 95th percentile of absolute errors.
fn errors(mut errors: Vec<f32>) -> (f32, f32) {
    errors.iter_mut().for_each(|e| *e = e.abs());
    errors.sort_by(f32::total_cmp);
    (
        errors[errors.len() / 2],
        errors[(errors.len() * 19 / 20).min(errors.len() - 1)],
    )
}

const OFFSETS_MS: [i32; 5] = [-200, -80, 0, 120, 200];

/// Prints and gives the errors of offsets that were made, over takes, less `own` (what the takes' unmoved sound is off by).
fn measured(what: &str, takes: &[PathBuf], own: &[f32]) -> (f32, f32) {
    let folder = tempfile::tempdir().unwrap();
    let moved = folder.path().join("moved.mkv");
    let (mut off, mut sure, mut wrong) = (Vec::new(), 0, 0);
    for (n, path) in takes.iter().enumerate() {
        let ms = OFFSETS_MS[n % OFFSETS_MS.len()];
        later(path, &moved, ms);
        let Some(sync) = checked(&moved).sync else {
            continue;
        };
        let error = sync.offset_ms - ms as f32 - own.get(n).copied().unwrap_or(0.0);
        if sync.is_sure() {
            sure += 1;
            wrong += usize::from(error.abs() > 40.0);
        }
        off.push(error);
    }
    let count = off.len();
    let (median, most) = errors(off);
    println!(
        "{what}: {count} takes, error {median:.0} ms, 95 % {most:.0} ms; sure {sure}, of them wrong by more than 40 ms {wrong}"
    );
    assert_eq!(wrong, 0, "{what}: a sure offset is wrong");
    (median, most)
}

/// At most so many takes of `clips` GRID test clips each.
fn grid_takes(folder: &Path, clips: usize, most: usize) -> Vec<PathBuf> {
    let all = videos(&data().join("grid-s1/test"));
    all.chunks_exact(clips)
        .take(most)
        .enumerate()
        .map(|(n, some)| {
            let path = folder.join(format!("take{clips}-{n}.mkv"));
            take(&path, some, some);
            path
        })
        .collect()
}

#[test]
#[ignore = "needs the research data: tests/run --research"]
fn offsets_that_were_made_are_found() {
    let folder = tempfile::tempdir().unwrap();
    // Of a single clip the offset is far off now and then, and never sure.
    let bounds = [(1, 8, 18.0, f32::INFINITY), (5, 3, 8.0, 16.0), (20, 1, 8.0, 12.0)];
    for (clips, takes, median, most) in bounds {
        let takes = grid_takes(folder.path(), clips, takes);
        let found = measured(&format!("GRID talker 1, {} s", 3 * clips), &takes, &[]);
        assert!(found.0 < median && found.1 < most, "{found:?}");
    }
    let mut others: Vec<PathBuf> = videos(&data().join("grid-others"));
    others.truncate(6);
    let found = measured("other GRID talkers, 3 s", &others, &[]);
    assert!(found.0 < 30.0, "{found:?}");
}

#[test]
#[ignore = "needs the research data: tests/run --research"]
fn free_speech_and_news_move_with_their_sound() {
    for (what, folder, most) in [
        ("free speech", "free-speech", 5),
        ("newsreaders", "newsreaders", 10),
    ] {
        let mut takes = videos(&data().join(folder));
        takes.truncate(most);
        // Nobody knows how far their own sound is off: the error is against what is found of them unmoved.
        let own: Vec<f32> = takes
            .iter()
            .map(|path| checked(path).sync.map_or(0.0, |sync| sync.offset_ms))
            .collect();
        measured(what, &takes, &own);
    }
}

#[test]
#[ignore = "needs the research data: tests/run --research"]
fn the_sound_of_other_clips_is_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let all = videos(&data().join("grid-s1/test"));
    let mut turned = all.clone();
    turned.rotate_left(7);
    let (mut real, mut wrong) = (Vec::new(), Vec::new());
    for (own, other) in all.chunks_exact(5).zip(turned.chunks_exact(5)).take(3) {
        for (sound, to) in [(own, &mut real), (other, &mut wrong)] {
            let path = folder.path().join("take.mkv");
            take(&path, own, sound);
            to.push(checked(&path).sync.and_then(|sync| sync.above_chance).unwrap());
        }
    }
    println!("15 s: own sound {real:.1?}, another's {wrong:.1?} times chance");
    assert!(real.iter().all(|above| *above >= 3.0), "{real:?}");
    assert!(wrong.iter().all(|above| *above < 3.0), "{wrong:?}");
}
