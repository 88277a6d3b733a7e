//! Slow lines: which rate the firmware chooses by its rule, and that what comes over such a line is whole frames, the right ones.
#[allow(dead_code, reason = "the tests of the firmware use more of it")]
mod common;

use std::cell::RefCell;
use std::rc::Rc;

use lipstream::link::{Link, Losses};
use lipstream_core::kinds::Recurrent;
use lipstream_core::wire::{
    Frame, Group, Hello, MAX_ENCODED, PROTOCOL, Profile, Status, ToHost, encode, encoded_size, longest_frame,
};
use lipstream_core::{AnyModel, HOP_SAMPLES, Model, SAMPLE_RATE_HZ, StreamSettings};
use lipstream_firmware::pace::{EVERY, Pace, uart_bytes_per_second, usual_bytes_per_second, usual_frame};
use lipstream_firmware::{App, Clock, Line};

fn size(message: &ToHost) -> usize {
    encode(message, &mut [0; MAX_ENCODED]).unwrap().len()
}

fn hello(parameters: usize) -> ToHost {
    ToHost::Hello(Hello {
        protocol: PROTOCOL,
        model: u32::MAX,
        rate_hz: 100,
        lag_samples: 1080,
        visemes: 13,
        groups: [Group {
            name: "mouth".try_into().unwrap(),
            size: parameters as u8,
        }]
        .into_iter()
        .collect(),
        scales: (0..parameters).map(|p| 0.1 + p as f32).collect(),
    })
}

/// A frame whose parameters are all `value`.
fn frame(parameters: usize, sequence: u32, value: i16) -> ToHost {
    ToHost::Frame(Frame {
        sequence,
        sample: sequence.wrapping_mul(160).wrapping_add(200),
        parameters: std::iter::repeat_n(value, parameters).collect(),
        viseme_weights: std::iter::repeat_n(255, 13).collect(),
    })
}

/// The table of docs/wire.md: frames of usual size, their bytes a second at 100, 50 and 25 frames a second, and the rate that is chosen at
/// 115,200 baud and at a million.
#[test]
fn the_arithmetic_of_slow_lines() {
    let table = [
        (30, 87, [8878, 4528, 2353], 100, 100),
        (64, 155, [15815, 8065, 4190], 50, 100),
        (90, 207, [21119, 10769, 5594], 50, 100),
    ];
    for (parameters, bytes, a_second, slow, fast) in table {
        // The firmware's arithmetic against messages as they are encoded.
        let usual = size(&frame(parameters, 300_000, 5000));
        assert_eq!((usual, usual_frame(parameters, 13)), (bytes, bytes));
        let longest = size(&frame(parameters, 0x1234_5678, i16::MIN));
        assert_eq!(
            longest,
            encoded_size(longest_frame(parameters, 13)),
            "{parameters}"
        );
        let status = Status {
            load_permille: 1000,
            overruns: u32::MAX,
            dropped: u32::MAX,
            narrowed: u32::MAX,
            unknown: u32::MAX,
        };
        let round = size(&hello(parameters)) + size(&ToHost::Status(status));
        for (rate, want) in [100, 50, 25].into_iter().zip(a_second) {
            let says = usual_bytes_per_second(parameters, 13, rate);
            assert_eq!(says, want, "{parameters} at {rate}");
            let is = usual * usize::from(rate) + round;
            // A Hello's numbers are not all of their full length.
            assert!(is <= says as usize && says as usize - is < 20, "{is} {says}");
        }
        for (baud, want) in [(115_200, slow), (1_000_000, fast)] {
            let line = uart_bytes_per_second(baud);
            let pace = Pace::new(Some(line), parameters, 13);
            assert_eq!(pace.rate_hz(), want, "{parameters} at {baud} baud");
            // What is chosen fits, and the next higher rate would not.
            let fits = |rate| usual_bytes_per_second(parameters, 13, rate) * 100 <= line * 95;
            assert!(fits(want));
            assert!(want == 100 || !fits(100 / (pace.every() as u16 / 2)));
        }
        assert_eq!(Pace::new(None, parameters, 13).rate_hz(), 100);
    }
    // A line for nothing at all still gets a frame a second.
    assert_eq!(Pace::new(Some(1), 30, 13).rate_hz(), 1);
}

#[test]
fn frames_longer_than_usual_slow_the_pace_once_a_second() {
    let line = uart_bytes_per_second(115_200);
    let mut pace = Pace::new(Some(line), 30, 13);
    let mut rates = Vec::new();
    for _ in 0..4 {
        for _ in 0..100 / pace.every() {
            pace.says(117);
        }
        rates.push((pace.round(), pace.rate_hz()));
    }
    // 11,700 bytes are more than 11,520, half of them are not.
    assert_eq!(rates, [(true, 50), (false, 50), (false, 50), (false, 50)]);
    let mut hopeless = Pace::new(Some(100), 30, 13);
    for _ in 0..20 {
        hopeless.says(1000);
        hopeless.round();
    }
    assert_eq!(hopeless.every(), u32::from(*EVERY.last().unwrap()));
}

/// A UART behind a buffer that empties at its rate; time is the sound's.
struct Uart {
    rate: u32,
    waiting: usize,
    fullest: usize,
    sent: Vec<u8>,
}

/// Bytes that wait at most: a whole round and some frames.
const BUFFER: usize = 1024;

#[derive(Clone)]
struct Shared(Rc<RefCell<Uart>>);

impl Shared {
    fn passes(&self, samples: usize) {
        let mut uart = self.0.borrow_mut();
        let left = uart.rate as usize * samples / SAMPLE_RATE_HZ as usize;
        uart.waiting = uart.waiting.saturating_sub(left);
    }
}

impl Line for Shared {
    fn send(&mut self, bytes: &[u8]) -> bool {
        let mut uart = self.0.borrow_mut();
        if uart.waiting + bytes.len() > BUFFER {
            return false;
        }
        uart.waiting += bytes.len();
        uart.fullest = uart.fullest.max(uart.waiting);
        uart.sent.extend(bytes);
        true
    }

    fn bytes_per_second(&self) -> Option<u32> {
        Some(self.0.borrow().rate)
    }
}

struct Still;

impl Clock for Still {
    fn ticks(&self) -> u32 {
        0
    }
}

#[test]
fn a_slow_line_gets_every_nth_frame_whole() {
    let tables = common::shipped_tables();
    let model: Model<Recurrent> = Model::new_checked(&tables).unwrap();
    let samples = common::hello();
    let any = AnyModel::new_checked(&tables).unwrap();
    let all = common::host_frames(&any, StreamSettings::of(Profile::Standard), &samples);
    for (baud, rate) in [
        (1_000_000, 100),
        (115_200, 100),
        (57_600, 50),
        (38_400, 25),
        (9_600, 5),
    ] {
        let uart = Shared(Rc::new(RefCell::new(Uart {
            rate: uart_bytes_per_second(baud),
            waiting: 0,
            fullest: 0,
            sent: Vec::new(),
        })));
        let mut app = App::new(&model, uart.clone(), Still);
        app.start();
        for hop in samples.chunks(HOP_SAMPLES) {
            uart.passes(hop.len());
            app.samples(hop);
        }
        // What the device still holds back goes out at once: the line is given its time before.
        uart.passes(samples.len());
        app.stop();
        let sent = uart.0.borrow().sent.clone();
        let mut link = Link::new(None);
        let mut messages = Vec::new();
        link.push(&sent, |message| messages.push(message)).unwrap();
        assert_eq!(
            link.losses(),
            Losses::default(),
            "{baud}: nothing is damaged and no number missing"
        );
        let mut came = Vec::new();
        for message in messages {
            match message {
                ToHost::Hello(hello) => assert_eq!(hello.rate_hz, rate, "{baud}"),
                ToHost::Frame(frame) => came.push(frame),
                ToHost::Status(status) => assert_eq!(status.dropped, 0, "{baud}"),
                ToHost::Notice(notice) => panic!("nothing is wrong: {notice:?}"),
            }
        }
        let every = usize::from(100 / rate);
        let want: Vec<Frame> = (0..)
            .zip(all.iter().step_by(every))
            .map(|(n, frame)| Frame::new(n, frame))
            .collect();
        assert_eq!(came, want, "{baud}");
        println!(
            "{baud} baud: {rate} frames a second, at most {} bytes wait",
            uart.0.borrow().fullest
        );
    }
}
