//! EM in pieces gives what one run gives; a killed run is taken up and gives the same bytes; poor data are warned about.
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;

use lipstream::hmm::system::System;
use lipstream::kinds::likelihood::Model;
use lipstream::npy::write_npy;
use lipstream_make::em::source::{Source, Utterance};
use lipstream_make::em::{self, Sums};
use lipstream_make::features::{FeatureFolder, Split};
use lipstream_make::train::shards::{self, Splitting};
use lipstream_make::train::state::State;
use lipstream_make::train::{TrainSettings, train};
use ndarray::{Array, Dimension};

#[path = "../../make/tests/talker/mod.rs"]
mod talker;

use talker::made_up_talker;

fn program() -> Command {
    Command::new(env!("CARGO_BIN_EXE_lipstream"))
}

fn near<D: Dimension>(a: &Array<f64, D>, b: &Array<f64, D>) {
    assert_eq!(a.dim(), b.dim());
    for (a, b) in a.iter().zip(b) {
        assert!((a - b).abs() <= 1e-9 * a.abs().max(1.0), "{a} {b}");
    }
}

fn same(a: &Sums, b: &Sums) {
    assert_eq!((a.frames, &a.failed), (b.frames, &b.failed));
    assert!((a.log_likelihood - b.log_likelihood).abs() < 1e-9 * a.log_likelihood.abs());
    near(&a.transition, &b.transition);
    for (a, b) in [
        (Some(&a.audio), Some(&b.audio)),
        (a.visual.as_ref(), b.visual.as_ref()),
    ] {
        assert_eq!(a.is_some(), b.is_some());
        if let (Some(a), Some(b)) = (a, b) {
            near(&a.occupancy, &b.occupancy);
            near(&a.first, &b.first);
            near(&a.second, &b.second);
        }
    }
}

#[test]
fn shards_add_up_to_one_run() {
    let scratch = tempfile::tempdir().unwrap();
    let root = scratch.path();
    let folder = made_up_talker(root, 27);
    for name in ["local-linear", "ph-hmm"] {
        let system = System::from_name(name).unwrap();
        let start = shards::start(&folder, &[], system, &()).unwrap();
        let state = root.join("start.state");
        start.write(&state).unwrap();
        let run = |of: usize| -> (State, Sums) {
            let files: Vec<PathBuf> = (1..=of)
                .map(|shard| {
                    let path = root.join(format!("{shard}-{of}.sums"));
                    shards::accumulate_files(&folder, &state, (shard, of), &path, &()).unwrap();
                    path
                })
                .collect();
            let split = Splitting {
                audio_mixtures: 2,
                visual_mixtures: 2,
            };
            shards::merge(&state, &files, Some(split)).unwrap()
        };
        let (one, sums) = run(1);
        // More shards than pieces: some are empty and count nothing.
        for of in [2, 3, 7] {
            let (many, parts) = run(of);
            same(&sums, &parts);
            assert_eq!(many.parameters.audio.mean.dim().1, 2);
            let apart = (&one.parameters.audio.mean - &many.parameters.audio.mean).mapv(f32::abs);
            assert!(apart.iter().all(|d| *d < 1e-5), "{name} in {of}");
        }
        // And all clips in memory at once.
        let clips = shards::clips(&folder, system, &start.parameters.phones, &());
        let all: Vec<Utterance> = (0..27).map(|n| clips.get(n).unwrap().into_owned()).collect();
        same(&sums, &em::expect(&start.parameters, &all[..]).unwrap());
    }
}

/// The recipes of the README, with a plain shell and with GNU parallel.
#[test]
fn the_recipe_trains_a_model() {
    let scratch = tempfile::tempdir().unwrap();
    let root = scratch.path();
    made_up_talker(root, 27);
    let has_parallel = Command::new("parallel")
        .arg("--version")
        .output()
        .is_ok_and(|o| String::from_utf8_lossy(&o.stdout).contains("GNU parallel"));
    let loop_recipe =
        "for i in 1 2 3; do $LIPSTREAM train accumulate $DIR --shard $i/3 -m state -o $i.sums & done; wait";
    let parallel_recipe =
        "parallel $LIPSTREAM train accumulate $DIR --shard {}/3 -m state -o {}.sums ::: 1 2 3";
    let mut states = Vec::new();
    for (name, recipe) in [("shell", loop_recipe), ("parallel", parallel_recipe)] {
        if name == "parallel" && !has_parallel {
            println!("skipped: GNU parallel is not installed; the same recipe was run by a shell loop");
            continue;
        }
        let work = root.join(name);
        std::fs::create_dir(&work).unwrap();
        let script = format!(
            "set -e\n$LIPSTREAM train start $DIR -o state\nfor pass in 1 2; do\n{recipe}\n\
             $LIPSTREAM train merge 1.sums 2.sums 3.sums -m state -o state\ndone\n\
             $LIPSTREAM train $DIR --state state -o model.safetensors\n"
        );
        let done = Command::new("sh")
            .args(["-c", &script])
            .current_dir(&work)
            .env("LIPSTREAM", env!("CARGO_BIN_EXE_lipstream"))
            .env("DIR", root)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&done.stderr);
        assert!(done.status.success(), "{name}: {said}");
        assert!(said.contains("pass 2: log likelihood"), "{said}");
        Model::read(&work.join("model.safetensors")).unwrap();
        states.push(std::fs::read(work.join("state")).unwrap());
    }
    assert!(states.windows(2).all(|w| w[0] == w[1]));
}

fn kept(model: &Path) -> PathBuf {
    model.with_file_name("model.safetensors.progress")
}

#[test]
fn a_killed_run_is_taken_up_to_the_same_bytes() {
    let scratch = tempfile::tempdir().unwrap();
    let root = scratch.path();
    made_up_talker(root, 12);
    let other = scratch.path().join("whole.safetensors");
    let model = scratch.path().join("model.safetensors");
    let training = |out: &Path| {
        let mut command = program();
        command
            .arg("train")
            .arg(root)
            .args(["--audio-mixtures", "2", "-o"])
            .arg(out);
        command
    };
    let whole = training(&other).output().unwrap();
    assert!(
        whole.status.success(),
        "{}",
        String::from_utf8_lossy(&whole.stderr)
    );

    // Killed after each of several passes, in both stages of splitting.
    for passes in [3, 6] {
        let mut run = training(&model).stderr(Stdio::piped()).spawn().unwrap();
        let mut seen = 0;
        for line in BufReader::new(run.stderr.take().unwrap()).lines() {
            seen += usize::from(line.unwrap().contains("log likelihood"));
            if seen == passes {
                break;
            }
        }
        run.kill().unwrap();
        run.wait().unwrap();
        assert!(!model.exists());
        assert!(kept(&model).is_dir());
        let again = training(&model).output().unwrap();
        let said = String::from_utf8_lossy(&again.stderr);
        assert!(again.status.success(), "{said}");
        assert!(said.contains("passes were made before"), "{said}");
        assert_eq!(std::fs::read(&model).unwrap(), std::fs::read(&other).unwrap());
        assert!(!kept(&model).exists());
        std::fs::remove_file(&model).unwrap();
    }

    // What is kept of another run, or damaged, is not used.
    let mut run = training(&model).stderr(Stdio::piped()).spawn().unwrap();
    let lines = BufReader::new(run.stderr.take().unwrap()).lines();
    let mut passes = lines.filter(|l| l.as_ref().is_ok_and(|l| l.contains("log likelihood")));
    passes.next().unwrap().unwrap();
    passes.next().unwrap().unwrap();
    run.kill().unwrap();
    run.wait().unwrap();
    for entry in std::fs::read_dir(kept(&model)).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|e| e == "sums") {
            let mut bytes = std::fs::read(&path).unwrap();
            let middle = bytes.len() / 2;
            bytes[middle] ^= 1;
            std::fs::write(&path, bytes).unwrap();
        }
    }
    let again = training(&model).output().unwrap();
    assert!(again.status.success());
    assert_eq!(std::fs::read(&model).unwrap(), std::fs::read(&other).unwrap());
}

#[test]
fn what_cannot_be_sharded_is_said() {
    let scratch = tempfile::tempdir().unwrap();
    let root = scratch.path();
    let folder = made_up_talker(root, 9);
    let system = System::from_name("local-linear").unwrap();
    let state = root.join("a.state");
    shards::start(&folder, &[], system, &())
        .unwrap()
        .write(&state)
        .unwrap();
    let says = |args: &[&str], part: &str| {
        let run = program()
            .arg("train")
            .args(args)
            .current_dir(root)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&run.stderr);
        assert!(!run.status.success() && said.contains(part), "{said}");
    };
    says(
        &["accumulate", ".", "--shard", "3/2", "-m", "a.state", "-o", "s"],
        "from 1/2 to 2/2",
    );
    says(
        &["accumulate", ".", "--shard", "two", "-m", "a.state", "-o", "s"],
        "3/8",
    );
    says(
        &[
            "accumulate",
            ".",
            "--shard",
            "1/2",
            "-m",
            "manifest.json",
            "-o",
            "s",
        ],
        "manifest.json",
    );
    says(
        &[
            "accumulate",
            "nowhere",
            "--shard",
            "1/2",
            "-m",
            "a.state",
            "-o",
            "s",
        ],
        "nowhere",
    );
    says(&["merge", "a.state", "-m", "a.state", "-o", "b.state"], "a.state");
    says(&[], "required arguments");
    let first = program()
        .args([
            "train",
            "accumulate",
            ".",
            "--shard",
            "1/2",
            "-m",
            "a.state",
            "-o",
            "1.sums",
        ])
        .current_dir(root)
        .status()
        .unwrap();
    assert!(first.success());
    says(
        &["merge", "1.sums", "-m", "a.state", "-o", "b.state"],
        "shard 2 of 2 is missing",
    );
    assert!(!root.join("b.state").exists());
    says(
        &[".", "--state", "a.state", "--system", "ph-hmm", "-o", "m"],
        "not of ph-hmm",
    );
}

#[test]
fn poor_data_are_warned_about_and_give_numbers() {
    let scratch = tempfile::tempdir().unwrap();
    let root = scratch.path();
    let mut folder: FeatureFolder = made_up_talker(root, 12);
    // A number that never changes; a phone that is said once, briefly; a clip that is shorter than its states.
    for n in 0..folder.manifest.clips.len() {
        let clip = &folder.manifest.clips[n];
        let mut audio = folder.audio(clip).unwrap();
        audio.column_mut(5).fill(0.25);
        write_npy(&folder.audio_path(&clip.id), &audio).unwrap();
    }
    let clips = &mut folder.manifest.clips;
    let word = &mut clips[0].words[0];
    word.pronunciations[0][0] = "zh".into();
    if let Some((start, end)) = &mut word.time {
        *end = *start + 0.06;
    }
    clips[1].audio_frames = 9;
    let short = folder.audio(&folder.manifest.clips[2]).unwrap();
    write_npy(
        &folder.audio_path(&folder.manifest.clips[1].id),
        &short.slice(ndarray::s![..9, ..]).to_owned(),
    )
    .unwrap();
    let said = Mutex::new(Vec::new());
    let settings = TrainSettings {
        audio_mixtures: 2,
        iterations: 3,
        acoustic_scales: vec![0.2],
        penalties: vec![10.0],
        ..TrainSettings::default()
    };
    let model = train(&folder, &[], &settings, &|line: &str| {
        said.lock().unwrap().push(line.to_owned())
    })
    .unwrap();
    let said = said.into_inner().unwrap().join("\n");
    for part in [
        "audio numbers 5 never change",
        "9 frames are too few",
        "warning: zh is said in",
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }
    assert!(!said.contains("NaN"));
    let mixtures = [&model.audio, &model.visual];
    for m in mixtures {
        assert!(m.mean.iter().chain(&m.variance).all(|v| v.is_finite()));
        assert!(m.variance.iter().all(|v| *v >= 1e-6));
    }
    assert!(model.maps.state.iter().all(|v| v.is_finite()));
    assert_eq!(folder.split(Split::Train).count(), 12);
}
