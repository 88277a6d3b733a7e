//! `lipstream prepare` on a small corpus of its own making, through the program.
use std::path::Path;
use std::process::{Command, Output};

use lipstream::reference;
use lipstream_make::features::{FeatureFolder, PhonesFrom, Split};
use lipstream_media::sound;

mod common;

use common::program::{run_with_programs, text};

/// Bursts of a hoarse tone with pauses between them: loud and quiet enough to pass for speech.
fn bursts(seconds: f64, pitch_hz: f64) -> Vec<i16> {
    let mut noise = 1u32;
    (0..(seconds * 16_000.0) as usize)
        .map(|n| {
            let t = n as f64 / 16_000.0;
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let hiss = f64::from(noise >> 16) / 65_536.0 - 0.5;
            let tone: f64 = (1..20)
                .map(|k| (t * pitch_hz * f64::from(k) * std::f64::consts::TAU).sin() / f64::from(k))
                .sum();
            let loud = if (t * 4.0) as u32 % 2 == 1 { 6000.0 } else { 20.0 };
            (loud * (0.5 * tone + hiss)) as i16
        })
        .collect()
}

fn write_wav(path: &Path, samples: &[i16]) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let spec = hound::WavSpec {
        channels: 1,
        sample_rate: 16_000,
        bits_per_sample: 16,
        sample_format: hound::SampleFormat::Int,
    };
    let mut writer = hound::WavWriter::create(path, spec).unwrap();
    samples.iter().for_each(|s| writer.write_sample(*s).unwrap());
    writer.finalize().unwrap();
}

fn corpus(root: &Path) {
    write_wav(&root.join("train/ann/one.wav"), &bursts(1.2, 120.0));
    std::fs::write(
        root.join("train/ann/one.lab"),
        "0 5000000 sil\n5000000 7000000 b\n7000000 9000000 iy\n9000000 12000000 sil\n",
    )
    .unwrap();
    write_wav(&root.join("train/ann/two.wav"), &bursts(1.5, 140.0));
    std::fs::write(root.join("train/ann/two.txt"), "Place 2 blue blorfs, please!").unwrap();
    write_wav(&root.join("train/bob/three.wav"), &bursts(1.1, 90.0));
    std::fs::write(
        root.join("train/bob/three.align"),
        "0 9250 sil\n9250 21500 lay\n21500 25000 a\n",
    )
    .unwrap();
    write_wav(&root.join("test/bob/four.wav"), &bursts(1.0, 95.0));
    std::fs::write(root.join("train/ann/broken.wav"), b"RIFF nonsense").unwrap();
    write_wav(&root.join("train/ann/mislabelled.wav"), &bursts(1.0, 100.0));
    std::fs::write(root.join("train/ann/mislabelled.phn"), "0 8000 h#\n8000 zzz aa\n").unwrap();
    std::fs::write(root.join("notes.md"), "no clip").unwrap();
}

fn run(arguments: &[&str]) -> Output {
    run_with_programs(Path::new("."), &[&["prepare"], arguments].concat())
}

#[test]
fn a_small_corpus_becomes_a_feature_folder() {
    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (folder.path().join("corpus"), folder.path().join("features"));
    corpus(&input);
    let (input_arg, output_arg) = (input.to_str().unwrap(), output.to_str().unwrap());
    let ran = run(&[input_arg, "-o", output_arg, "--json"]);
    assert!(ran.status.success(), "{}", text(&ran.stderr));

    let summary: serde_json::Value = serde_json::from_slice(&ran.stdout).unwrap();
    assert_eq!(summary["train"]["clips"], 3);
    assert_eq!(summary["train"]["speakers"], 2);
    assert_eq!(summary["test"]["clips"], 1);
    assert_eq!(
        (&summary["unlabelled"], &summary["recognised"]),
        (&0.into(), &1.into())
    );
    assert_eq!(summary["words_by_rule"], serde_json::json!(["blorfs"]));
    assert_eq!(summary["skipped"].as_array().unwrap().len(), 2);
    assert_eq!(summary["left_alone"].as_array().unwrap().len(), 1);
    let complaints = text(&ran.stderr);
    assert!(
        complaints.contains("broken.wav") && complaints.contains("mislabelled.phn"),
        "{complaints}"
    );

    let features = FeatureFolder::open(&output).unwrap();
    let ids: Vec<_> = features.manifest.clips.iter().map(|c| c.id.as_str()).collect();
    assert_eq!(ids, ["four", "one", "three", "two"]);
    assert_eq!(features.manifest.skipped.len(), 2);
    let clip = |id: &str| features.manifest.clips.iter().find(|c| c.id == id).unwrap();

    let phones: Vec<_> = clip("one").phones.iter().map(|p| p.phone.as_str()).collect();
    assert_eq!(phones, ["sil", "b", "iy", "sil"]);
    assert_eq!(clip("one").phones[1].start, 0.5);
    let words: Vec<_> = clip("two").words.iter().map(|w| w.text.as_str()).collect();
    assert_eq!(words, ["place", "two", "blue", "blorfs", "please"]);
    assert_eq!(clip("two").words[1].pronunciations[0], ["t", "uw"]);
    assert_eq!(clip("three").words[1].pronunciations, [["ey"]]);
    assert_eq!(clip("three").words[0].time, Some((0.37, 0.86)));
    // Nobody labelled it: what is heard covers it, and the manifest says where it comes from.
    let four = clip("four");
    assert!(four.words.is_empty() && four.phones_from == PhonesFrom::Recognised);
    assert_eq!(
        (four.phones[0].start, four.phones.last().unwrap().end),
        (0.0, 1.0)
    );
    assert!(four.phones.windows(2).all(|p| p[0].end == p[1].start));
    assert!(four.labelled_phones().is_empty());
    assert_eq!(clip("one").phones_from, PhonesFrom::Labels);
    assert_eq!(clip("four").split, Split::Test);
    assert_eq!(clip("four").speaker, "bob");

    // The observations are those of the samples beside them, from the mean over the training clips' speech.
    let wav = |id: &str| sound::read(&features.wav_path(id)).unwrap().samples;
    assert_eq!(wav("one"), bursts(1.2, 120.0));
    let training: Vec<_> = ["one", "three", "two"].map(wav).to_vec();
    let start_mean = reference::speech_mean(&training).unwrap();
    assert_eq!(features.manifest.start_mean, start_mean);
    for clip in &features.manifest.clips {
        let expected =
            reference::observations(&wav(&clip.id), reference::Normalisation::Causal { start_mean });
        assert_eq!(features.audio(clip).unwrap(), expected);
    }
}

/// Where labels only are to count, a clip without has no phones, and is not trained on; a model that cannot be read is said so.
#[test]
fn clips_without_labels_are_heard_or_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (folder.path().join("corpus"), folder.path().join("features"));
    write_wav(&input.join("ann/one.wav"), &bursts(1.2, 120.0));
    std::fs::write(
        input.join("ann/one.lab"),
        "0 5000000 sil\n5000000 7000000 b\n7000000 9000000 iy\n9000000 12000000 sil\n",
    )
    .unwrap();
    write_wav(&input.join("ann/two.wav"), &bursts(1.2, 130.0));
    let (input, out) = (input.to_str().unwrap(), output.to_str().unwrap());
    let ran = run(&[input, "-o", out, "--all-train", "--labels-only", "--json"]);
    assert!(ran.status.success(), "{}", text(&ran.stderr));
    let summary: serde_json::Value = serde_json::from_slice(&ran.stdout).unwrap();
    assert_eq!(
        (&summary["unlabelled"], &summary["recognised"]),
        (&1.into(), &0.into())
    );

    let model = folder.path().join("audio.safetensors");
    let trained = || {
        Command::new(env!("CARGO_BIN_EXE_lipstream"))
            .args([
                "train",
                out,
                "--sound-only",
                "--audio-mixtures",
                "1",
                "--iterations",
                "1",
                "-o",
            ])
            .arg(&model)
            .output()
            .unwrap()
    };
    let said = text(&trained().stderr);
    assert!(
        said.contains("left out: clip two: it has no labels") && said.contains("1 clips"),
        "{said}"
    );

    // The same folder again, now with ears: the second clip is trained on as what is heard in it.
    assert!(run(&[input, "-o", out, "--all-train"]).status.success());
    let said = text(&trained().stderr);
    assert!(!said.contains("left out") && said.contains("2 clips"), "{said}");
    let heard_with = run(&[
        input,
        "-o",
        out,
        "--all-train",
        "--hear-with",
        model.to_str().unwrap(),
    ]);
    assert!(heard_with.status.success(), "{}", text(&heard_with.stderr));
    let missing = run(&[
        input,
        "-o",
        out,
        "--all-train",
        "--hear-with",
        "no-such.safetensors",
    ]);
    assert!(!missing.status.success() || text(&missing.stderr).contains("no-such.safetensors"));
}

#[test]
fn an_interrupted_run_continues() {
    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (folder.path().join("corpus"), folder.path().join("features"));
    corpus(&input);
    let arguments = [input.to_str().unwrap(), "-o", output.to_str().unwrap()];
    assert!(run(&arguments).status.success());
    let at = |name: &str| output.join(name);
    let manifest = std::fs::read(at("manifest.json")).unwrap();
    let two = std::fs::read(at("audio/two.npy")).unwrap();
    let kept = std::fs::metadata(at("audio/one.npy"))
        .unwrap()
        .modified()
        .unwrap();

    // As an interrupt leaves it: no manifest, one clip not done, one without its note.
    std::fs::remove_file(at("manifest.json")).unwrap();
    std::fs::remove_file(at("audio/two.npy")).unwrap();
    std::fs::write(at("wav/three.wav"), b"half").unwrap();
    std::fs::remove_file(at("cache/three.sound")).unwrap();
    assert!(FeatureFolder::open(&output).is_err());
    assert!(run(&arguments).status.success());
    assert_eq!(std::fs::read(at("manifest.json")).unwrap(), manifest);
    assert_eq!(std::fs::read(at("audio/two.npy")).unwrap(), two);
    assert_eq!(
        sound::read(&at("wav/three.wav")).unwrap().samples,
        bursts(1.1, 90.0)
    );
    assert_eq!(
        std::fs::metadata(at("audio/one.npy"))
            .unwrap()
            .modified()
            .unwrap(),
        kept
    );

    // A clip that is gone leaves nothing behind, a changed one is made anew.
    std::fs::remove_file(input.join("train/ann/two.wav")).unwrap();
    std::fs::remove_file(input.join("train/ann/two.txt")).unwrap();
    write_wav(&input.join("test/bob/four.wav"), &bursts(2.0, 95.0));
    assert!(run(&arguments).status.success());
    assert!(!at("audio/two.npy").exists() && !at("wav/two.wav").exists() && !at("cache/two.audio").exists());
    let features = FeatureFolder::open(&output).unwrap();
    let four = features.manifest.clips.iter().find(|c| c.id == "four").unwrap();
    assert_eq!(features.audio(four).unwrap().nrows(), 198);
}

#[test]
fn useless_input_ends_with_one_line_and_a_failure() {
    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (folder.path().join("corpus"), folder.path().join("features"));
    let arguments = [input.to_str().unwrap(), "-o", output.to_str().unwrap()];
    let fails = |arguments: &[&str], expected: &str| {
        let ran = run(arguments);
        let complaint = text(&ran.stderr);
        assert!(!ran.status.success());
        let last = complaint.lines().last().unwrap();
        assert!(
            last.starts_with("lipstream: ") && last.contains(expected),
            "{complaint}"
        );
    };
    fails(&arguments, "no folder");
    std::fs::create_dir_all(&input).unwrap();
    fails(&arguments, "holds no clips");
    std::fs::write(input.join("a.wav"), b"RIFF").unwrap();
    fails(&arguments, "none of the 1 clips");
    write_wav(&input.join("a.wav"), &[0; 16_000]);
    fails(&arguments, "no speech");
    write_wav(&input.join("a.wav"), &bursts(1.0, 100.0));
    let elsewhere = folder.path().join("mine");
    std::fs::create_dir_all(&elsewhere).unwrap();
    std::fs::write(elsewhere.join("diary.txt"), "do not touch").unwrap();
    fails(
        &[input.to_str().unwrap(), "-o", elsewhere.to_str().unwrap()],
        "no feature folder",
    );
    assert!(elsewhere.join("diary.txt").exists());

    // A video where there is no ffmpeg: said once, before anything is done.
    std::fs::write(input.join("b.mp4"), b"").unwrap();
    let ran = Command::new(env!("CARGO_BIN_EXE_lipstream"))
        .arg("prepare")
        .args(arguments)
        .env("PATH", &elsewhere)
        .output()
        .unwrap();
    let complaint = text(&ran.stderr);
    assert!(
        !ran.status.success() && complaint.lines().count() == 1,
        "{complaint}"
    );
    assert!(
        complaint.contains("ffmpeg") && complaint.contains("install"),
        "{complaint}"
    );
    std::fs::remove_file(input.join("b.mp4")).unwrap();
    assert!(run(&arguments).status.success());
}

/// Nothing but one long recording: it is cut at its pauses, a second run takes over what is there, and what is no recording is refused.
#[test]
fn one_long_recording_is_a_corpus() {
    let folder = tempfile::tempdir().unwrap();
    let (take, output) = (folder.path().join("talk one.wav"), folder.path().join("features"));
    let mut samples = bursts(40.0, 110.0);
    samples.extend(std::iter::repeat_n(0, 16_000 * 20));
    write_wav(&take, &samples);
    std::fs::write(folder.path().join("talk one.txt"), "words").unwrap();
    let arguments = [
        take.to_str().unwrap(),
        "-o",
        output.to_str().unwrap(),
        "--labels-only",
    ];
    let ran = run(&arguments);
    let said = text(&ran.stderr);
    assert!(ran.status.success(), "{said}");
    assert!(
        said.contains("s without speech left out") && said.contains("talk one.txt is not read"),
        "{said}"
    );
    let features = FeatureFolder::open(&output).unwrap();
    let clips = &features.manifest.clips;
    assert!((5..=20).contains(&clips.len()), "{}", clips.len());
    assert!(
        clips
            .iter()
            .all(|clip| clip.speaker == "talk one" && clip.id.starts_with("talk"))
    );
    let frames: usize = clips.iter().map(|clip| clip.audio_frames).sum();
    assert!((3700..=4900).contains(&frames), "{frames}");
    assert!(run(&arguments).status.success());
    let again = FeatureFolder::open(&output).unwrap().manifest.clips;
    let ids = |clips: &[lipstream_make::features::Clip]| {
        clips.iter().map(|clip| clip.id.clone()).collect::<Vec<_>>()
    };
    assert_eq!(ids(&again), ids(clips));

    // Subtitles say where to cut, and what is said.
    let subtitles =
        "WEBVTT\n\n00:01.000 --> 00:05.000\nPlace two blue books\n\n00:10.000 --> 00:14.000\nplease.\n";
    std::fs::write(folder.path().join("talk one.vtt"), subtitles).unwrap();
    let other = folder.path().join("said");
    let arguments = [take.to_str().unwrap(), "-o", other.to_str().unwrap()];
    let ran = run(&[&arguments[..], &["--labels-only"]].concat());
    assert!(ran.status.success(), "{}", text(&ran.stderr));
    let clips = FeatureFolder::open(&other).unwrap().manifest.clips;
    let words: Vec<Vec<&str>> = clips
        .iter()
        .map(|clip| clip.words.iter().map(|word| word.text.as_str()).collect())
        .collect();
    assert_eq!(words, [vec!["place", "two", "blue", "books"], vec!["please"]]);
    // Who listens hears a hoarse tone, and no such words: the piece is left out and named.
    let said = text(&run(&arguments).stderr);
    assert!(
        said.contains("do not fit what is heard in it: place two blue books"),
        "{said}"
    );

    let notes = folder.path().join("notes.mp4");
    std::fs::write(&notes, "no video").unwrap();
    let ran = run(&[
        notes.to_str().unwrap(),
        "-o",
        folder.path().join("other").to_str().unwrap(),
    ]);
    let said = text(&ran.stderr);
    assert!(!ran.status.success() && said.contains("notes.mp4"), "{said}");
}

#[test]
fn prompts_are_a_sentence_a_line() {
    let printed = Command::new(env!("CARGO_BIN_EXE_lipstream"))
        .arg("prompts")
        .output()
        .unwrap();
    assert!(printed.status.success() && printed.stderr.is_empty());
    let text = text(&printed.stdout);
    assert_eq!(text.lines().count(), 24);
    assert!(
        text.lines()
            .all(|line| line.ends_with(['.', '?']) && line.split(' ').count() >= 9)
    );
}
