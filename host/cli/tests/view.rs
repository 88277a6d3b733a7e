//! `lipstream view` as a person starts it: what it prints, the page, frames over the WebSocket, Ctrl-C.
#![cfg(unix)]
mod common;

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use common::program::{interrupt, one_line, program, refuse, run_with_programs, succeed};
use lipstream_core::wire::{Hello, PROTOCOL};
use lipstream_live::event::{Announcement, Event};
use lipstream_live::recording::Recorder;
use serde_json::{Value, json};
use tungstenite::{Message, WebSocket};

/// A running `lipstream view`.
struct View {
    program: Child,
    lines: BufReader<ChildStdout>,
    /// HOST:PORT of its page.
    place: String,
}

fn view(arguments: &[&str]) -> View {
    let mut program = Command::new(program())
        .args(["view", "--port", "0"])
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(program.stdout.take().unwrap());
    let mut line = String::new();
    lines.read_line(&mut line).unwrap();
    let address = line
        .strip_prefix("open http://")
        .and_then(|rest| rest.split('/').next());
    let place = address
        .unwrap_or_else(|| panic!("no address in {line:?}"))
        .to_owned();
    assert!(line.ends_with("in a browser; Ctrl-C ends\n"), "{line}");
    View {
        program,
        lines,
        place,
    }
}

impl View {
    fn get(&self, path: &str) -> String {
        let mut line = TcpStream::connect(&self.place).unwrap();
        write!(
            line,
            "GET {path} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n\r\n",
            self.place
        )
        .unwrap();
        let mut answer = Vec::new();
        line.read_to_end(&mut answer).unwrap();
        String::from_utf8_lossy(&answer).into_owned()
    }

    fn socket(&self) -> WebSocket<TcpStream> {
        let line = TcpStream::connect(&self.place).unwrap();
        line.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let address = format!("ws://{}/live?as=json", self.place);
        tungstenite::client(address, line).unwrap().0
    }

    /// Presses Ctrl-C, and gives what it said on standard error.
    fn end(mut self) -> String {
        interrupt(&self.program);
        let began = Instant::now();
        let status = loop {
            match self.program.try_wait().unwrap() {
                Some(status) => break status,
                None => std::thread::sleep(Duration::from_millis(20)),
            }
            assert!(began.elapsed() < Duration::from_secs(10), "it does not end");
        };
        assert!(status.success(), "{status}");
        let mut said = String::new();
        self.program
            .stderr
            .take()
            .unwrap()
            .read_to_string(&mut said)
            .unwrap();
        said
    }
}

impl Drop for View {
    fn drop(&mut self) {
        let _ = self.program.kill();
    }
}

/// Messages up to the first that is wanted, which is the last.
fn until(socket: &mut WebSocket<TcpStream>, wanted: impl Fn(&Value) -> bool) -> Vec<Value> {
    let mut seen = Vec::new();
    loop {
        let Message::Text(text) = socket.read().unwrap() else {
            continue;
        };
        let value: Value = serde_json::from_str(&text).unwrap();
        let found = wanted(&value);
        seen.push(value);
        if found {
            return seen;
        }
    }
}

#[test]
fn speech_is_watched_recorded_and_sent_on() {
    let folder = tempfile::tempdir().unwrap();
    let [wav, stream, rows] = ["hello.wav", "a.stream", "a.csv"].map(|name| folder.path().join(name));
    let samples = common::hello();
    lipstream_media::sound::write(&wav, &samples[..32_000]).unwrap();
    let to = format!("csv:{}", rows.display());
    let arguments = [
        "--wav",
        wav.to_str().unwrap(),
        "--repeat",
        "--profile",
        "live",
        "--record",
        stream.to_str().unwrap(),
        "--to",
        &to,
    ];
    let view = view(&arguments);
    let page = view.get("/");
    assert!(
        page.starts_with("HTTP/1.1 200") && page.contains("<title>"),
        "{page}"
    );
    let mut socket = view.socket();
    // The mouth is there from the first hello on, which says so; before, the page would not ask.
    let mut seen = until(&mut socket, |value| value["type"] == "hello");
    assert!(view.get("/mouth").starts_with("HTTP/1.1 200"));
    seen.extend(until(&mut socket, |value| {
        value["type"] == "frame" && value["sequence"] == 150
    }));
    assert_eq!(seen[0]["type"], "hello");
    assert_eq!(
        (&seen[0]["profile"], &seen[0]["mouth"]),
        (&json!("live"), &json!(true))
    );
    let frame = seen.last().unwrap();
    assert_eq!(frame["parameters"].as_array().unwrap().len(), 30);
    assert!((0.0..=1.0).contains(&frame["gap"].as_f64().unwrap()));
    // The speech begins again, which is a new hello.
    until(&mut socket, |value| value["type"] == "hello");
    let said = view.end();
    assert!(said.contains("frames recorded"), "{said}");
    let rows = std::fs::read_to_string(rows).unwrap();
    assert!(rows.lines().next().unwrap().ends_with(",gap,width") && rows.lines().count() > 150);
    let said = succeed(folder.path(), &["convert", "a.stream", "-o", "b.csv"]);
    assert!(said.contains("b.csv"), "{said}");
}

#[test]
fn with_nothing_attached_the_demo_is_offered() {
    let mut view = view(&[]);
    let mut line = String::new();
    view.lines.read_line(&mut line).unwrap();
    assert!(
        line.starts_with("no device is attached: the page offers a demo"),
        "{line}"
    );
    let mut socket = view.socket();
    let seen = until(&mut socket, |value| value["type"] == "hello");
    assert_eq!(seen.last().unwrap()["can"], json!(["demo"]));
    socket.send(Message::text(r#"{"type":"demo"}"#)).unwrap();
    until(&mut socket, |value| {
        value["type"] == "frame" && value["sequence"] == 30
    });
    view.end();
}

#[test]
fn a_port_that_is_taken_and_a_sound_that_is_none_are_named() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let folder = tempfile::tempdir().unwrap();
    let said = refuse(folder.path(), &["view", "--port", &port]);
    assert!(said.contains(&port) && said.contains("--port 0"), "{said}");
    let said = refuse(folder.path(), &["view", "--wav", "no-such.wav", "--port", "0"]);
    assert!(said.contains("no-such.wav"), "{said}");
    if !cfg!(feature = "mic") {
        let said = refuse(folder.path(), &["view", "--mic", "--port", "0"]);
        assert!(said.contains("--features mic"), "{said}");
    }
}

/// What cannot be a face gets one line, before anything is served.
#[test]
fn a_background_that_is_none_and_a_jaw_that_cannot_be_live_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let wall = folder.path().join("wall.mp4");
    common::program::test_picture(&wall);
    let said = |words: &[&str]| {
        let all = [&["view", "--port", "0"], words].concat();
        one_line(run_with_programs(folder.path(), &all))
    };
    let shown = said(&["--background", "wall.mp4"]);
    assert!(shown.contains("no face found"), "{shown}");
    let shown = said(&["--background", "none.mp4"]);
    assert!(shown.contains("no such file"), "{shown}");
    let shown = said(&["--background", "wall.mp4", "--jaw", "sound"]);
    assert!(shown.contains("follow the mouth"), "{shown}");
    // A recorded stream of another model than the one that is to be drawn.
    let hello = Hello {
        protocol: PROTOCOL,
        model: 0x1234_abcd,
        rate_hz: 100,
        lag_samples: 0,
        visemes: 0,
        groups: Default::default(),
        scales: Default::default(),
    };
    let mut recorder = Recorder::create(&folder.path().join("other.stream")).unwrap();
    recorder
        .take(&Event::Hello(Arc::new(Announcement {
            source: String::new(),
            hello,
            profile: None,
            sound: false,
            running: true,
            opening: None,
        })))
        .unwrap();
    recorder.finish().unwrap();
    let shown = said(&["other.stream", "--background", "wall.mp4"]);
    assert!(
        shown.contains("1234abcd") && shown.contains("the shipped model"),
        "{shown}"
    );
}
