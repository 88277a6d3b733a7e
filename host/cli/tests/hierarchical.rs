//! The second paper's face on a drawn talker, end to end: landmarks and videos to a model, a sound to faces, and what is said to input that cannot be used.
mod common;

use std::path::Path;

use common::heads::{self, HEAD, PLACE, film, landmarks};
use common::program::{one_line, run_with_programs, text};
use common::talker::{VIDEO_HZ, talker_seen};
use lipstream::kinds::hierarchical::{Choice, HierarchicalModel, at_frames};
use ndarray::{Array3, Array4};
use ndarray_npy::WriteNpyExt as _;

/// The talker's heads and landmarks in `videos/` and `landmarks/`, features in `features/`.
fn drawn_heads(root: &Path) {
    for folder in ["videos", "landmarks", "features"] {
        std::fs::create_dir_all(root.join(folder)).unwrap();
    }
    talker_seen(&root.join("features"), |id, poses, images: &Array4<u8>| {
        film(
            &root.join(format!("videos/{id}.mp4")),
            VIDEO_HZ as u32,
            images.outer_iter(),
        );
        let points =
            Array3::from_shape_fn((poses.len(), 13, 2), |(t, k, axis)| landmarks(&poses[t])[k][axis]);
        let file = std::fs::File::create(root.join(format!("landmarks/{id}.npy"))).unwrap();
        points.write_npy(file).unwrap();
    });
    std::fs::write(
        root.join("landmarks/groups.json"),
        r#"[["lips_outer", 4], ["lips_inner", 4], ["head", 5]]"#,
    )
    .unwrap();
    std::fs::write(
        root.join("tree.json"),
        r#"{"areas":[{"name":"face"},{"name":"mouth","parent":"face","landmarks":[0,1,2,3,4,5,6,7]}]}"#,
    )
    .unwrap();
}

/// The shipped model, by which clusters are chosen.
const GUIDE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../models/grid-s1.safetensors");

/// Draws a clip that took no part in training, as raw pictures on standard output.
const RENDER: [&str; 8] = [
    "render",
    "features/wav/clip15.wav",
    "-m",
    "m.safetensors",
    "--scale",
    "1",
    "-o",
    "-",
];

const TRAIN: [&str; 14] = [
    "train",
    "features",
    "--system",
    "hierarchical",
    "--landmarks",
    "landmarks",
    "--videos",
    "videos",
    "--tree",
    "tree.json",
    "--pictures",
    "300",
    "-o",
    "m.safetensors",
];

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (ma, mb) = (mean(a), mean(b));
    let sum = |f: &dyn Fn(f64, f64) -> f64| std::iter::zip(a, b).map(|(x, y)| f(x - ma, y - mb)).sum::<f64>();
    sum(&|x, y| x * y) / (sum(&|x, _| x * x) * sum(&|_, y| y * y)).sqrt()
}

#[test]
fn a_drawn_head_learns_to_speak() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    drawn_heads(root);
    let mut train = TRAIN.to_vec();
    train.extend(["--clusters", "4,12", "--starts", "2", "--guide", GUIDE]);
    let trained = run_with_programs(root, &train);
    let said = text(&trained.stderr);
    assert!(trained.status.success(), "{said}");
    assert!(
        said.contains("300 training pictures of 10 clips") && said.contains("mouth: 12 clusters: error"),
        "{said}"
    );
    let model = HierarchicalModel::read(&root.join("m.safetensors")).unwrap();
    let names: Vec<&str> = model.groups().iter().map(|(name, _)| *name).collect();
    assert_eq!(names, ["face", "mouth"]);

    // A clip that took no part: 65 pictures, dark where the mouth is open, as the recording is.
    let pictures = run_with_programs(root, &RENDER);
    assert!(
        pictures.status.success(),
        "{}",
        String::from_utf8_lossy(&pictures.stderr)
    );
    let recorded = lipstream_media::video::decode(&root.join("videos/clip15.mp4")).unwrap();
    let side = pictures.stdout.len() / recorded.len() / 3;
    let width = (side as f64).sqrt() as usize;
    assert_eq!(width * width * 3 * recorded.len(), pictures.stdout.len());
    // The mean face begins a pixel before its own landmarks, which begin two pixels inside the head.
    let darkness = |rgb: &[u8], width: usize, off: usize| -> f64 {
        let (left, top) = (PLACE.0 + 24 - off, PLACE.1 + 18 - off);
        let pixels = (top..top + 12).flat_map(|y| (left..left + 16).map(move |x| 3 * (y * width + x)));
        pixels.map(|at| -f64::from(rgb[at])).sum()
    };
    let drawn: Vec<f64> = pictures
        .stdout
        .chunks(width * width * 3)
        .map(|rgb| darkness(rgb, width, 1))
        .collect();
    let truth: Vec<f64> = (0..recorded.len())
        .map(|t| darkness(recorded.frame(t), HEAD, 0))
        .collect();
    let follows = correlation(&drawn, &truth);
    assert!(
        follows > 0.8,
        "the drawn mouth's darkness follows the recorded one's by {follows:.2}"
    );

    // Beside the mean and ridge regression, and in the space that all have in common.
    let measured = run_with_programs(
        root,
        &[
            "evaluate",
            "features",
            "--also",
            "hierarchical=m.safetensors",
            "--landmarks",
            "landmarks",
            "--choice",
            "mahalanobis,chmm,recurrent",
            "--json",
        ],
    );
    assert!(measured.status.success(), "{}", text(&measured.stderr));
    let report: serde_json::Value = serde_json::from_slice(&measured.stdout).unwrap();
    let system = |name: &str| {
        let all = report["systems"].as_array().unwrap();
        all.iter().find(|system| system["name"] == name).unwrap().clone()
    };
    let (mean, own) = (system("mean"), system("hierarchical"));
    let number = |of: &serde_json::Value, what: &str| of["common"][what].as_f64().unwrap();
    // A mean mouth follows nothing; the weights' true gap is nearly the landmarks'.
    assert_eq!(number(&mean, "gap_correlation"), 0.0);
    assert!(report["true_common"]["gap_correlation"].as_f64().unwrap() > 0.97);
    assert!(number(&own, "gap_correlation") > 0.8, "{own}");
    for (what, sign) in [("gap_error", -1.0), ("psnr_db", 1.0), ("ssim", 1.0)] {
        assert!(
            sign * number(&own, what) > sign * number(&mean, what),
            "{what}: {own} {mean}"
        );
    }
    // A voice of tones means nothing to the guide, whose states still tell open mouths from closed ones.
    for name in ["hierarchical, chmm", "hierarchical, recurrent"] {
        let guided = system(name);
        assert!(number(&guided, "gap_correlation") > 0.5, "{name}: {guided}");
        assert!(
            guided["look_ahead_ms"].as_u64() > own["look_ahead_ms"].as_u64(),
            "{guided} {own}"
        );
    }
    let said = refuse(root, "evaluate features -m m.safetensors");
    assert!(said.contains("--also"), "{said}");

    // Somebody who speaks at another level: a voice that is adapted to is drawn otherwise.
    let bytes = |adapt: &[&str]| {
        let words = [&RENDER[..], adapt].concat();
        let drawn = run_with_programs(root, &words);
        assert!(drawn.status.success(), "{}", text(&drawn.stderr));
        drawn.stdout
    };
    assert_eq!(bytes(&["--choice", "mahalanobis"]), pictures.stdout);
    assert_ne!(bytes(&["--choice", "chmm"]), pictures.stdout);
    assert_ne!(bytes(&["--adapt", "level"]), pictures.stdout);
    assert_ne!(bytes(&["--adapt", "linear"]), bytes(&["--adapt", "level"]));
    let said = refuse(root, "render features/wav/clip15.wav --adapt level -o f.mp4");
    assert!(said.contains("--adapt is of hierarchical models"), "{said}");

    // A video with its sound, to a file.
    let said = succeed_words(root, "render features/wav/clip15.wav -m m.safetensors -o f.mp4");
    assert!(said.contains("65 pictures of 384×384"), "{said}");
    for (words, wanted) in [
        ("render p.npy -m m.safetensors -o f.mp4", "moved by speech"),
        (
            "render features/wav/clip15.wav -m m.safetensors -o f.html",
            "write a video",
        ),
        (
            "convert features/wav/clip15.wav -m m.safetensors -o p.npy",
            "is a hierarchical model",
        ),
        ("export m.safetensors -o m.tables", "--for-device"),
        (
            "train features --system hierarchical --landmarks landmarks --guide m.safetensors -o n.safetensors",
            "m.safetensors cannot choose clusters",
        ),
    ] {
        let said = refuse(root, words);
        assert!(said.contains(wanted), "{said}");
    }
}

/// Trained on the device's own front end, written as its tables, and run as it runs them: the numbers of its groups, a hundred times a second.
#[test]
fn a_head_speaks_on_the_device() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    drawn_heads(root);
    let mut train = TRAIN.to_vec();
    train.extend(["--clusters", "12", "--starts", "1", "--for-device"]);
    let trained = run_with_programs(root, &train);
    assert!(trained.status.success(), "{}", text(&trained.stderr));
    let said = succeed_words(root, "export m.safetensors -o m.tables");
    assert!(
        said.contains("AppearanceWeights") && said.contains("m.tables"),
        "{said}"
    );
    succeed_words(root, "convert features/wav/clip15.wav -m m.tables -o p.npy");
    let model = HierarchicalModel::read(&root.join("m.safetensors")).unwrap();
    let said = lipstream::npy::read_npy(&root.join("p.npy")).unwrap();
    let sound = lipstream_media::sound::read(&root.join("features/wav/clip15.wav")).unwrap();
    let wanted = model.convert(&sound.samples, Choice::Mahalanobis).unwrap();
    let wanted = at_frames(&wanted, 25.0, said.nrows());
    let deviations = model
        .nodes
        .iter()
        .flat_map(|node| &node.appearance.joint.variances);
    let deviations: ndarray::Array1<f32> = deviations.map(|v| v.sqrt()).collect();
    let off = ((&said - &wanted) / &deviations).mapv(f32::abs);
    let other = off
        .outer_iter()
        .filter(|row| row.iter().any(|v| *v > 0.02))
        .count();
    assert!(
        other * 20 <= off.nrows(),
        "{other} of {} frames are others",
        off.nrows()
    );
    for (words, wanted) in [
        ("export m.safetensors -o n.tables --beam 11", "follows nothing"),
        (
            "render features/wav/clip15.wav -m m.safetensors --choice chmm -o n.mp4",
            "--guide",
        ),
        (
            "export m.safetensors -o n.tables --flash 1",
            "no model fits 1 KiB",
        ),
    ] {
        let said = refuse(root, words);
        assert!(said.contains(wanted), "{said}");
    }
    let refused = run_with_programs(root, &split("evaluate features --choice chmm"));
    assert_eq!(refused.status.code(), Some(2));
}

/// The words of a command, none of which has a blank in it.
fn split(command: &str) -> Vec<&str> {
    command.split_whitespace().collect()
}

/// What a run of this command says that refuses.
fn refuse(root: &Path, command: &str) -> String {
    one_line(run_with_programs(root, &split(command)))
}

fn succeed_words(root: &Path, command: &str) -> String {
    let ran = run_with_programs(root, &split(command));
    assert!(ran.status.success(), "{}", text(&ran.stderr));
    text(&ran.stdout)
}

#[test]
fn what_cannot_be_trained_is_said_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    drawn_heads(root);
    let said = refuse(root, "train features --system hierarchical -o m.safetensors");
    assert!(said.contains("--landmarks"), "{said}");
    let said = refuse(root, "train features --landmarks landmarks -o m.safetensors");
    assert!(said.contains("--system hierarchical"), "{said}");
    let refused = run_with_programs(
        root,
        &["train", "features", "--system", "gru", "-o", "m.safetensors"],
    );
    assert_eq!(refused.status.code(), Some(2));
    let said = text(&refused.stderr);
    assert!(
        said.contains("ph-vi-chmm") && said.contains("hierarchical"),
        "{said}"
    );
    let mut words = TRAIN.to_vec();
    words.extend(["--lag", "3"]);
    let refused = run_with_programs(root, &words);
    assert_eq!(refused.status.code(), Some(2));
    let with = |at: usize, word: &'static str| {
        let mut words = TRAIN;
        words[at] = word;
        one_line(run_with_programs(root, &words))
    };
    let said = with(7, "landmarks");
    assert!(said.contains("landmarks holds no"), "{said}");
    let said = with(5, "videos");
    assert!(said.contains("holds no landmarks"), "{said}");
    std::fs::write(root.join("broken.json"), "{").unwrap();
    let said = with(9, "broken.json");
    assert!(said.contains("broken.json is no tree"), "{said}");
    std::fs::remove_file(root.join("landmarks/clip03.npy")).unwrap();
    let said = with(11, "300");
    assert!(
        said.contains("clip clip03: there are no landmarks of it"),
        "{said}"
    );
    assert!(!root.join("m.safetensors").exists());
}

/// The points of some pictures as a table: every `step`-th of each of `clips`.
fn labelled(root: &Path, clips: &[&str], step: usize) -> String {
    let mut table = heads::columns();
    for clip in clips {
        let points = truth(root, clip);
        for (picture, row) in points.outer_iter().enumerate().step_by(step) {
            table += &format!("\n{clip},{picture}");
            row.iter().for_each(|v| table += &format!(",{v}"));
        }
    }
    table + "\n"
}

fn truth(root: &Path, clip: &str) -> Array3<f32> {
    lipstream::npy::read_array(&root.join(format!("landmarks/{clip}.npy"))).unwrap()
}

#[test]
fn a_few_labelled_pictures_give_the_landmarks_of_all() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    drawn_heads(root);
    std::fs::write(
        root.join("some.csv"),
        labelled(root, &["clip00", "clip05", "clip09"], 6),
    )
    .unwrap();
    let label = |video: &str, out: &str| {
        let words = ["landmarks", video, "--labelled", "some.csv", "-o", out];
        run_with_programs(root, &words)
    };
    let done = label("videos", "all.npz");
    let said = text(&done.stderr);
    assert!(done.status.success(), "{said}");
    assert!(said.contains("is found with a median error of"), "{said}");
    assert!(said.contains("1170 pictures of 18 clips"), "{said}");
    let found = lipstream_make::hierarchical::Landmarks::read(&root.join("all.npz")).unwrap();
    assert!(found.labelled().len() > 1170 * 9 / 10, "{said}");
    let mut off = Vec::new();
    for clip in ["clip03", "clip12", "clip15"] {
        let truth = truth(root, clip);
        assert_eq!(found.of(clip).unwrap().dim(), truth.dim());
        for (a, b) in found.of(clip).unwrap().outer_iter().zip(truth.outer_iter()) {
            let far = |k: usize| (a[(k, 0)] - b[(k, 0)]).hypot(a[(k, 1)] - b[(k, 1)]) / (HEAD - 5) as f32;
            // Outer and inner lips: the head's corners do not move.
            off.extend((0..8).map(far));
        }
    }
    off.sort_by(f32::total_cmp);
    let median = off[off.len() / 2];
    assert!(median < 0.02, "the lips are off by {median} of the head's width");

    // What comes out trains a model.
    let mut train = TRAIN.to_vec();
    train[5] = "all.npz";
    train[11] = "60";
    train.extend(["--clusters", "4", "--starts", "1"]);
    let trained = run_with_programs(root, &train);
    assert!(trained.status.success(), "{}", text(&trained.stderr));

    // Labels that do not belong to the videos, and outputs that cannot be; nothing half written is left behind.
    let refused = one_line(label("videos/clip15.mp4", "one.csv"));
    assert!(
        refused.contains("clip00") && refused.contains("there is clip15"),
        "{refused}"
    );
    let refused = one_line(label("videos", "all.txt"));
    assert!(refused.contains(".npz or .csv"), "{refused}");
    std::fs::write(root.join("videos/clip05.mp4"), "no video").unwrap();
    let refused = one_line(label("videos", "again.csv"));
    assert!(refused.contains("clip05.mp4"), "{refused}");
    assert!(!root.join("again.csv").exists() && !root.join("one.csv").exists());
}

#[test]
fn labels_are_rewritten_without_a_video() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let points = "version: 1\nn_points: 3\n{\n11 21\n31 21\n21 41\n}\n";
    std::fs::write(root.join("walk_1.pts"), points).unwrap();
    std::fs::write(root.join("walk_3.pts"), points).unwrap();
    let rewrite = |labelled: &[&str], out: &str| {
        let words = [&["landmarks", "--labelled"], labelled, &["-o", out]].concat();
        common::program::run(root, &words)
    };
    let done = rewrite(&["walk_1.pts", "walk_3.pts"], "walk.csv");
    assert!(done.status.success(), "{}", text(&done.stderr));
    let table = std::fs::read_to_string(root.join("walk.csv")).unwrap();
    let lines: Vec<&str> = table.lines().collect();
    assert_eq!(
        lines,
        [
            "clip,picture,confidence,x_0,y_0,x_1,y_1,x_2,y_2",
            "walk,0,1.000,10.000,20.000,30.000,20.000,20.000,40.000",
            "walk,1,0.000,,,,,,",
            "walk,2,1.000,10.000,20.000,30.000,20.000,20.000,40.000",
        ]
    );
    std::fs::write(root.join("damaged_2.pts"), &points[..30]).unwrap();
    let refused = one_line(rewrite(&["walk_1.pts", "damaged_2.pts"], "no.csv"));
    assert!(
        refused.contains("damaged_2.pts") && refused.contains("cut short"),
        "{refused}"
    );
    let refused = one_line(rewrite(&["none_1.pts"], "no.csv"));
    assert!(refused.contains("none_1.pts"), "{refused}");
    assert!(!root.join("no.csv").exists());
    let refused = one_line(rewrite(&["walk.csv"], "walk.csv"));
    assert!(refused.contains("walk.csv"), "{refused}");
    assert_eq!(std::fs::read_to_string(root.join("walk.csv")).unwrap(), table);
}
