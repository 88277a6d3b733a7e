//! `lipstream landmarks --page` as a browser asks it: what is proposed, corrected and accepted, and what is refused.
#![cfg(unix)]
mod common;

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use common::heads;
use common::program::{interrupt, one_line, program, run_with_programs};
use lipstream_make::hierarchical::Landmarks;
use serde_json::{Value, json};

/// A running program, and HOST:PORT of its page.
struct Page {
    program: Child,
    place: String,
}

fn page(folder: &Path, words: &str) -> Page {
    let mut program = Command::new(program())
        .current_dir(folder)
        .args(words.split(' '))
        .args(["--port", "0"])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    let said = program.stdout.take().unwrap();
    BufReader::new(said).read_line(&mut line).unwrap();
    let address = line
        .strip_prefix("open http://")
        .and_then(|rest| rest.split('/').next());
    match address {
        Some(place) => Page {
            place: place.to_owned(),
            program,
        },
        None => panic!("{line:?} {:?}", program.wait_with_output()),
    }
}

impl Page {
    /// Status and body of the answer to a request; one with a `body` is a POST.
    fn raw(&self, path: &str, body: Option<&str>, origin: &str) -> (u16, Vec<u8>) {
        let mut line = TcpStream::connect(&self.place).unwrap();
        let method = if body.is_some() { "POST" } else { "GET" };
        let body = body.unwrap_or_default();
        write!(
            line,
            "{method} {path} HTTP/1.1\r\nHost: {}\r\nOrigin: {origin}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{body}",
            self.place,
            body.len()
        )
        .unwrap();
        let mut answer = Vec::new();
        line.read_to_end(&mut answer).unwrap();
        let head = answer.windows(4).position(|w| w == b"\r\n\r\n").unwrap();
        let status = String::from_utf8_lossy(&answer[..head]);
        let status = status.split(' ').nth(1).unwrap().parse().unwrap();
        (status, answer.split_off(head + 4))
    }

    fn ask(&self, path: &str, body: Option<Value>) -> (u16, Vec<u8>) {
        let body = body.map(|body| body.to_string());
        self.raw(path, body.as_deref(), &format!("http://{}", self.place))
    }

    /// The state after a request that must be done.
    fn state(&self, path: &str, body: Option<Value>) -> Value {
        let (status, answer) = self.ask(path, body);
        assert_eq!(status, 200, "{path}: {}", String::from_utf8_lossy(&answer));
        serde_json::from_slice(&answer).unwrap()
    }

    /// The line with which a request is refused.
    fn refused(&self, path: &str, body: Value) -> (u16, String) {
        let (status, answer) = self.ask(path, Some(body));
        let line = String::from_utf8(answer).unwrap();
        assert!(status >= 400 && line.lines().count() == 1, "{status}: {line}");
        (status, line)
    }

    fn end(self) -> Output {
        self.program.wait_with_output().unwrap()
    }

    fn interrupt(self) -> Output {
        interrupt(&self.program);
        self.end()
    }
}

/// The name of what is proposed.
fn which(state: &Value) -> Value {
    json!({ "clip": state["proposal"]["clip"], "picture": state["proposal"]["picture"] })
}

/// What is proposed, with these points.
fn corrected(state: &Value, points: &Value) -> Value {
    let mut body = which(state);
    body["points"] = points.clone();
    body
}

#[test]
fn what_was_found_is_told_as_json() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    heads::talker(root);
    let report = |words: &str| -> Value {
        let ran = run_with_programs(root, &words.split(' ').collect::<Vec<_>>());
        assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
        serde_json::from_slice(&ran.stdout).unwrap()
    };
    let found = report("landmarks talker.mp4 --labelled some.csv -o all.csv --json");
    let table = std::fs::read_to_string(root.join("all.csv")).unwrap();
    let confidence = |line: &str| line.split(',').nth(2).unwrap().parse::<f32>().unwrap();
    let all: Vec<f32> = table.lines().skip(1).map(confidence).collect();
    let with_points = all.iter().filter(|c| **c > 0.0).count();
    let unsure: Vec<usize> = (0..24).filter(|t| all[*t] > 0.0 && all[*t] < 0.6).collect();
    assert_eq!(
        (
            &found["output"],
            &found["clips"],
            &found["pictures"],
            &found["labelled"]
        ),
        (&json!("all.csv"), &json!(1), &json!(24), &json!(6))
    );
    assert_eq!(found["with_points"], json!(with_points));
    assert!(found["expected_error"].as_f64().unwrap() > 0.0);
    let told = found["unsure"].as_array().unwrap();
    let pictures: Vec<usize> = told
        .iter()
        .map(|of| of["picture"].as_u64().unwrap() as usize)
        .collect();
    assert_eq!(pictures, unsure);
    let rewritten = report("landmarks --labelled some.csv -o some.npz --json");
    assert_eq!(
        (&rewritten["labelled"], &rewritten["with_points"]),
        (&json!(6), &json!(6))
    );
    assert_eq!(
        (&rewritten["expected_error"], &rewritten["unsure"]),
        (&Value::Null, &json!([]))
    );
}

const WORDS: &str = "landmarks talker.mp4 --labelled some.csv -o all.npz --page labels.csv";

#[test]
fn what_is_accepted_is_kept_and_learnt() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let truth = heads::talker(root);
    let page = page(root, WORDS);
    let first = page.state("/state", None);
    assert_eq!((&first["labelled"], &first["pictures"]), (&json!(6), &json!(24)));
    assert!(first["expected"].as_f64().unwrap() > 0.0, "{first}");
    assert_eq!(first["proposal"]["size"], json!([heads::HEAD, heads::HEAD]));
    assert_eq!(first["proposal"]["groups"], json!(heads::GROUPS));
    let picture = first["proposal"]["picture"].as_u64().unwrap() as usize;
    assert!(!picture.is_multiple_of(4), "picture {picture} is labelled");
    let (status, jpeg) = page.ask(&format!("/picture?clip=talker&picture={picture}"), None);
    assert!(status == 200 && jpeg.starts_with(&[0xff, 0xd8, 0xff]), "{status}");

    // Nobody else may ask, and what cannot be is refused without a change.
    let evil = page.raw("/skip", Some(&which(&first).to_string()), "http://evil.example");
    assert_eq!(evil.0, 403);
    assert_eq!(page.raw("/state", None, "null").0, 403);
    let points = &first["proposal"]["points"];
    let mut far = points.clone();
    far[3] = json!([1e6, 10.0]);
    let (_, line) = page.refused("/accept", corrected(&first, &far));
    assert!(line.contains("point 3 at 1000000, 10 is far outside"), "{line}");
    let mut none = points.clone();
    none[3] = json!([null, 10.0]);
    page.refused("/accept", corrected(&first, &none));
    let mut short = points.clone();
    short.as_array_mut().unwrap().pop();
    let (_, line) = page.refused("/accept", corrected(&first, &short));
    assert!(line.contains("12 points; a picture has 13"), "{line}");
    let mut other = which(&first);
    other["picture"] = json!(0);
    let (status, line) = page.refused("/skip", other);
    assert!(status == 409 && line.contains("picture 0 of talker"), "{line}");
    assert_eq!(page.state("/state", None), first);
    assert!(!root.join("labels.csv").exists());

    // Corrected points are kept as they are, beside the old ones, and another picture is proposed.
    let right = json!(truth[picture]);
    let second = page.state("/accept", Some(corrected(&first, &right)));
    assert_eq!(second["labelled"], json!(7));
    assert_ne!(which(&second), which(&first));
    let kept = Landmarks::read(&root.join("labels.csv")).unwrap();
    assert_eq!(kept.labelled().len(), 7);
    // Tables have thousandths of a pixel.
    let off = |labels: &Landmarks, picture: usize| {
        let points = labels.picture("talker", picture).unwrap();
        let pairs = points.iter().zip(truth[picture].as_flattened());
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    };
    for known in [picture, 0, 20] {
        assert!(off(&kept, known) < 1e-3, "picture {known}: {}", off(&kept, known));
    }
    let third = page.state("/skip", Some(which(&second)));
    assert_eq!(third["labelled"], json!(7));
    assert!(which(&third) != which(&second) && which(&third) != which(&first));

    let done = page.state("/done", Some(json!({})));
    assert_eq!(done["done"], json!(true));
    let ended = page.end();
    assert!(
        ended.status.success(),
        "{}",
        String::from_utf8_lossy(&ended.stderr)
    );
    let all = Landmarks::read(&root.join("all.npz")).unwrap();
    assert_eq!(all.of("talker").unwrap().dim(), (24, 13, 2));
    assert!(off(&all, picture) < 1e-3);
}

#[test]
fn labels_are_not_lost_to_another_table_or_an_early_end() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    heads::talker(root);
    let before = std::fs::read(root.join("some.csv")).unwrap();
    std::fs::write(root.join("labels.csv"), &before).unwrap();
    let refuse = |words: &str| one_line(run_with_programs(root, &words.split(' ').collect::<Vec<_>>()));
    let line = refuse(WORDS);
    assert!(line.contains("labels.csv is there"), "{line}");
    let line = refuse("landmarks talker.mp4 --labelled some.csv -o a.csv --page a.csv");
    assert!(
        line.contains("a.csv cannot be the table of labels and the output"),
        "{line}"
    );
    let line = refuse("landmarks talker.mp4 --labelled some.csv -o all.npz --page labels.npz");
    assert!(line.contains("give it the ending .csv"), "{line}");
    assert_eq!(std::fs::read(root.join("labels.csv")).unwrap(), before);

    // Labels go on where they ended; Ctrl-C leaves what was accepted.
    let page = page(
        root,
        "landmarks talker.mp4 --labelled labels.csv -o all.npz --page labels.csv",
    );
    let state = page.state("/state", None);
    page.state("/accept", Some(corrected(&state, &state["proposal"]["points"])));
    let ended = page.interrupt();
    assert_eq!(ended.status.code(), Some(130));
    let kept = Landmarks::read(&root.join("labels.csv")).unwrap();
    assert_eq!(kept.labelled().len(), 7);
    assert!(!root.join("all.npz").exists());
}

/// One label is enough to begin with: nothing says then where a face is, and the furthest picture tells most.
#[test]
fn it_grows_from_a_single_label() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let truth = heads::talker(root);
    let table = std::fs::read_to_string(root.join("some.csv")).unwrap();
    let one: Vec<&str> = table.lines().take(2).collect();
    std::fs::write(root.join("one.csv"), one.join("\n")).unwrap();
    let page = page(
        root,
        "landmarks talker.mp4 --labelled one.csv -o all.npz --page labels.csv",
    );
    let mut state = page.state("/state", None);
    assert_eq!(
        (&state["labelled"], &state["expected"]),
        (&json!(1), &Value::Null)
    );
    assert_eq!(
        (&state["lost"], &state["proposal"]["confidence"]),
        (&json!(23), &json!(0.0))
    );
    assert_eq!(state["proposal"]["picture"], json!(23));
    for labelled in 2..5 {
        let picture = state["proposal"]["picture"].as_u64().unwrap() as usize;
        state = page.state("/accept", Some(corrected(&state, &json!(truth[picture]))));
        assert_eq!(state["labelled"], json!(labelled));
    }
    assert!(state["expected"].as_f64().unwrap() > 0.0);
    assert!(state["lost"].as_u64().unwrap() < 23, "{state}");
    page.interrupt();
}
