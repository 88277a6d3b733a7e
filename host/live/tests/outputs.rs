//! What other programs get, read by receivers that follow the published layouts.
mod common;

use std::net::UdpSocket;
use std::sync::Arc;
use std::time::Duration;

use common::{announcement, frame, timed, timed_of};
use lipstream::cues::ARKIT;
use lipstream::opening::OpeningReader;
use lipstream::phones::VISEMES;
use lipstream_live::event::Event;
use lipstream_live::hub::Hub;
use lipstream_live::outputs::{self, Csv, JsonLines, Output, Target};

/// Visemes by their place in the table.
const OPEN: usize = 1;
const ROUND: usize = 2;
const CLOSED: usize = 9;

/// A receiver, and the words of a target that reaches it.
fn receiver(words: impl Fn(u16) -> String) -> (UdpSocket, Box<dyn Output>) {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    let target: Target = words(socket.local_addr().unwrap().port()).parse().unwrap();
    let output = target.open().unwrap();
    (socket, output)
}

fn datagram(socket: &UdpSocket) -> Vec<u8> {
    let mut buffer = [0; 2048];
    let count = socket.recv(&mut buffer).unwrap();
    assert!(
        count <= 1472,
        "{count} bytes do not fit into one packet of a network"
    );
    buffer[..count].to_vec()
}

/// Takes bytes from the front.
struct Bytes(Vec<u8>);

impl Bytes {
    fn take(&mut self, count: usize) -> Vec<u8> {
        self.0.drain(..count).collect()
    }
    fn int(&mut self) -> i32 {
        i32::from_be_bytes(self.take(4).try_into().unwrap())
    }
    fn float(&mut self) -> f32 {
        f32::from_be_bytes(self.take(4).try_into().unwrap())
    }
    /// OSC: letters up to a zero, filled up to a multiple of four.
    fn osc_text(&mut self) -> String {
        let length = self.0.iter().position(|b| *b == 0).unwrap();
        let text = String::from_utf8(self.take(length)).unwrap();
        let zeros = self.take((length + 1).next_multiple_of(4) - length);
        assert!(zeros.iter().all(|b| *b == 0));
        text
    }
    /// A length, and as many letters.
    fn text(&mut self) -> String {
        let length = self.int() as usize;
        String::from_utf8(self.take(length)).unwrap()
    }
}

/// The clips of one frame, until they are to be shown.
fn vmc_frame(socket: &UdpSocket) -> Vec<(String, f32)> {
    let mut clips = Vec::new();
    loop {
        let mut bundle = Bytes(datagram(socket));
        assert_eq!(bundle.osc_text(), "#bundle");
        assert_eq!(bundle.take(8), [0, 0, 0, 0, 0, 0, 0, 1]);
        while !bundle.0.is_empty() {
            let length = bundle.int() as usize;
            let mut message = Bytes(bundle.take(length));
            let (address, types) = (message.osc_text(), message.osc_text());
            match (address.as_str(), types.as_str()) {
                ("/VMC/Ext/Blend/Val", ",sf") => clips.push((message.osc_text(), message.float())),
                ("/VMC/Ext/Blend/Apply", ",") => {
                    assert!(bundle.0.is_empty() && message.0.is_empty());
                    return clips;
                }
                other => panic!("{other:?}"),
            }
            assert!(message.0.is_empty());
        }
    }
}

#[test]
fn avatars_get_vowels_and_shapes() {
    let (socket, mut output) = receiver(|port| format!("vmc://127.0.0.1:{port}"));
    let weight = |clips: &[(String, f32)], name: &str| {
        let found: Vec<f32> = clips.iter().filter(|c| c.0 == name).map(|c| c.1).collect();
        assert_eq!(found.len(), 1, "{name}");
        found[0]
    };
    output.event(&timed(0, OPEN)).unwrap();
    let open = vmc_frame(&socket);
    output.event(&timed(1, ROUND)).unwrap();
    let round = vmc_frame(&socket);
    output.event(&timed(2, CLOSED)).unwrap();
    let closed = vmc_frame(&socket);
    assert!(weight(&open, "jawOpen") > 0.4 && weight(&closed, "jawOpen") < 0.1);
    assert!(weight(&open, "A") > weight(&round, "A") && weight(&round, "U") > weight(&open, "U"));
    assert!(weight(&round, "mouthPucker") > weight(&open, "mouthPucker"));
    assert!(
        ["A", "I", "U", "E", "O"]
            .iter()
            .all(|vowel| weight(&closed, vowel) == 0.0)
    );
    // Eyes and brows are somebody else's.
    assert!(
        open.iter()
            .all(|(name, _)| !name.starts_with("eye") && !name.starts_with("brow"))
    );
    assert!(
        open.iter()
            .all(|(name, w)| (0.0..=1.0).contains(w) && (name.len() == 1 || ARKIT.contains(&name.as_str())))
    );
}

#[test]
fn unreal_gets_61_values() {
    let (socket, mut output) = receiver(|port| format!("livelink://127.0.0.1:{port}"));
    for (hop, viseme) in [(7, OPEN), (8, CLOSED)] {
        output.event(&timed(hop, viseme)).unwrap();
        let mut bytes = Bytes(datagram(&socket));
        assert_eq!(bytes.take(1), [6]);
        assert_eq!(bytes.text().len(), 36);
        assert_eq!(bytes.text(), "lipstream");
        assert_eq!((bytes.int(), bytes.float()), (hop as i32, 0.0));
        assert_eq!((bytes.int(), bytes.int()), (100, 1));
        assert_eq!(bytes.take(1), [61]);
        let values: Vec<f32> = (0..61).map(|_| bytes.float()).collect();
        assert!(bytes.0.is_empty());
        let jaw = values[ARKIT.iter().position(|n| *n == "jawOpen").unwrap()];
        assert_eq!(ARKIT[17], "jawOpen");
        assert_eq!(jaw > 0.4, viseme == OPEN, "{jaw}");
        assert!(values[52..].iter().all(|v| *v == 0.0));
    }
}

#[test]
fn shows_get_channels() {
    let (socket, mut output) = receiver(|port| format!("e131://127.0.0.1:{port}/513"));
    for sequence in 0..3u8 {
        output.event(&timed(u32::from(sequence), CLOSED)).unwrap();
        let packet = datagram(&socket);
        let length = |at: usize| {
            let flags_and_length = u16::from_be_bytes([packet[at], packet[at + 1]]);
            assert_eq!(flags_and_length >> 12, 7);
            usize::from(flags_and_length & 0xfff)
        };
        // ANSI E1.31-2018, tables 4-1 to 7-1, by their octets.
        assert_eq!(packet[..16], *b"\0\x10\0\0ASC-E1.17\0\0\0");
        assert_eq!(length(16), packet.len() - 16);
        assert_eq!(packet[18..22], [0, 0, 0, 4]);
        assert_eq!(length(38), packet.len() - 38);
        assert_eq!(packet[40..44], [0, 0, 0, 2]);
        assert!(packet[44..108].starts_with(b"lipstream\0"));
        assert_eq!(packet[108..113], [100, 0, 0, sequence, 0]);
        assert_eq!(packet[113..115], 513u16.to_be_bytes());
        assert_eq!(length(115), packet.len() - 115);
        assert_eq!(packet[117..123], [2, 0xa1, 0, 0, 0, 1]);
        let values = usize::from(u16::from_be_bytes([packet[123], packet[124]]));
        assert_eq!((values, packet.len()), (1 + 3 + VISEMES.len() + 2, 125 + values));
        let channels = &packet[126..];
        assert_eq!(packet[125], 0, "the start code");
        assert!(channels[0] < 30 && channels[2] > 50, "{channels:?}");
        assert_eq!(channels[3 + CLOSED], 255);
        let visemes = &channels[3..][..VISEMES.len()];
        assert_eq!(visemes.iter().filter(|c| **c > 0).count(), 1);
        // This device's mouth is not known.
        assert_eq!(channels[3 + VISEMES.len()..], [0, 128]);
    }
}

#[test]
fn lines_are_read_back() {
    let mut text = Vec::new();
    let mut lines = JsonLines::new(&mut text);
    lines.event(&Event::Hello(announcement())).unwrap();
    lines.event(&timed(5, CLOSED)).unwrap();
    lines.event(&Event::End("over".into())).unwrap();
    let values: Vec<serde_json::Value> = String::from_utf8(text)
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(values[0]["model"], "1234abcd");
    assert_eq!(values[0]["visemes"][9]["name"], "bi");
    assert_eq!(values[1]["time_s"], 0.0625);
    assert_eq!(values[1]["parameters"], serde_json::json!([2.5, -6.0]));
    assert_eq!(values[1]["visemes"][CLOSED], 1.0);
    assert_eq!(values[2]["text"], "over");

    let mut text = Vec::new();
    let mut rows = Csv::new(&mut text);
    rows.event(&Event::Hello(announcement())).unwrap();
    rows.event(&timed(5, CLOSED)).unwrap();
    // The same device again has the same columns.
    rows.event(&Event::Hello(announcement())).unwrap();
    let text = String::from_utf8(text).unwrap();
    let rows: Vec<&str> = text.lines().collect();
    assert_eq!(rows.len(), 2);
    assert!(rows[0].starts_with("time_s,sample,p1,p2,sip,lr1"));
    assert_eq!(
        rows[1],
        "0.0625,1000,2.5,-6,0.000,0.000,0.000,0.000,0.000,0.000,0.000,0.000,0.000,1.000,0.000,0.000,0.000"
    );
}

/// Where the device's mouth is known, shapes open as far as it does, whatever the visemes say, and gap and width are sent.
#[test]
fn a_known_mouth_opens_shapes_as_far_as_it_is_open() {
    let reader = Arc::new(OpeningReader::shipped().unwrap().unwrap());
    let mut said = (*announcement()).clone();
    said.opening = Some(Arc::clone(&reader));
    said.hello.groups[0].size = 30;
    said.hello.scales = (0..30).map(|_| 1.0).collect();
    let said = Arc::new(said);
    // Along the first eigenmouth, which opens and closes.
    let mouth = |amount: i16| {
        let mut frame = frame(1, OPEN);
        frame.parameters = (0..30).map(|k| if k == 0 { amount } else { 0 }).collect();
        timed_of(Arc::clone(&said), frame)
    };
    let mut seen = Vec::new();
    for amount in [-3000, -1000, 0, 1000, 3000] {
        let event = mouth(amount);
        let Event::Frame(timed) = &event else { panic!() };
        let opening = timed.opening().unwrap();
        let (socket, mut output) = receiver(|port| format!("e131://127.0.0.1:{port}/1"));
        output.event(&event).unwrap();
        let packet = datagram(&socket);
        let channels = &packet[126..];
        assert_eq!(channels[3 + VISEMES.len()], (255.0 * opening.gap).round() as u8);
        assert_eq!(
            channels[4 + VISEMES.len()],
            (127.5 + 127.5 * opening.width).round() as u8
        );
        let value = outputs::json(&event).unwrap();
        assert!((value["gap"].as_f64().unwrap() - f64::from(opening.gap)).abs() < 1e-6);
        let mut text = Vec::new();
        let mut rows = Csv::new(&mut text);
        rows.event(&Event::Hello(Arc::clone(&said))).unwrap();
        rows.event(&event).unwrap();
        let text = String::from_utf8(text).unwrap();
        assert!(text.lines().next().unwrap().ends_with(",gap,width"));
        let end = format!(",{:.3},{:.3}", opening.gap, opening.width);
        assert!(text.trim_end().ends_with(&end), "{text}");
        seen.push((opening.gap, channels[0]));
    }
    println!("{seen:?}");
    // The jaw follows the gap: closed at none, as far as in the widest vowel at most.
    seen.sort_by(|a, b| a.0.total_cmp(&b.0));
    assert!(seen.is_sorted_by_key(|(_, jaw)| *jaw));
    assert!(seen[0].0 < 0.1 && seen[0].1 < 15 && seen[4].0 > 0.9 && seen[4].1 > 120);
}

/// An output that fails ends with a word, and nobody else is disturbed.
#[test]
fn an_output_that_fails_says_so_once() {
    struct Full;
    impl Output for Full {
        fn event(&mut self, event: &Event) -> std::io::Result<()> {
            match event {
                Event::Frame(_) => Err(std::io::Error::other("the disk is full")),
                _ => Ok(()),
            }
        }
    }
    let hub = Arc::new(Hub::default());
    let (_, mut watch) = hub.watch();
    let thread = outputs::start(&hub, "a.csv", Box::new(Full));
    for hop in 0..5 {
        hub.send(timed(hop, OPEN));
    }
    let seen = common::until(&mut watch, |event| common::notice(event).is_some());
    assert_eq!(
        common::notice(seen.last().unwrap()),
        Some("a.csv: the disk is full")
    );
    thread.join().unwrap();
}
