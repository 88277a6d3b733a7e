//! The Pico's firmware in rp2040js (`tests/rp2040`): sound comes bit by bit through an I²S microphone's pins, PIO and DMA; what leaves by USB
//! and UART is what the core gives on the host.
use std::path::PathBuf;
use std::process::Command;
use std::sync::OnceLock;

use lipstream::link::{Link, Losses};
use lipstream_core::wire::{Profile, Status, ToDevice, ToHost};
use lipstream_core::{AnyModel, StreamSettings};
use object::{Object, ObjectSymbol};
use serde_json::{Value, json};

use crate::common;
use crate::common::build::build_firmware;
use crate::common::qemu::{bytes, pcm};
use crate::compare::{assert_same, expected_hello, frames, host};

/// Thousandths of the processor that the stream may take, interrupts included, at 133 MHz and with the emulator's model of the flash's
/// cache: `docs/cost.md` has what it takes.
const MOST_LOAD: u16 = 600;
/// Sound for a second and a quarter: more than one round of `Hello` and `Status`.
const LENGTH: usize = 20_000;

fn program() -> &'static PathBuf {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| build_firmware("pico", &common::folder("pico"), "firmware", None))
}

/// What a board said.
struct Said {
    usb: Vec<ToHost>,
    uart: Vec<ToHost>,
    report: Value,
    /// What the links noticed.
    losses: [Losses; 2],
}

/// Lets the board hear `samples` while the host does `events`.
fn run(name: &str, samples: &[i16], events: &[Value]) -> Said {
    let folder = emulate(name, samples, json!({ "events": events }));
    let model = model();
    let read = |port: &str| {
        let mut link = Link::new(Some(model.head().id()));
        let mut messages = Vec::new();
        let wire = std::fs::read(folder.join(port)).expect("what was sent");
        link.push(&wire, |message| messages.push(message))
            .expect("our own protocol and model");
        (messages, link.losses())
    };
    let ((usb, usb_losses), (uart, uart_losses)) = (read("usb.wire"), read("uart.wire"));
    let report = std::fs::read(folder.join("report.json")).expect("the report");
    Said {
        usb,
        uart,
        report: serde_json::from_slice(&report).expect("the report"),
        losses: [usb_losses, uart_losses],
    }
}

/// The same with any job for the emulator; the folder with what came of it.
pub(crate) fn emulate(name: &str, samples: &[i16], mut job: Value) -> PathBuf {
    let emulator = common::root().join("tests/rp2040");
    assert!(
        emulator.join("node_modules/rp2040js").is_dir(),
        "no emulator: tests/setup npm:tests/rp2040 installs it"
    );
    let elf = std::fs::read(program()).expect("the program");
    let file = object::File::parse(&*elf).expect("an ELF file");
    let address = |name| {
        let symbol = file
            .symbol_by_name(name)
            .unwrap_or_else(|| panic!("no symbol {name}"));
        symbol.address()
    };
    let folder = common::folder(name);
    let sound: Vec<u8> = samples.iter().flat_map(|sample| sample.to_le_bytes()).collect();
    std::fs::write(folder.join("sound.pcm"), sound).expect("write the sound");
    job["program"] = json!(program());
    job["sound"] = json!(folder.join("sound.pcm"));
    job["folder"] = json!(folder);
    job["stack"] = json!([address("_stack_end"), address("_stack_start")]);
    std::fs::write(folder.join("job.json"), job.to_string()).expect("write the job");
    let output = Command::new("node")
        .arg(emulator.join("run.mjs"))
        .arg(folder.join("job.json"))
        .output()
        .expect("run node");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    folder
}

static MODEL: OnceLock<Vec<u8>> = OnceLock::new();

pub(crate) fn model() -> AnyModel<'static> {
    AnyModel::new_checked(MODEL.get_or_init(common::shipped_tables)).expect("the shipped model")
}

fn last_status(messages: &[ToHost]) -> Status {
    let status = messages.iter().rev().find_map(|message| match message {
        ToHost::Status(status) => Some(*status),
        _ => None,
    });
    status.expect("a Status")
}

/// The sound through the microphone's pins; the frames of the silence that follows it are the host's too.
#[test]
fn a_microphone_gives_the_hosts_bytes_on_usb_and_uart() {
    let settings = StreamSettings::of(Profile::Standard);
    let mut samples = common::hello()[..LENGTH].to_vec();
    let said = run("pico-microphone", &samples, &[]);
    let rounds = last_status(&said.usb);
    samples.extend([0; 1600]);
    let expected = host(&model(), settings, &samples);
    for messages in [&said.usb, &said.uart] {
        assert_eq!(messages[0], ToHost::Hello(expected_hello(&model(), settings)));
        let frames = frames(messages);
        // The last ones are still on their way when the emulator stops.
        assert!(frames.len() >= LENGTH / 160, "{} frames", frames.len());
        assert_same(&frames, &expected[..frames.len()]);
    }
    assert_eq!(said.losses, [Losses::default(); 2]);
    assert_eq!((rounds.overruns, rounds.dropped), (0, 0));
    // The device's own count.
    println!("{rounds:?} {}", said.report);
    assert!((1..=MOST_LOAD).contains(&rounds.load_permille), "{rounds:?}");
    assert_eq!(said.report["bitClock"], 1_024_000.0);
    assert_eq!(said.report["watchdog"], 0);
    assert!(said.report["blinks"].as_u64() >= Some(2), "{}", said.report);
    let [used, size] = ["stackUsed", "stackSize"].map(|name| said.report[name].as_u64().expect("a number"));
    assert!(used + 4096 <= size, "{used} of {size} bytes of stack");
}

/// `Pcm` over USB instead of the room's sound, from the host's `Start` to its `Stop`.
#[test]
fn sound_from_the_host_takes_the_microphones_place() {
    let settings = StreamSettings::of(Profile::Live);
    let speech = common::hello();
    let samples = &speech[4000..][..8000];
    let mut line = bytes(ToDevice::Profile(Profile::Live));
    line.extend(pcm(samples, 160).concat());
    line.extend(bytes(ToDevice::Stop));
    let hex: String = line.iter().map(|byte| format!("{byte:02x}")).collect();
    let said = run("pico-pcm", &speech[..LENGTH], &[json!({ "ms": 100, "usb": hex })]);
    // Frames of the microphone's sound until the host's `Profile` arrived, then those of the host's sound.
    let begin = said
        .usb
        .iter()
        .position(|message| *message == ToHost::Hello(expected_hello(&model(), settings)))
        .expect("the profile's Hello");
    assert_same(&frames(&said.usb[begin..]), &host(&model(), settings, samples));
    let status = last_status(&said.usb);
    assert_eq!((status.overruns, status.dropped, status.unknown), (0, 0, 0));
}

/// Noise on both lines, a port that closes and opens, a host that stops reading: one port's host loses frames, whole ones, and is told how
/// many; the other port and the sound go on.
#[test]
fn troubles_of_one_host_are_its_own() {
    let mut samples = common::hello()[..LENGTH].to_vec();
    let noise: String = (0..600_u32)
        .map(|i| format!("{:02x}", (i * 7919 + 3) % 251))
        .collect();
    let events = [
        json!({ "ms": 50, "usb": noise }),
        json!({ "ms": 60, "uart": noise[..40] }),
        json!({ "ms": 200, "open": false }),
        json!({ "ms": 300, "open": true }),
        json!({ "ms": 400, "reading": false }),
        json!({ "ms": 900, "reading": true }),
    ];
    let said = run("pico-troubles", &samples, &events);
    samples.extend([0; 1600]);
    let expected = host(&model(), StreamSettings::of(Profile::Standard), &samples);
    let uart = frames(&said.uart);
    assert!(uart.len() >= LENGTH / 160 - 10, "{} frames", uart.len());
    assert_same(&uart, &expected[..uart.len()]);
    let usb = frames(&said.usb);
    assert!(
        usb.len() < uart.len() && usb.len() > uart.len() / 4,
        "{} frames",
        usb.len()
    );
    assert!(usb.iter().all(|frame| expected.contains(frame)));
    let status = last_status(&said.uart);
    assert_eq!(status.overruns, 0);
    assert!(status.dropped > 0, "{status:?}");
    assert_eq!(said.report["watchdog"], 0);
}

/// A model that is damaged in flash: words, and the LED's code instead of the heartbeat.
#[test]
fn a_damaged_model_is_refused_visibly() {
    let tables = common::shipped_tables();
    let at = 0x1010_0000 + tables.len() / 2;
    let job = json!({ "events": [], "flash": [[at, tables[tables.len() / 2] ^ 1]], "milliseconds": 2500 });
    let folder = emulate("pico-damaged", &[0; 16], job);
    let said = std::fs::read(folder.join("uart.wire")).expect("what was sent");
    let said = String::from_utf8_lossy(&said);
    assert!(said.starts_with("\0lipstream: model is damaged"), "{said}");
    let report: Value =
        serde_json::from_slice(&std::fs::read(folder.join("report.json")).expect("the report"))
            .expect("JSON");
    // A second of darkness, two blinks, four changes.
    assert!(report["blinks"].as_u64() >= Some(4), "{report}");
}
