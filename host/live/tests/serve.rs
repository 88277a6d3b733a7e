//! The page's server, as a browser and as somebody who should not be there.
mod common;

use std::io::{Read as _, Write as _};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpStream};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use common::{announcement, timed};
use lipstream::engine::Engine;
use lipstream::mouth::MouthSpace;
use lipstream::render::drawn;
use lipstream::render::face::{FaceSettings, LiveFace, person};
use lipstream::shipped;
use lipstream::tensors::Tensors;
use lipstream_live::clock::Clock;
use lipstream_live::desk::{Desk, Equipment, Mouth};
use lipstream_live::event::{Announcement, Event};
use lipstream_live::face::Face;
use lipstream_live::hub::Hub;
use lipstream_live::recording::Recording;
use lipstream_live::serve::{Place, Server};
use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::{Message, WebSocket};

fn desk(folder: &Path) -> Arc<Desk> {
    desk_with(folder, |_| None)
}

/// A desk with what is made of its hub.
fn desk_with(folder: &Path, face: impl FnOnce(&Arc<Hub>) -> Option<Face>) -> Arc<Desk> {
    let engine = Arc::new(Engine::shipped());
    let id = engine.model_id().unwrap();
    let tensors = Tensors::parse(shipped::MODEL, "the shipped model").unwrap();
    let hub = Arc::new(Hub::default());
    let face = face(&hub);
    Arc::new(Desk::new(
        hub,
        Equipment {
            clock: Clock::start(),
            mouths: [Mouth::new(id, &MouthSpace::load(&tensors).unwrap())].into(),
            folder: folder.to_owned(),
            engine,
            face,
        },
    ))
}

fn serve(desk: &Arc<Desk>, address: IpAddr) -> Server {
    Server::start(Arc::clone(desk), &Place { address, port: 0 }).unwrap()
}

const LOOPBACK: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);

/// Status, head and body of an answer to a request with these lines.
fn ask(address: SocketAddr, path: &str, lines: &[&str]) -> (u16, String, Vec<u8>) {
    let mut line = TcpStream::connect(address).unwrap();
    let request = format!(
        "GET {path} HTTP/1.1\r\n{}\r\nConnection: close\r\n\r\n",
        lines.join("\r\n")
    );
    line.write_all(request.as_bytes()).unwrap();
    let mut answer = Vec::new();
    line.read_to_end(&mut answer).unwrap();
    let end = answer.windows(4).position(|w| w == b"\r\n\r\n").unwrap();
    let head = String::from_utf8(answer[..end].to_vec()).unwrap();
    let status = head.split(' ').nth(1).unwrap().parse().unwrap();
    (status, head.to_lowercase(), answer[end + 4..].to_vec())
}

type Socket = WebSocket<TcpStream>;

/// A WebSocket, or the status of the refusal.
fn live(address: SocketAddr, query: &str, origin: Option<&str>) -> Result<Socket, u16> {
    let mut request = format!("ws://{address}/live{query}")
        .into_client_request()
        .unwrap();
    if let Some(origin) = origin {
        request.headers_mut().insert("origin", origin.parse().unwrap());
    }
    let line = TcpStream::connect(address).unwrap();
    line.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    match tungstenite::client(request, line) {
        Ok((socket, _)) => Ok(socket),
        Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(answer))) => {
            Err(answer.status().as_u16())
        }
        Err(error) => panic!("{error}"),
    }
}

fn text(socket: &mut Socket) -> Value {
    loop {
        if let Message::Text(text) = socket.read().unwrap() {
            return serde_json::from_str(&text).unwrap();
        }
    }
}

/// The next text of a kind.
fn text_of(socket: &mut Socket, kind: &str) -> Value {
    loop {
        let value = text(socket);
        if value["type"] == kind {
            return value;
        }
    }
}

#[test]
fn the_page_is_served_and_may_load_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let desk = desk(folder.path());
    let server = serve(&desk, LOOPBACK);
    let host = format!("Host: {}", server.address());
    let (status, head, page) = ask(server.address(), "/", &[&host]);
    let page = String::from_utf8(page).unwrap();
    assert_eq!(status, 200);
    assert!(head.contains("content-security-policy: default-src 'self'") && head.contains("no-store"));
    // Every file that the page and its modules name is there.
    let mut names: Vec<String> = page
        .split('"')
        .filter(|word| {
            [".js", ".css", ".svg"]
                .iter()
                .any(|ending| word.ends_with(ending))
        })
        .map(|name| name.trim_start_matches('/').to_owned())
        .collect();
    assert!(names.len() >= 3, "{names:?}");
    let mut done = 0;
    while done < names.len() {
        let name = names[done].clone();
        done += 1;
        let (status, _, content) = ask(server.address(), &format!("/{name}"), &[&host]);
        assert_eq!(status, 200, "{name}");
        let content = String::from_utf8(content).unwrap();
        for import in content.split("from \"./").skip(1) {
            let import = import.split('"').next().unwrap().to_owned();
            if !names.contains(&import) {
                names.push(import);
            }
        }
        assert!(!content.contains("https://"), "{name} asks somebody else");
    }
    assert!(names.iter().any(|n| n == "mouth.js"), "{names:?}");
    assert_eq!(ask(server.address(), "/nothing", &[&host]).0, 404);
    // Nobody speaks, so there is nothing to draw.
    assert_eq!(ask(server.address(), "/mouth", &[&host]).0, 404);
}

#[test]
fn other_pages_and_other_names_get_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let desk = desk(folder.path());
    let server = serve(&desk, LOOPBACK);
    let address = server.address();
    let port = address.port();
    // A name that somebody has pointed at this computer.
    for host in ["evil.example", &format!("evil.example:{port}"), "127.0.0.1", ""] {
        assert_eq!(ask(address, "/", &[&format!("Host: {host}")]).0, 403, "{host:?}");
    }
    let localhost = format!("Host: localhost:{port}");
    assert_eq!(ask(address, "/", &[&localhost]).0, 200);
    let other = ["Origin: http://evil.example", &localhost];
    assert_eq!(ask(address, "/mouth", &other).0, 403);
    assert_eq!(live(address, "", Some("http://evil.example")).err(), Some(403));
    assert_eq!(live(address, "", Some("null")).err(), Some(403));
    assert!(live(address, "", Some(&format!("http://{address}"))).is_ok());
    assert!(live(address, "", None).is_ok());
}

#[test]
fn others_on_the_network_need_the_token() {
    let folder = tempfile::tempdir().unwrap();
    let desk = desk(folder.path());
    let server = serve(&desk, IpAddr::V4(Ipv4Addr::UNSPECIFIED));
    let address = SocketAddr::new(LOOPBACK, server.address().port());
    let url = server.url();
    let token = url.split("token=").nth(1).unwrap();
    assert!(
        token.len() == 32 && token.bytes().all(|b| b.is_ascii_hexdigit()),
        "{token}"
    );
    assert_ne!(
        serve(&desk, IpAddr::V4(Ipv4Addr::UNSPECIFIED))
            .url()
            .split("token=")
            .nth(1),
        Some(token)
    );
    assert_eq!(live(address, "", None).err(), Some(401));
    assert_eq!(live(address, "?token=guessed", None).err(), Some(401));
    assert_eq!(ask(address, "/mouth", &["Host: box"]).0, 401);
    let mut socket = live(address, &format!("?token={token}&as=json"), None).unwrap();
    assert_eq!(text(&mut socket)["source"], "nothing is attached");
    assert_eq!(
        ask(address, &format!("/mouth?token={token}"), &["Host: box"]).0,
        404
    );
}

#[test]
fn frames_come_as_bytes_and_as_text() {
    let folder = tempfile::tempdir().unwrap();
    let desk = desk(folder.path());
    let server = serve(&desk, LOOPBACK);
    let mut bytes = live(server.address(), "", None).unwrap();
    let mut json = live(server.address(), "?as=json", None).unwrap();
    // Both watch now.
    assert_eq!(text(&mut bytes)["can"], json!(["demo"]));
    assert_eq!(text(&mut json)["can"], json!(["demo"]));
    desk.hub().send(Event::Hello(announcement()));
    desk.hub().send(timed(5, 9));
    let hello = text_of(&mut json, "hello");
    assert_eq!(
        (&hello["model"], &hello["mouth"]),
        (&json!("1234abcd"), &json!(false))
    );
    let frame = text_of(&mut json, "frame");
    assert_eq!(
        (&frame["sample"], &frame["parameters"]),
        (&json!(1000), &json!([2.5, -6.0]))
    );
    let Message::Binary(frame) = (loop {
        let message = bytes.read().unwrap();
        if message.is_binary() {
            break message;
        }
    }) else {
        unreachable!()
    };
    assert_eq!(frame.len(), 32 + 2 * 4 + 13);
    assert_eq!(frame[..8], [1, 13, 2, 0, 5, 0, 0, 0]);
    let float = |at: usize| f64::from_le_bytes(frame[at..at + 8].try_into().unwrap());
    assert_eq!((float(8), float(16)), (1000.0, 12.5));
    assert!(float(24).is_nan());
    let parameter = |k: usize| f32::from_le_bytes(frame[32 + 4 * k..36 + 4 * k].try_into().unwrap());
    assert_eq!((parameter(0), parameter(1)), (2.5, -6.0));
    assert_eq!(frame[40 + 9], 255);
    // One who comes later is told who speaks.
    let mut late = live(server.address(), "?as=json", None).unwrap();
    assert_eq!(text_of(&mut late, "hello")["model"], "1234abcd");
}

#[test]
fn what_a_page_asks_for_is_done() {
    let folder = tempfile::tempdir().unwrap();
    let desk = desk(folder.path());
    let server = serve(&desk, LOOPBACK);
    let mut socket = live(server.address(), "?as=json", None).unwrap();
    let say = |socket: &mut Socket, value: Value| socket.send(Message::text(value.to_string())).unwrap();
    text_of(&mut socket, "hello");
    say(&mut socket, json!({ "type": "ping", "t": 7.5 }));
    let pong = text_of(&mut socket, "pong");
    assert!(pong["t"] == 7.5 && pong["now_ms"].as_f64().unwrap() > 0.0);
    // Words that are none change nothing.
    say(&mut socket, json!({ "type": "reboot" }));
    socket.send(Message::text("{")).unwrap();
    say(&mut socket, json!({ "type": "demo" }));
    let hello = text_of(&mut socket, "hello");
    assert_eq!(
        (&hello["mouth"], &hello["sound"], &hello["lag_samples"]),
        (&json!(true), &json!(true), &json!(1160))
    );
    assert_eq!(hello["can"], json!(["start", "stop", "profile", "record"]));
    let host = format!("Host: {}", server.address());
    let (status, _, mouth) = ask(server.address(), "/mouth", &[&host]);
    let length = u32::from_le_bytes(mouth[..4].try_into().unwrap()) as usize;
    let about: Value = serde_json::from_slice(&mouth[4..4 + length]).unwrap();
    assert_eq!(
        (status, &about["width"], &about["size"]),
        (200, &json!(64), &json!(30))
    );
    assert_eq!(
        mouth.len(),
        (4 + length).next_multiple_of(4) + 4 * 31 * 64 * 48 * 3
    );

    say(&mut socket, json!({ "type": "profile", "profile": "live" }));
    let hello = text_of(&mut socket, "hello");
    assert_eq!(
        (&hello["profile"], &hello["lag_samples"]),
        (&json!("live"), &json!(680))
    );

    say(&mut socket, json!({ "type": "record", "on": true }));
    assert_eq!(text_of(&mut socket, "recording")["name"], "mouth-001.stream");
    for _ in 0..30 {
        text_of(&mut socket, "frame");
    }
    say(&mut socket, json!({ "type": "record", "on": false }));
    assert_eq!(text_of(&mut socket, "recording")["name"], Value::Null);
    let mut recording = Recording::open(&folder.path().join("mouth-001.stream")).unwrap();
    let played = recording
        .play(|_, _| Ok::<_, lipstream_live::recording::RecordingError>(()))
        .unwrap();
    assert!(played.frames >= 25 && played.between == 0, "{played:?}");
    assert!(folder.path().join("mouth-001.wav").is_file());
}

/// One that takes nothing is dropped, and nobody waits for it; one that sends too much is dropped too.
#[test]
fn the_slow_and_the_loud_are_dropped() {
    let folder = tempfile::tempdir().unwrap();
    let desk = desk(folder.path());
    let server = serve(&desk, LOOPBACK);
    let mut loud = live(server.address(), "", None).unwrap();
    text_of(&mut loud, "hello");
    loud.send(Message::text("x".repeat(5000))).unwrap();
    let ended = (0..100).any(|_| loud.read().is_err());
    assert!(ended, "a message of 5000 bytes is too long");

    let slow = live(server.address(), "?as=json", None).unwrap();
    let began = Instant::now();
    while desk.hub().watchers() == 0 && began.elapsed() < Duration::from_secs(5) {
        std::thread::sleep(Duration::from_millis(2));
    }
    desk.hub().send(Event::Hello(announcement()));
    let began = Instant::now();
    let mut sent = 0;
    while desk.hub().watchers() > 0 {
        assert!(
            began.elapsed() < Duration::from_secs(60),
            "it is still there after {sent} frames"
        );
        for _ in 0..200 {
            desk.hub().send(timed(sent, 0));
            sent += 1;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    drop(slow);
    // There is room for 32 and no more.
    let watchers: Vec<Socket> = (0..32)
        .map(|_| live(server.address(), "", None).unwrap())
        .collect();
    let began = Instant::now();
    while desk.hub().watchers() < 32 && began.elapsed() < Duration::from_secs(5) {
        std::thread::sleep(Duration::from_millis(2));
    }
    assert_eq!(live(server.address(), "", None).err(), Some(503));
    drop(watchers);
}

/// A desk with a face that the model of [`announcement`] moves.
fn desk_with_face(folder: &Path) -> Arc<Desk> {
    desk_with(folder, |hub| {
        let settings = FaceSettings {
            noise: Some(0.0),
            ..FaceSettings::default()
        };
        let face = LiveFace::new(person::recording(60, 0.0, 1.0), drawn::space(2), &settings).unwrap();
        Some(Face::start(hub, announcement().hello.model, face))
    })
}

/// Says something, and waits until it has been heard.
fn say_and_wait(socket: &mut Socket, value: &Value) -> Vec<Vec<u8>> {
    socket.send(Message::text(value.to_string())).unwrap();
    pictures_until_pong(socket)
}

/// The pictures of the face that come before the answer to a ping.
fn pictures_until_pong(socket: &mut Socket) -> Vec<Vec<u8>> {
    let ping = json!({ "type": "ping", "t": 0 });
    socket.send(Message::text(ping.to_string())).unwrap();
    let mut pictures = Vec::new();
    loop {
        match socket.read().unwrap() {
            Message::Binary(bytes) if bytes[0] == 3 => pictures.push(bytes.to_vec()),
            Message::Text(text) if text.contains("pong") => return pictures,
            _ => {}
        }
    }
}

/// Frames of these hops, as quick as a device would say them twice over; gives the pictures that came meanwhile.
fn speak(desk: &Desk, socket: &mut Socket, hops: std::ops::Range<u32>) -> Vec<Vec<u8>> {
    let mut pictures = Vec::new();
    for hop in hops {
        desk.hub().send(timed(hop, 0));
        std::thread::sleep(Duration::from_millis(5));
        if hop % 8 == 0 {
            pictures.extend(pictures_until_pong(socket));
        }
    }
    // What was due is drawn.
    std::thread::sleep(Duration::from_millis(300));
    pictures.extend(pictures_until_pong(socket));
    pictures
}

#[test]
fn a_face_is_drawn_for_those_who_look_and_waits_for_nobody() {
    let folder = tempfile::tempdir().unwrap();
    let desk = desk_with_face(folder.path());
    let server = serve(&desk, LOOPBACK);
    let mut socket = live(server.address(), "", None).unwrap();
    text_of(&mut socket, "hello");
    desk.hub().send(Event::Hello(announcement()));
    let hello = text_of(&mut socket, "hello");
    assert_eq!(hello["face"], json!({ "width": 128, "height": 112, "fps": 25 }));
    // Nobody has asked: nothing has been drawn.
    assert_eq!(speak(&desk, &mut socket, 0..40).len(), 0);
    let face = desk.face(announcement().hello.model).unwrap();
    assert!(face.watch().borrow().is_none());

    // One who does not say that it has seen them gets three.
    say_and_wait(&mut socket, &json!({ "type": "face", "on": true }));
    let pictures = speak(&desk, &mut socket, 40..120);
    assert_eq!(pictures.len(), 3);
    let number = |of: &[u8]| u32::from_le_bytes(of[4..8].try_into().unwrap());
    for picture in &pictures {
        let float = |at: usize| f64::from_le_bytes(picture[at..at + 8].try_into().unwrap());
        assert_eq!(float(8), (f64::from(number(picture)) + 0.5) * 640.0);
        assert!(float(16) == 12.5 && float(24).is_nan());
        assert!(picture[32..].starts_with(&[0xff, 0xd8]) && picture.ends_with(&[0xff, 0xd9]));
        assert!(picture.windows(10).any(|words| words == b"Synthetic:"));
    }
    assert!(pictures.is_sorted_by_key(|picture| number(picture)));
    // When it has seen one, it gets the newest, whatever it has lost in between.
    let next = say_and_wait(&mut socket, &json!({ "type": "seen" }));
    let newest = match next.last() {
        Some(picture) => number(picture),
        None => number(&speak(&desk, &mut socket, 120..121)[0]),
    };
    assert!(newest > number(&pictures[2]) + 5, "{newest}");
    // Who looks away gets none.
    say_and_wait(&mut socket, &json!({ "type": "face", "on": false }));
    assert_eq!(speak(&desk, &mut socket, 121..160).len(), 0);
}

#[test]
fn a_face_of_another_model_is_not_drawn_and_that_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let desk = desk_with_face(folder.path());
    let server = serve(&desk, LOOPBACK);
    let mut socket = live(server.address(), "", None).unwrap();
    text_of(&mut socket, "hello");
    let mut other = Announcement::clone(&announcement());
    other.hello.model = 7;
    desk.hub().send(Event::Hello(Arc::new(other)));
    assert_eq!(text_of(&mut socket, "hello")["face"], Value::Null);
    let said = text_of(&mut socket, "notice");
    let words = said["text"].as_str().unwrap();
    assert!(
        words.contains("00000007") && words.contains("1234abcd"),
        "{words}"
    );
    say_and_wait(&mut socket, &json!({ "type": "face", "on": true }));
    assert_eq!(speak(&desk, &mut socket, 0..40).len(), 0);
}
