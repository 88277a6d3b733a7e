//! `lipstream render` as it is called: what it writes, and what it says to input that it cannot use.
mod common;

use std::ffi::OsString;
use std::path::Path;

use lipstream::mouth::MouthSpace;
use lipstream::render::drawn;
use lipstream::tensors::TensorsBuilder;
use ndarray::{Array2, array};
use ndarray_npy::WriteNpyExt as _;

/// A folder with a drawn mouth, parameters for it and a sound.
struct Desk {
    folder: tempfile::TempDir,
    space: MouthSpace,
}

impl Desk {
    fn new() -> Self {
        let desk = Desk {
            folder: tempfile::tempdir().unwrap(),
            space: drawn::space(8),
        };
        let mut out = TensorsBuilder::default();
        desk.space.store(&mut out);
        out.write(&desk.path("mouth.safetensors")).unwrap();
        desk.parameters("p.npy", &drawn::babble(&desk.space, 98));
        let spec = hound::WavSpec {
            channels: 1,
            sample_rate: 16_000,
            bits_per_sample: 16,
            sample_format: hound::SampleFormat::Int,
        };
        let mut wav = hound::WavWriter::create(desk.path("s.wav"), spec).unwrap();
        for i in 0..16_000 {
            wav.write_sample(((i as f32 * 0.2).sin() * 3000.0) as i16)
                .unwrap();
        }
        wav.finalize().unwrap();
        desk
    }

    fn path(&self, name: &str) -> std::path::PathBuf {
        self.folder.path().join(name)
    }

    fn parameters(&self, name: &str, tracks: &Array2<f32>) {
        let file = std::fs::File::create(self.path(name)).unwrap();
        tracks.write_npy(file).unwrap();
    }

    /// Runs `lipstream render`; words with a dot are files of this folder.
    fn render(&self, words: &[&str]) -> Result<(), String> {
        let mut all: Vec<OsString> = vec!["lipstream".into(), "render".into()];
        for word in words {
            all.push(if word.contains('.') {
                self.path(word).into()
            } else {
                word.into()
            });
        }
        lipstream_cli::run(all).map_err(|e| format!("{e:#}"))
    }

    /// One line that holds `part`; nothing was written.
    fn refuses(&self, words: &[&str], part: &str) {
        let line = self.render(words).expect_err("this cannot be drawn");
        assert!(line.contains(part) && !line.contains('\n'), "{line}");
        assert!(!self.path("o.mp4").exists() && !self.path("o.html").exists());
    }
}

/// Boxes of the movie header's tracks.
fn n_tracks(path: &Path) -> usize {
    let bytes = std::fs::read(path).unwrap();
    bytes.windows(4).filter(|w| w == b"trak").count()
}

#[test]
fn parameters_become_a_video() {
    let desk = Desk::new();
    desk.render(&[
        "p.npy",
        "-m",
        "mouth.safetensors",
        "-o",
        "silent.mp4",
        "--scale",
        "1",
    ])
    .unwrap();
    assert_eq!(n_tracks(&desk.path("silent.mp4")), 1);
    desk.render(&[
        "p.npy",
        "-m",
        "mouth.safetensors",
        "-o",
        "o.mp4",
        "--audio",
        "s.wav",
        "--fps",
        "50",
    ])
    .unwrap();
    assert_eq!(n_tracks(&desk.path("o.mp4")), 2);
}

#[test]
fn the_same_input_gives_the_same_bytes() {
    let desk = Desk::new();
    for name in ["a.mp4", "b.mp4"] {
        desk.render(&["p.npy", "-m", "mouth.safetensors", "-o", name, "--noise", "2"])
            .unwrap();
    }
    let read = |name| std::fs::read(desk.path(name)).unwrap();
    assert_eq!(read("a.mp4"), read("b.mp4"));
}

/// Whoever looks at a file can tell that nobody was filmed.
#[test]
fn films_say_that_they_are_synthetic() {
    let desk = Desk::new();
    for name in ["o.mp4", "sound.mp4", "o.mkv"] {
        let mut words = vec!["p.npy", "-m", "mouth.safetensors", "-o", name, "--scale", "1"];
        if name == "sound.mp4" {
            words.extend(["--audio", "s.wav"]);
        }
        desk.render(&words).unwrap();
        let said = std::process::Command::new("ffprobe")
            .args(["-v", "error", "-show_format"])
            .arg(desk.path(name))
            .output()
            .expect("run ffprobe, which comes with ffmpeg");
        let said = String::from_utf8(said.stdout).unwrap().to_lowercase();
        let want = format!("tag:comment={}", lipstream::render::SYNTHETIC.to_lowercase());
        assert!(said.contains(&want), "{name}: {said}");
    }
}

#[test]
fn parameters_of_another_unit_are_warned_of() {
    let desk = Desk::new();
    let usual = drawn::babble(&desk.space, 20);
    desk.parameters("far.npy", &(&usual * 50.0));
    let warnings = |input: &str| {
        let ran = std::process::Command::new(env!("CARGO_BIN_EXE_lipstream"))
            .current_dir(desk.folder.path())
            .args([
                "render",
                input,
                "-m",
                "mouth.safetensors",
                "-o",
                "o.mp4",
                "--scale",
                "1",
            ])
            .output()
            .unwrap();
        assert!(ran.status.success());
        let said = String::from_utf8(ran.stderr).unwrap();
        let lines: Vec<String> = said
            .lines()
            .filter(|l| l.starts_with("warning"))
            .map(str::to_owned)
            .collect();
        lines
    };
    assert!(warnings("p.npy").is_empty());
    let said = warnings("far.npy");
    assert!(
        said.len() == 1 && said[0].contains("far.npy are ") && said[0].contains(" times as large"),
        "{said:?}"
    );
}

#[test]
fn bad_input_gets_one_line() {
    let desk = Desk::new();
    let with = |input: &'static str| [input, "-m", "mouth.safetensors", "-o", "o.mp4"];
    desk.refuses(&with("nothing.npy"), "cannot read");
    desk.refuses(&with("nothing.wav"), "cannot read");
    desk.parameters("empty.npy", &Array2::zeros((0, 8)));
    desk.refuses(&with("empty.npy"), "no frame");
    desk.parameters("wide.npy", &Array2::zeros((10, 9)));
    desk.refuses(&with("wide.npy"), "9 a frame");
    desk.parameters("nan.npy", &array![[0.0, f32::NAN, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]]);
    desk.refuses(&with("nan.npy"), "parameter 1 of frame 0");
    std::fs::write(desk.path("text.npy"), "not an array").unwrap();
    desk.refuses(&with("text.npy"), "text.npy");

    desk.refuses(&["p.npy", "-m", "p.npy", "-o", "o.mp4"], "no safetensors file");
    desk.refuses(
        &[
            "p.npy",
            "-m",
            "mouth.safetensors",
            "-o",
            "o.mp4",
            "--audio",
            "none.wav",
        ],
        "none.wav",
    );
    desk.refuses(
        &["p.npy", "-m", "mouth.safetensors", "-o", "o.html"],
        "give speech",
    );
    desk.refuses(
        &[
            "p.npy",
            "-m",
            "mouth.safetensors",
            "-o",
            "o.mp4",
            "--scale",
            "5000",
        ],
        "smaller scale",
    );
    desk.refuses(
        &["p.npy", "-m", "mouth.safetensors", "-o", "o.mp4", "--fps", "0"],
        "choose 1 to 100",
    );
    // A mouth alone hears nothing.
    desk.refuses(&with("s.wav"), "no usable model");
}

#[test]
fn a_background_without_a_face_gets_one_line() {
    let desk = Desk::new();
    common::program::test_picture(&desk.path("wall.mp4"));
    let with = |background: &'static str, rest: &[&'static str]| {
        let words = [
            "p.npy",
            "-m",
            "mouth.safetensors",
            "-o",
            "o.mp4",
            "--background",
            background,
        ];
        [&words[..], rest].concat()
    };
    desk.refuses(&with("wall.mp4", &[]), "no face found");
    desk.refuses(&with("none.mp4", &[]), "no such file");
    desk.refuses(&with("wall.mp4", &["--scale", "2"]), "size of its background");
    std::fs::write(desk.path("text.mp4"), "no video").unwrap();
    desk.refuses(&with("text.mp4", &[]), "text.mp4");
    desk.refuses(
        &[
            "s.wav",
            "-m",
            "mouth.safetensors",
            "-o",
            "o.html",
            "--background",
            "wall.mp4",
        ],
        "leave --background out",
    );
    // Detail comes from a folder that `prepare` made.
    let folder = [
        "p.npy",
        "-m",
        "mouth.safetensors",
        "-o",
        "o.mp4",
        "--detail-from",
        "wall.mp4",
    ];
    desk.refuses(&folder, "wall.mp4");
}

/// Kills a run in mid-film, and lets another one finish it.
#[test]
#[cfg(unix)]
fn a_killed_film_goes_on_and_is_the_same() {
    let desk = Desk::new();
    desk.parameters("long.npy", &drawn::babble(&desk.space, 6000));
    let words = |output| {
        [
            "render",
            "long.npy",
            "-m",
            "mouth.safetensors",
            "--noise",
            "2",
            "--scale",
            "2",
            "-o",
            output,
        ]
    };
    let part = desk.path("o.mp4.part");
    let mut killed = std::process::Command::new(env!("CARGO_BIN_EXE_lipstream"))
        .current_dir(desk.folder.path())
        .args(words("o.mp4"))
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let size = || std::fs::metadata(&part).map_or(0, |part| part.len());
    // A few seconds of film.
    while size() < 100_000 {
        assert!(killed.try_wait().unwrap().is_none(), "the film was done too soon");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    killed.kill().unwrap();
    killed.wait().unwrap();
    assert!(size() > 0 && !desk.path("o.mp4").exists());
    let run = |output| {
        let done = std::process::Command::new(env!("CARGO_BIN_EXE_lipstream"))
            .current_dir(desk.folder.path())
            .args(words(output))
            .output()
            .unwrap();
        assert!(done.status.success());
        String::from_utf8(done.stderr).unwrap()
    };
    let said = run("o.mp4");
    assert!(said.contains("goes on behind them"), "{said}");
    assert!(!run("whole.mp4").contains("interrupted"));
    let read = |name| std::fs::read(desk.path(name)).unwrap();
    assert!(read("o.mp4") == read("whole.mp4"));
    assert!(!part.exists());
}
