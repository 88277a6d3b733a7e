//! `lipstream features` as a user meets it: the two file formats, the two engines, both normalisations, bad input.
mod common;

use std::path::Path;

use common::program::{refuse, run, succeed};
use lipstream::{htk, reference};
use lipstream_core::frontend::{Config, FrontEnd};
use lipstream_core::{N_OBSERVATION, N_STATIC};
use lipstream_make::features::FeatureFolder;
use lipstream_media::sound;
use ndarray::Array2;

fn hello() -> String {
    let path = common::root().join("data/hello.wav");
    path.to_str().expect("an ordinary name").to_owned()
}

fn npy(path: &Path) -> Array2<f32> {
    ndarray_npy::read_npy(path).expect("an .npy file of f32")
}

/// Runs `lipstream features hello.wav -o out.npy` with more words; gives what is in the file.
fn features(folder: &Path, words: &[&str]) -> Array2<f32> {
    let hello = hello();
    let said = succeed(folder, &[&["features", &hello, "-o", "out.npy"], words].concat());
    let array = npy(&folder.join("out.npy"));
    assert_eq!(said, format!("out.npy: {} frames\n", array.nrows()));
    array
}

/// What `core` computes of hello.wav, pushed 100 samples at a time: rows of Q7.8.
fn core_observations(config: Config) -> Array2<f32> {
    let mut frontend = FrontEnd::new(config);
    let mut numbers = Vec::new();
    for piece in common::hello().chunks(100) {
        let mut rest = piece;
        while !rest.is_empty() {
            let (taken, hop) = frontend.push(rest);
            rest = &rest[taken..];
            numbers.extend(hop.and_then(|hop| hop.observation).into_iter().flatten());
        }
    }
    while let Some(hop) = frontend.finish() {
        numbers.extend(hop.observation.into_iter().flatten());
    }
    let frames = numbers.len() / N_OBSERVATION;
    let numbers = numbers.into_iter().map(|n| f32::from(n) / 256.0).collect();
    Array2::from_shape_vec((frames, N_OBSERVATION), numbers).unwrap()
}

/// The HTK file, read byte by byte: kind MFCC_E_D_A, 10 ms, 156 bytes a frame, big-endian; the numbers of the .npy.
#[test]
fn htk_and_npy_files_hold_the_same_numbers() {
    let folder = common::folder("features-formats");
    let hello = hello();
    for engine in ["float", "fixed"] {
        succeed(
            &folder,
            &["features", &hello, "-o", "out.htk", "--engine", engine],
        );
        let array = features(&folder, &["--engine", engine]);
        let bytes = std::fs::read(folder.join("out.htk")).unwrap();
        let frames = (common::hello().len() - 400) / 160 + 1;
        assert_eq!(array.dim(), (frames, 39));
        assert_eq!(bytes[0..4], (frames as u32).to_be_bytes());
        assert_eq!(bytes[4..8], 100_000u32.to_be_bytes(), "the period in 100 ns");
        assert_eq!(bytes[8..10], 156u16.to_be_bytes(), "the bytes of a frame");
        // MFCC 6, _E 0o100, _D 0o400, _A 0o1000.
        assert_eq!(bytes[10..12], [0x03, 0x46], "the kind");
        let numbers: Vec<f32> = bytes[12..]
            .chunks(4)
            .map(|b| f32::from_be_bytes(b.try_into().unwrap()))
            .collect();
        assert!(numbers.iter().eq(array.iter()), "{engine}");
        assert_eq!(htk::read(&folder.join("out.htk")).unwrap(), array);
    }
}

#[test]
fn the_float_engine_writes_the_reference_and_is_the_default() {
    let folder = common::folder("features-float");
    let want = reference::observations(&common::hello(), reference::Normalisation::None);
    for words in [&[][..], &["--engine", "float"], &["--norm", "none"]] {
        assert_eq!(features(&folder, words), want, "{words:?}");
    }
}

#[test]
fn the_fixed_engine_writes_what_core_computes() {
    let folder = common::folder("features-fixed");
    let raw = Config {
        start_mean: [0; N_STATIC],
        normalise: false,
    };
    let got = features(&folder, &["--engine", "fixed"]);
    assert_eq!(got, core_observations(raw));
    // In the same units as the float engine: within what the accuracy tests allow.
    let float = features(&folder, &[]);
    let worst = (&got - &float).iter().fold(0f32, |worst, d| worst.max(d.abs()));
    assert!(worst < 0.2, "{worst}");
}

/// Causal normalisation through the program is that of `prepare`'s folders in floats and that of `core` in integers.
#[test]
fn causal_normalisation_is_the_same_in_training_and_on_the_device() {
    let folder = common::folder("features-causal");
    std::fs::create_dir(folder.join("corpus")).unwrap();
    std::fs::copy(hello(), folder.join("corpus/hello.wav")).unwrap();
    succeed(&folder, &["prepare", "corpus", "-o", "prepared", "--audio-only"]);
    let prepared = FeatureFolder::open(&folder.join("prepared")).unwrap();
    let id = &prepared.manifest.clips[0].id;
    let trained_on = npy(&folder.join(format!("prepared/audio/{id}.npy")));

    let causal = ["--norm", "causal", "--start", "prepared"];
    let float = features(&folder, &causal);
    assert!(float == trained_on, "training hears other features than the host");

    let start_mean: Vec<i16> = prepared
        .manifest
        .start_mean
        .iter()
        .map(|m| (m * 256.0).round() as i16)
        .collect();
    let fixed = features(&folder, &[&causal[..], &["--engine", "fixed"]].concat());
    let device = Config {
        start_mean: start_mean.try_into().unwrap(),
        normalise: true,
    };
    assert_eq!(fixed, core_observations(device));

    // It is another thing than no normalisation; Δ and ΔΔ do not know the mean.
    let raw = reference::live_statics(&common::hello());
    let delta = reference::deltas(raw.view());
    for (normalised, (raw, delta)) in float.outer_iter().zip(raw.outer_iter().zip(delta.outer_iter())) {
        for i in 0..N_STATIC {
            assert!(normalised[i] != raw[i] as f32, "number {i}");
            assert_eq!(
                normalised[N_STATIC + i],
                delta[i] as f32,
                "number {}",
                N_STATIC + i
            );
        }
    }
}

/// Compressed speech gives nearly the features of the speech itself, by content, whatever the file is called.
#[test]
fn compressed_sound_gives_its_features() {
    let folder = common::folder("features-compressed");
    let want = features(&folder, &[]);
    for (name, options) in [
        (
            "hello.flac",
            &["-ar", "48000", "-af", "pan=stereo|c0=1.2*c0|c1=0.8*c0"][..],
        ),
        ("hello.ogg", &["-c:a", "libvorbis", "-q:a", "8"]),
        ("hello.mp3", &["-ar", "48000", "-b:a", "192k"]),
    ] {
        let encoder = std::process::Command::new("ffmpeg")
            .current_dir(&folder)
            .args(["-nostdin", "-y", "-v", "error", "-i", &hello()])
            .args(options)
            .arg(name)
            .status();
        assert!(encoder.expect("ffmpeg").success(), "{name}");
        std::fs::rename(folder.join(name), folder.join("sound")).unwrap();
        succeed(&folder, &["features", "sound", "-o", "sound.npy"]);
        let got = npy(&folder.join("sound.npy"));
        assert_eq!(got.dim(), want.dim(), "{name}");
        // The energy of frames above 40 dB below the loudest, in nats; coding changes what is quieter.
        let loudest = want.column(12).fold(0f32, |a, &e| a.max(e));
        let mut worst = 0f32;
        for (got, want) in got.column(12).iter().zip(want.column(12)) {
            if *want > loudest - 9.2 {
                worst = worst.max((got - want).abs());
            }
        }
        println!("{name}: energy off by {worst:.3} at most");
        assert!(worst < 0.3, "{name}: energy off by {worst}");
    }
}

/// What is wrong is said in one line that names the file; the exit code is 1; nothing is written.
#[test]
fn bad_input_gets_one_line() {
    let folder = common::folder("features-bad");
    let good = std::fs::read(hello()).unwrap();
    assert_eq!(good[36..40], *b"data");
    let patched = |at: usize, bytes: &[u8]| {
        let mut wav = good.clone();
        wav[at..at + bytes.len()].copy_from_slice(bytes);
        wav
    };
    // 32-bit floats: tag 3, 64000 bytes a second, blocks of 4.
    let mut nan = patched(20, &[3, 0, 1, 0, 0x80, 0x3e, 0, 0, 0, 0xfa, 0, 0, 4, 0, 32, 0]);
    nan[44..48].copy_from_slice(&f32::NAN.to_le_bytes());
    let cases: [(&str, Vec<u8>, &str); 10] = [
        ("empty", vec![], "the file is empty"),
        (
            "words",
            b"Not a sound, these are words.".to_vec(),
            "not a sound file of a kind that is read here",
        ),
        ("cut", good[..good.len() / 2].to_vec(), "cut short"),
        ("cut-in-header", good[..30].to_vec(), "cut short"),
        ("nan", nan, "sample 0 is not a finite number"),
        ("long-data", patched(40, &[0xfe; 4]), "promises 4278124286 bytes"),
        ("short-data", patched(40, &[2, 0, 0, 0]), "at byte 46"),
        ("no-channels", patched(22, &[0, 0]), "zero channels"),
        (
            "slow",
            patched(24, &[0x40, 0x0f, 0, 0, 0x80, 0x1e, 0, 0]),
            "from 8000 to 192000 Hz",
        ),
        ("cut-flac", b"fLaC\0\0\0\x22".to_vec(), "FLAC"),
    ];
    for (name, bytes, words) in cases {
        std::fs::write(folder.join(name), bytes).unwrap();
        let error = refuse(&folder, &["features", name, "-o", "out.htk"]);
        println!("{error}");
        assert!(error.contains(words), "{name}: {error}");
        assert!(error.contains(name), "{error}");
    }
    // 24.9 ms: shorter than a window.
    sound::write(&folder.join("short.wav"), &[100; 399]).unwrap();
    let error = refuse(&folder, &["features", "short.wav", "-o", "out.htk"]);
    assert!(error.contains("short.wav") && error.contains("25 ms"), "{error}");
    // Wrong words.
    let hello = hello();
    let error = refuse(&folder, &["features", &hello, "-o", "out.txt"]);
    assert!(error.contains(".htk or .npy"), "{error}");
    let error = refuse(
        &folder,
        &[
            "features", &hello, "-o", "out.npy", "--norm", "causal", "--start", ".",
        ],
    );
    assert!(error.contains("no feature folder"), "{error}");
    let causal = run(
        &folder,
        &["features", &hello, "-o", "out.npy", "--norm", "causal"],
    );
    assert_eq!(causal.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&causal.stderr).contains("--start"));
    for name in ["out.htk", "out.npy", "out.txt"] {
        assert!(!folder.join(name).exists(), "{name}");
    }
}
