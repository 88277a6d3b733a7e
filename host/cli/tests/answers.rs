//! What commands tell programs: with `--json` standard output is JSON, whatever it carries.
mod common;

use std::path::Path;

use common::program::{run, succeed};
use serde_json::Value;

/// A file of the repository.
fn file(name: &str) -> String {
    common::root().join(name).to_str().unwrap().to_owned()
}

/// What a command gives, which is one JSON value.
fn told(folder: &Path, arguments: &[&str]) -> Value {
    let text = succeed(folder, arguments);
    serde_json::from_str(&text).unwrap_or_else(|why| panic!("{arguments:?}: {why}:\n{text}"))
}

#[test]
fn one_object_says_what_was_written() {
    let folder = common::folder("cli-json");
    let hello = file("data/hello.wav");
    let seconds = |value: &Value| (value["seconds"].as_f64().unwrap() * 100.0).round() / 100.0;

    let numbers = told(&folder, &["convert", &hello, "-o", "a.csv", "--json"]);
    let rows = std::fs::read_to_string(folder.join("a.csv"))
        .unwrap()
        .lines()
        .count()
        - 1;
    assert_eq!(
        (&numbers["output"], numbers["frames"].as_u64()),
        (&Value::from("a.csv"), Some(rows as u64))
    );
    assert_eq!(seconds(&numbers), 4.22);

    let cues = told(&folder, &["cues", &hello, "-o", "a.tsv", "--json"]);
    let lines = std::fs::read_to_string(folder.join("a.tsv"))
        .unwrap()
        .lines()
        .count()
        - 1;
    assert_eq!(
        (&cues["output"], cues["cues"].as_u64()),
        (&Value::from("a.tsv"), Some(lines as u64))
    );
    let weights = told(
        &folder,
        &["cues", &hello, "-o", "w.csv", "--rate", "25", "--json"],
    );
    assert_eq!(
        (seconds(&weights), weights["rows_per_second"].as_f64()),
        (4.22, Some(25.0))
    );

    let features = told(&folder, &["features", &hello, "-o", "a.htk", "--json"]);
    assert_eq!(
        (features["frames"].as_u64(), features["numbers"].as_u64()),
        (Some(rows as u64), Some(39))
    );

    let pictures = told(
        &folder,
        &["render", &hello, "-o", "pictures/", "--fps", "2", "--json"],
    );
    let drawn = folder.join("pictures").read_dir().unwrap().count();
    assert_eq!(
        (pictures["pictures"].as_u64(), &pictures["sound"]),
        (Some(drawn as u64), &Value::from(true))
    );

    let demo = told(&folder, &["demo", "-o", "demo", "--json"]);
    let cue_files = demo["cues"].as_array().unwrap().iter();
    for path in cue_files.chain([&demo["video"], &demo["page"]]) {
        assert!(folder.join(path.as_str().unwrap()).is_file(), "{path}");
    }

    let hand = file("data/servos.json");
    let moved = told(
        &folder,
        &["servo", &hello, "-c", &hand, "-o", "pulses.csv", "--json"],
    );
    let rows = std::fs::read_to_string(folder.join("pulses.csv"))
        .unwrap()
        .lines()
        .count();
    assert_eq!(moved["hops"].as_u64(), Some(rows as u64));

    let prompts = told(&folder, &["prompts", "--json"]);
    let read_aloud = succeed(&folder, &["prompts"]);
    assert!(
        prompts
            .as_array()
            .unwrap()
            .iter()
            .map(|p| p.as_str().unwrap())
            .eq(read_aloud.lines())
    );
}

#[test]
fn what_goes_to_standard_output_is_json_itself() {
    let folder = common::folder("cli-json-stdout");
    let hello = file("data/hello.wav");
    let cues = told(&folder, &["cues", &hello, "--json"]);
    assert_eq!(cues, told(&folder, &["cues", &hello, "-f", "json"]));
    let numbers = told(&folder, &["convert", &hello, "-o", "-", "--json"]);
    assert_eq!(
        numbers,
        told(&folder, &["convert", &hello, "-o", "-", "--format", "json"])
    );
    // What is no JSON leaves standard output to itself.
    let ran = run(&folder, &["cues", &hello, "-f", "tsv", "--json"]);
    assert!(String::from_utf8_lossy(&ran.stdout).starts_with("0.00\tX\n"));
    let said: Value = serde_json::from_slice(&ran.stderr).unwrap();
    assert_eq!(said["output"], "-");
}

#[test]
fn every_sound_of_many_is_told_of() {
    let folder = common::folder("cli-json-many");
    std::fs::create_dir(folder.join("in")).unwrap();
    std::fs::copy(file("data/hello.wav"), folder.join("in/good.wav")).unwrap();
    let whole = std::fs::read(file("data/hello.wav")).unwrap();
    std::fs::write(folder.join("in/short.wav"), &whole[..60]).unwrap();
    for command in ["convert", "cues"] {
        let ran = run(&folder, &[command, "in", "-o", command, "--json"]);
        let said: Value = serde_json::from_slice(&ran.stdout).unwrap();
        let files = said["files"].as_array().unwrap();
        assert_eq!(ran.status.code(), Some(1));
        let good = folder.join(files[0]["output"].as_str().unwrap());
        assert!(good.is_file() && files[0]["error"].is_null());
        assert_eq!(files[1]["input"], "in/short.wav");
        assert!(files[1]["error"].as_str().unwrap().contains("short.wav") && files[1]["output"].is_null());
    }
}

#[test]
fn what_would_be_flashed_and_what_was_written() {
    let folder = common::folder("cli-json-flash");
    let tables = file("models/grid-s1.tables");
    let words = ["flash", "--board", "pico", "--model", &tables, "--json"];
    let written = told(&folder, &[&words[..], &["--file", "model.uf2"]].concat());
    let size = std::fs::metadata(&tables).unwrap().len();
    assert_eq!(
        (&written["output"], written["model"].as_u64()),
        (&Value::from("model.uf2"), Some(size))
    );
    assert!(written["program"].is_null() && folder.join("model.uf2").is_file());
    // Without probe-rs the commands are told all the same, and that it is missing.
    let plan = told(&folder, &[&words[..], &["--probe", "--dry-run"]].concat());
    let of = |name: &str| plan[name].as_array().unwrap().clone();
    assert!(
        of("commands")
            .iter()
            .all(|c| c.as_str().unwrap().starts_with("probe-rs ")),
        "{plan}"
    );
    assert!(of("notes")[0].as_str().unwrap().contains("probe-rs"), "{plan}");
}

#[test]
fn tables_go_to_standard_output_too() {
    let folder = common::folder("cli-export-stdout");
    let model = file("models/grid-s1.safetensors");
    let said = told(&folder, &["export", &model, "-o", "a.tables", "--json"]);
    let ran = run(&folder, &["export", &model, "-o", "-", "--json"]);
    assert!(ran.stdout == std::fs::read(folder.join("a.tables")).unwrap());
    assert_eq!(serde_json::from_slice::<Value>(&ran.stderr).unwrap(), said);
}

/// What somebody made by hand is not written over.
#[test]
fn what_is_read_is_not_written_onto() {
    let folder = common::folder("cli-kept");
    std::fs::copy(file("data/hello.wav"), folder.join("a.wav")).unwrap();
    std::fs::write(folder.join("a.lab"), "0 42000000 hello\n").unwrap();
    std::fs::copy(file("data/servos.json"), folder.join("s.json")).unwrap();
    std::fs::copy(file("models/grid-s1.safetensors"), folder.join("m.safetensors")).unwrap();
    let calls = [
        (&["align", "a.wav", "-o", "a.lab"][..], "a.lab"),
        (&["align", "a.wav", "-o", ".", "--format", "lab"], "a.lab"),
        (
            &["export", "m.safetensors", "-o", "m.safetensors"],
            "m.safetensors",
        ),
        (&["servo", "a.wav", "-c", "s.json", "-o", "s.json"], "s.json"),
        (&["servo", "-c", "s.json", "--write-table", "s.json"], "s.json"),
    ];
    for (call, kept) in calls {
        let before = std::fs::read(folder.join(kept)).unwrap();
        let ran = run(&folder, call);
        let error = String::from_utf8(ran.stderr).unwrap();
        assert_eq!(ran.status.code(), Some(1), "{call:?}: {error}");
        assert!(
            error.contains("is read from") && error.contains(kept),
            "{call:?}: {error}"
        );
        assert!(std::fs::read(folder.join(kept)).unwrap() == before, "{call:?}");
    }
}
