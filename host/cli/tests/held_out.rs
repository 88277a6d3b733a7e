//! Words are held out, systems are measured on them, and mouths are read: through the program, on a drawn talker.
mod common;

use std::path::Path;

use common::talker::{SECONDS, talker};
use lipstream::npy::{read_npy, write_npy};
use lipstream_make::features::{FeatureFolder, Word};

const WORDS: [&str; 5] = ["ma", "pa", "ba", "am", "bam"];

/// The drawn talker says two of five words in every clip: the first one moves his mouth by how far it is open, the second one is said to still lips.
fn folder(root: &Path) -> FeatureFolder {
    let mut folder = talker(root);
    for (n, clip) in folder.manifest.clips.iter_mut().enumerate() {
        let word = |place: usize| Word {
            text: WORDS[(n + n / 5 * place + place) % 5].to_owned(),
            pronunciations: vec![vec!["m".into(), "aa".into()]],
            time: Some((0.5 + 0.8 * place as f32, 1.1 + 0.8 * place as f32)),
        };
        clip.words = (0..2).map(word).collect();
        assert!(clip.words[1].time.unwrap().1 < SECONDS);
    }
    let manifest = serde_json::to_string(&folder.manifest).unwrap();
    std::fs::write(root.join("manifest.json"), manifest).unwrap();
    FeatureFolder::open(root).unwrap()
}

fn run(args: &[&str]) -> anyhow::Result<()> {
    lipstream_cli::run(["lipstream"].iter().chain(args).map(Into::into))
}

#[test]
fn held_out_words_are_measured_alone() {
    let root = tempfile::tempdir().unwrap();
    let path = |name: &str| root.path().join(name).to_string_lossy().into_owned();
    let (features, folds, out) = (path("features"), path("folds"), path("out"));
    folder(&root.path().join("features"));
    run(&["folds", &features, "-o", &folds, "--folds", "2", "--most", "0.5"]).unwrap();
    run(&["features", &features, "-o", &out]).unwrap();
    // Somebody who is right where everything was learnt, half right about as many clips, and still where the words are missing.
    for n in 13..18 {
        let truth = read_npy(&root.path().join(format!("out/test/clip{n}.visual.npy"))).unwrap();
        for (at, share) in [
            ("said", 1.0),
            ("folds/size-1", 0.5),
            ("folds/size-2", 0.5),
            ("folds/words-1", 0.0),
            ("folds/words-2", 0.0),
        ] {
            let at = match at {
                "said" => root.path().join("said"),
                fold => root.path().join(fold).join("predictions/mine"),
            };
            write_npy(&at.join(format!("clip{n}.npy")), &(&truth * share)).unwrap();
        }
    }
    let given = format!("mine@40={}", path("said"));
    let evaluate = |output: &str| {
        run(&[
            "evaluate",
            &features,
            "--held-out",
            &folds,
            "--predictions",
            &given,
            "--resamples",
            "100",
            "-o",
            output,
        ])
    };
    evaluate(&path("held.json")).unwrap();
    let text = std::fs::read_to_string(root.path().join("held.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&text).unwrap();
    let systems = report["systems"].as_array().unwrap();
    let mine = systems.iter().find(|system| system["name"] == "mine").unwrap();
    let amse = |system: &serde_json::Value, which: &str| system[which]["amse"]["value"].as_f64().unwrap();
    let acc = |which: &str| mine[which]["acc"]["value"].as_f64().unwrap();
    assert_eq!(mine["look_ahead_ms"], 40);
    assert_eq!(amse(mine, "all"), 0.0);
    assert!((amse(mine, "size") * 4.0 / amse(mine, "words") - 1.0).abs() < 1e-4);
    assert!((acc("all") - 1.0).abs() < 1e-6 && (acc("size") - 1.0).abs() < 1e-6 && acc("words") == 0.0);
    assert!((mine["cost"]["difference"].as_f64().unwrap() + 1.0).abs() < 1e-6);
    // Ridge regression is fitted anew in every fold, and the mean knows no words.
    let ridge = systems
        .iter()
        .find(|s| s["name"].as_str().unwrap().starts_with("ridge"))
        .unwrap();
    assert_ne!(amse(ridge, "all"), amse(ridge, "words"));
    assert_eq!(amse(&systems[0], "all"), amse(&systems[0], "words"));
    // Only frames of held-out words count: no more than two words of 600 ms in each of 5 clips.
    let frames = report["frames"].as_u64().unwrap();
    assert!(
        frames > 0 && frames <= 600 && frames.is_multiple_of(60),
        "{frames}"
    );
    evaluate(&path("held.md")).unwrap();
    let table = std::fs::read_to_string(root.path().join("held.md")).unwrap();
    assert!(table.contains("| mine | 40 ms | 0 | 1.000"), "{table}");

    // A system that is missing in a fold is named.
    std::fs::remove_dir_all(root.path().join("folds/words-2/predictions")).unwrap();
    let error = format!("{:#}", evaluate(&path("held.md")).unwrap_err());
    assert!(error.contains("words-2"), "{error}");
    let error = format!(
        "{:#}",
        run(&["evaluate", &features, "--held-out", &features]).unwrap_err()
    );
    assert!(error.contains("lipstream folds"), "{error}");
}

#[test]
fn a_report_says_how_many_words_can_be_read() {
    let root = tempfile::tempdir().unwrap();
    let path = |name: &str| root.path().join(name).to_string_lossy().into_owned();
    let (features, report) = (path("features"), path("report.json"));
    let made = folder(&root.path().join("features"));
    // Five examples of a word are asked for.
    let mut manifest = made.manifest;
    for (n, clip) in manifest.clips.iter_mut().enumerate() {
        clip.words[0].text = ["ma", "pa"][n % 2].to_owned();
        clip.words[1].text = ["am", "bam"][n % 2].to_owned();
    }
    let text = serde_json::to_string(&manifest).unwrap();
    std::fs::write(root.path().join("features/manifest.json"), text).unwrap();
    run(&["evaluate", &features, "--resamples", "100", "-o", &report]).unwrap();
    let text = std::fs::read_to_string(&report).unwrap();
    let report: serde_json::Value = serde_json::from_str(&text).unwrap();
    let share = |value: &serde_json::Value| value["value"].as_f64().unwrap();
    let own = share(&report["true_readability"]);
    assert!((0.0..=1.0).contains(&own), "{own}");
    for system in report["systems"].as_array().unwrap() {
        let read = &system["readability"];
        assert!((0.0..=1.0).contains(&share(&read["accuracy"])), "{system}");
        assert!(
            (share(&read["of_true"]) * own - share(&read["accuracy"])).abs() < 1e-6,
            "{system}"
        );
    }
}
