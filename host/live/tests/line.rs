//! Devices on a line that is not as it should be: a pseudo-terminal is the serial line, or a TCP connection where there are none, and this test
//! is the device.
mod common;
#[cfg(unix)]
mod terminal;

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::time::Duration;

use common::{bytes, frame, hello, notice, until};
use lipstream_core::wire::{Notice, Receiver, Status, ToDevice, ToHost};
use lipstream_live::address::Address;
use lipstream_live::clock::Clock;
use lipstream_live::driver::{Driver, Setup, Source};
use lipstream_live::event::{Command, Event};
use lipstream_live::feed::Speech;
use lipstream_live::hub::{Hub, Watch};

/// The device's end of a line that can be pulled out and plugged in again.
trait Socket {
    /// Where the host finds it.
    fn address(&self) -> Address;

    /// Waits for the host.
    fn plug(&mut self) -> Box<dyn Plug>;
}

/// Both ways of a line that is plugged in; dropped, it is pulled out.
trait Plug: Read + Write {}

impl Plug for TcpStream {}

impl Socket for TcpListener {
    fn address(&self) -> Address {
        Address::Tcp(self.local_addr().unwrap().to_string())
    }

    fn plug(&mut self) -> Box<dyn Plug> {
        let (line, _) = self.accept().unwrap();
        line.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        Box::new(line)
    }
}

/// A device that is this test, and the driver that has come to it.
struct Bench {
    socket: Box<dyn Socket>,
    line: Option<Box<dyn Plug>>,
    driver: Driver,
    watch: Watch,
}

fn bench(speech: Option<Speech>) -> Bench {
    #[cfg(unix)]
    let socket = Box::new(terminal::Terminal::new());
    #[cfg(not(unix))]
    let socket = Box::new(TcpListener::bind("127.0.0.1:0").unwrap());
    bench_on(socket, speech)
}

fn bench_on(mut socket: Box<dyn Socket>, speech: Option<Speech>) -> Bench {
    let hub = Arc::new(Hub::default());
    let (_, watch) = hub.watch();
    let driver = Driver::start(Setup {
        source: Source::Line(socket.address()),
        speech,
        repeat: false,
        profile: None,
        hub,
        clock: Clock::start(),
        mouths: Arc::default(),
    });
    Bench {
        line: Some(socket.plug()),
        socket,
        driver,
        watch,
    }
}

impl Bench {
    fn say(&mut self, message: &ToHost) {
        self.say_bytes(&bytes(message));
    }

    fn say_bytes(&mut self, bytes: &[u8]) {
        self.line.as_mut().unwrap().write_all(bytes).unwrap();
    }

    fn hear(&mut self, buffer: &mut [u8]) -> usize {
        self.line.as_mut().unwrap().read(buffer).unwrap()
    }

    fn frames(&mut self, hops: std::ops::Range<u32>) {
        for hop in hops {
            self.say(&ToHost::Frame(frame(hop, 0)));
        }
    }

    /// Events up to the frame of a hop.
    fn until_frame(&mut self, hop: u32) -> Vec<Event> {
        until(
            &mut self.watch,
            |event| matches!(event, Event::Frame(f) if f.frame.sequence == hop),
        )
    }

    /// Events up to a report with these losses: frames, damaged, unknown.
    fn until_losses(&mut self, want: (u64, u64, u64)) {
        let mut last = (0, 0, 0);
        until(&mut self.watch, |event| {
            if let Event::Status(health) = event {
                last = (health.losses.frames, health.losses.damaged, health.losses.unknown);
            }
            last == want
        });
    }
}

fn samples(events: &[Event]) -> Vec<u64> {
    events
        .iter()
        .filter_map(|event| match event {
            Event::Frame(timed) => Some(timed.sample),
            _ => None,
        })
        .collect()
}

#[test]
fn exactly_the_damaged_frames_are_lost() {
    only_the_damaged_are_lost(bench(None));
}

#[test]
fn exactly_the_damaged_frames_are_lost_over_tcp() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    only_the_damaged_are_lost(bench_on(Box::new(listener), None));
}

fn only_the_damaged_are_lost(mut bench: Bench) {
    bench.say(&ToHost::Hello(hello()));
    let mut line = Vec::new();
    let whole = |hop: u32| bytes(&ToHost::Frame(frame(hop, 3)));
    for hop in 0..200u32 {
        let mut message = whole(hop);
        match hop {
            // One bit, a byte lost, a byte doubled, cut in the middle.
            20 => message[7] ^= 0x10,
            40 => drop(message.remove(5)),
            60 => message.insert(9, message[9]),
            80 => message.truncate(6),
            // Frames that never were sent, and a doubled one.
            100..105 => message.clear(),
            120 => message = whole(119),
            _ => {}
        }
        if hop == 80 {
            // The next frame is lost with it where no zero stands between them.
            message.push(0);
        }
        line.extend(message);
        if hop == 140 {
            // Garbage between two frames, and a flood of it.
            line.extend([1, 2, 3, 0]);
            line.extend(std::iter::repeat_n(0x55, 100_000));
            line.push(0);
        }
    }
    // Cut anywhere.
    for piece in line.chunks(613) {
        bench.say_bytes(piece);
    }
    let events = bench.until_frame(199);
    let lost = [20u64, 40, 60, 80, 100, 101, 102, 103, 104, 120];
    let mut want: Vec<u64> = (0..200)
        .filter(|hop| !lost.contains(hop))
        .map(|hop| 160 * hop + 200)
        .collect();
    // The doubled frame comes twice: a step back, which is a run that begins anew at its sample.
    want.insert(
        want.iter().position(|s| *s == 160 * 119 + 200).unwrap(),
        160 * 119 + 200,
    );
    assert_eq!(samples(&events), want);
    // Damaged: five on the line (bit, lost, doubled, cut, and two stretches of garbage).
    bench.until_losses((10, 6, 0));
}

#[test]
fn a_device_that_is_pulled_out_comes_back() {
    let mut bench = bench(None);
    bench.say(&ToHost::Hello(hello()));
    bench.frames(0..10);
    bench.until_frame(9);
    // In the middle of a frame.
    bench.say_bytes(&bytes(&ToHost::Frame(frame(10, 0)))[..8]);
    bench.line = None;
    let events = until(&mut bench.watch, |event| notice(event).is_some());
    let text = notice(events.last().unwrap()).unwrap();
    assert!(
        text.contains("is gone") && text.contains("waiting for it"),
        "{text}"
    );

    bench.line = Some(bench.socket.plug());
    let events = until(&mut bench.watch, |event| notice(event).is_some());
    assert!(notice(events.last().unwrap()).unwrap().contains("is back"));
    bench.say(&ToHost::Hello(hello()));
    bench.frames(0..5);
    let events = bench.until_frame(4);
    assert!(
        events.iter().any(|e| matches!(e, Event::Hello(_))),
        "a new run is announced"
    );
    assert_eq!(samples(&events).len(), 5);
    // The half frame is no loss that could be counted on a line that is gone; nothing else is.
    bench.until_losses((0, 0, 0));
}

/// The device's own words reach people, without what would turn a terminal's colours.
#[test]
fn what_a_device_has_to_say_is_told() {
    let mut bench = bench(None);
    bench.say(&ToHost::Hello(hello()));
    let words = format_args!("the model is refused\u{1b}[31m: it is damaged");
    bench.say(&ToHost::Notice(Notice::new(words)));
    let events = until(&mut bench.watch, |event| notice(event).is_some());
    let said = notice(events.last().unwrap()).unwrap();
    assert_eq!(said, "the device says: the model is refused[31m: it is damaged");
}

#[test]
fn what_speaks_is_named() {
    let mut bench = bench(None);
    bench.say(&ToHost::Hello(hello()));
    bench.frames(0..3);
    bench.until_frame(2);
    // Another model, after a reset.
    let mut other = hello();
    other.model = 0xfeed;
    bench.say(&ToHost::Hello(other));
    let events = until(
        &mut bench.watch,
        |e| matches!(e, Event::Hello(said) if said.hello.model == 0xfeed),
    );
    assert!(
        events
            .iter()
            .filter_map(notice)
            .any(|text| text.contains("another model: 0000feed in place of 1234abcd"))
    );
    bench.frames(0..3);
    // A restart that only the numbers tell of.
    bench.frames(0..2);
    let events = until(&mut bench.watch, |event| {
        notice(event) == Some("the device began anew")
    });
    assert_eq!(samples(&events), [200, 360, 520]);
    let events = bench.until_frame(1);
    assert_eq!(samples(&events), [200, 360]);
    // Another protocol is said once, however often it comes.
    let mut old = hello();
    old.protocol = 2;
    for _ in 0..3 {
        bench.say(&ToHost::Hello(old.clone()));
    }
    // What such a device sends is not read.
    bench.frames(2..3);
    bench.say(&ToHost::Hello(hello()));
    bench.frames(3..4);
    let mut events = bench.until_frame(3);
    assert_eq!(samples(&events), [160 * 3 + 200]);
    events.extend(until(&mut bench.watch, |event| matches!(event, Event::Status(_))));
    let said: Vec<&str> = events
        .iter()
        .filter_map(notice)
        .filter(|t| t.contains("protocol"))
        .collect();
    assert_eq!(said.len(), 1, "{said:?}");
    assert!(said[0].contains("protocol 2, this program"), "{}", said[0]);
}

#[test]
fn samples_go_on_behind_their_wrapping() {
    let mut bench = bench(None);
    bench.say(&ToHost::Hello(hello()));
    for hop in 0..6u32 {
        let mut frame = frame(hop, 0);
        frame.sample = (u32::MAX - 400).wrapping_add(160 * hop);
        bench.say(&ToHost::Frame(frame));
    }
    let events = bench.until_frame(5);
    let first = u64::from(u32::MAX - 400);
    let want: Vec<u64> = (0..6).map(|hop| first + 160 * hop).collect();
    assert_eq!(samples(&events), want);
}

/// The device is fed in real time, told to start and to stop, and the frames' sound was heard when it was sent.
#[test]
fn speech_is_spoken_to_the_device() {
    let mut bench = bench(Some(Speech::Shipped));
    let mut receiver = Receiver::new();
    let (mut pcm, mut started, mut stopped) = (0u32, 0, false);
    let mut buffer = [0; 4096];
    while !stopped {
        let count = bench.hear(&mut buffer);
        assert!(count > 0);
        let mut answers = Vec::new();
        for byte in &buffer[..count] {
            match receiver.push::<ToDevice>(*byte) {
                Some(Ok(ToDevice::Start)) => {
                    started += 1;
                    answers.push(ToHost::Hello(hello()));
                }
                Some(Ok(ToDevice::Pcm(heard))) => {
                    assert_eq!(heard.sequence, pcm);
                    // A frame, six hops late.
                    if pcm >= 6 {
                        answers.push(ToHost::Frame(frame(pcm - 6, 0)));
                    }
                    pcm += 1;
                }
                Some(Ok(ToDevice::Stop)) => {
                    stopped = true;
                    answers.push(ToHost::Status(Status::default()));
                }
                Some(Ok(ToDevice::Hello { .. })) | None => {}
                other => panic!("{other:?}"),
            }
        }
        for answer in &answers {
            bench.say(answer);
        }
    }
    assert_eq!((started, pcm), (1, 422));
    let events = until(&mut bench.watch, |event| matches!(event, Event::End(_)));
    let sound: u64 = events
        .iter()
        .filter_map(|event| match event {
            Event::Sound(piece) => Some(piece.samples.len() as u64),
            _ => None,
        })
        .sum();
    assert_eq!(sound, 67_520);
    let delays: Vec<f64> = events
        .iter()
        .filter_map(|event| match event {
            Event::Frame(timed) => Some(timed.arrived_ms - timed.heard_ms.expect("the host spoke it")),
            _ => None,
        })
        .collect();
    // Frame n is sent when hop n + 6 has come, which is 70 ms after its first sample, 57.5 ms after its centre.
    assert!(delays.iter().all(|ms| *ms > 57.0), "{delays:?}");
}

#[test]
fn a_stall_is_told_and_a_device_that_does_not_read_is_no_hindrance() {
    let mut bench = bench(Some(Speech::Shipped));
    bench.say(&ToHost::Hello(hello()));
    // Nothing is read and nothing is sent: the host says so and goes on.
    let mut events = until(&mut bench.watch, |event| {
        notice(event).is_some_and(|t| t.contains("does not keep up"))
    });
    // It is sent half a second of sound and no more, so that it is not behind for ever.
    let sent = |events: &[Event]| events.iter().filter(|e| matches!(e, Event::Sound(_))).count();
    assert_eq!(sent(&events), 51);
    events.extend(until(&mut bench.watch, |event| {
        notice(event).is_some_and(|t| t.contains("said nothing"))
    }));
    assert_eq!(sent(&events), 51);
    // When it answers again, the next sound is the next for both: times of hearing hold.
    bench.frames(0..40);
    let events = until(&mut bench.watch, |event| matches!(event, Event::Sound(_)));
    let Some(Event::Sound(piece)) = events.last() else {
        panic!()
    };
    assert_eq!(piece.sample, 51 * 160);
    assert!(piece.heard_ms > 1900.0, "{}", piece.heard_ms);
    bench.driver.commands().send(Command::Stop);
    let Bench { driver, watch, .. } = bench;
    drop(watch);
    drop(driver);
}
