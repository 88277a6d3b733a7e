//! `lipstream mos` as it is called: a page with its key, and tables of what viewers' pages gave.
mod common;

use std::path::Path;

use common::program::{refuse, succeed};
use serde_json::{Value, json};

/// A folder of two systems with two clips each; what a film holds is nothing to this command.
fn clips(folder: &Path) {
    for system in ["mine", "recording"] {
        for clip in ["one", "two"] {
            let path = folder.join("clips").join(system).join(format!("{clip}.mp4"));
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, format!("\0\0\0\x10ftypisom {system} {clip}")).unwrap();
        }
    }
}

/// A viewer's file, as the page writes it.
fn answers(folder: &Path, name: &str, checked: u8) {
    let key = std::fs::read_to_string(folder.join("page.key.json")).unwrap();
    let key: Value = serde_json::from_str(&key).unwrap();
    let answer = |code: &str, check: Option<u8>, score: u8| json!({ "code": code, "check": check, "scores": vec![score; 5], "plays": 1, "seconds": 9.5 });
    let judged = key["clips"].as_object().unwrap().iter();
    let judged =
        judged.map(|(code, shown)| answer(code, None, if shown["system"] == "mine" { 2 } else { 4 }));
    let mut answers: Vec<Value> = judged.collect();
    let code = answers[0]["code"].as_str().unwrap().to_owned();
    answers.insert(1, answer(&code, Some(2), checked));
    answers.insert(4, answer(&code, Some(4), 4));
    let results = json!({
        "format": "lipstream mos results", "version": 1, "test": key["test"], "viewer": name, "seed": 7,
        "started": "2026-01-01T10:00:00.000Z", "finished": "2026-01-01T10:20:00.000Z", "answers": answers,
    });
    std::fs::write(folder.join(name), results.to_string()).unwrap();
}

#[test]
fn a_page_its_key_and_its_tables() {
    let folder = common::folder("cli-mos");
    clips(&folder);
    let told = succeed(
        &folder,
        &["mos", "make", "clips", "-o", "page.html", "--title", "Two"],
    );
    assert!(
        told.contains("page.html: 2 clips of 2 systems") && told.contains("page.key.json"),
        "{told}"
    );
    let page = std::fs::read_to_string(folder.join("page.html")).unwrap();
    assert!(!page.contains("\"mine\"") && !page.contains("\"recording\""));

    answers(&folder, "a.json", 2);
    answers(&folder, "b.json", 2);
    answers(&folder, "c.json", 5);
    let words = [
        "mos",
        "tables",
        "a.json",
        "b.json",
        "c.json",
        "--key",
        "page.key.json",
        "-o",
        "report.md",
    ];
    let told = succeed(&folder, &words);
    assert_eq!(told, "report.md: 3 files of answers\n");
    let report = std::fs::read_to_string(folder.join("report.md")).unwrap();
    assert!(report.contains("## Two\n\n2 viewers of 2 clips"), "{report}");
    assert!(
        report.contains("Left out, because a check of attention failed: c.json"),
        "{report}"
    );
    assert!(report.contains("100.00 [100.00, 100.00]"), "{report}");
}

#[test]
fn what_cannot_be_used_is_refused_and_nothing_is_written() {
    let folder = common::folder("cli-mos-refused");
    clips(&folder);
    assert!(refuse(&folder, &["mos", "make", "clips", "-o", "page.txt"]).contains("name it .html"));
    succeed(&folder, &["mos", "make", "clips", "-o", "page.html"]);
    std::fs::remove_file(folder.join("clips/mine/two.mp4")).unwrap();
    let error = refuse(&folder, &["mos", "make", "clips", "-o", "other.html"]);
    assert!(error.contains("mine has no two.mp4"), "{error}");

    answers(&folder, "a.json", 2);
    let tables = |results: &[&str]| {
        let words = [
            &["mos", "tables"],
            results,
            &["--key", "page.key.json", "-o", "report.md"],
        ]
        .concat();
        refuse(&folder, &words)
    };
    assert!(tables(&["a.json", "a.json"]).contains("same viewer"));
    assert!(tables(&["page.key.json"]).contains("no file of a viewer's answers"));
    assert!(tables(&["missing.json"]).contains("cannot read missing.json"));
    let text = std::fs::read_to_string(folder.join("a.json")).unwrap();
    std::fs::write(folder.join("half.json"), &text[..text.len() / 2]).unwrap();
    assert!(tables(&["half.json"]).contains("half.json is no file of a viewer's answers, or damaged"));
    for name in ["other.html", "other.key.json", "report.md", "page.txt"] {
        assert!(!folder.join(name).exists(), "{name}");
    }
}
