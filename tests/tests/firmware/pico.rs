//! The Pico's firmware in rp2040js (`tests/rp2040`), flashed by files of `lipstream flash`: sound comes bit by bit through an I²S microphone's
//! pins, PIO and DMA; what leaves by USB and UART is what the core gives on the host. And what happens when something goes wrong.
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use lipstream::export::{MgeSettings, export_mge};
use lipstream::kinds::recurrent::model::RecurrentModel;
use lipstream::link::{Link, Losses};
use lipstream_core::logmath::LogProb;
use lipstream_core::wire::{Profile, Status, ToDevice, ToHost};
use lipstream_core::{AnyModel, StreamSettings};
use object::{Object, ObjectSymbol};
use serde_json::{Value, json};

use crate::common;
use crate::common::build::build_firmware;
use crate::common::qemu::{bytes, pcm};
use crate::compare::{assert_same, expected_hello, frames, host};

/// Thousandths of the processor that the stream may take on average over a sentence, interrupts included, at 133 MHz and with the emulator's model of the flash's
/// cache: `docs/cost.md` has what it takes.
const MOST_LOAD: u16 = 600;
/// Sound for a second and a quarter: more than one round of `Hello` and `Status`.
const LENGTH: usize = 20_000;

/// What a stream on the Pico is set to: its beam is 10 bits wide at most.
pub(crate) fn pico_settings(profile: Profile) -> StreamSettings {
    StreamSettings {
        beam: Some(LogProb::from_q12(10 << 12)),
        ..StreamSettings::of(profile)
    }
}

fn program() -> &'static PathBuf {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| build_firmware("pico", &common::folder("pico"), "firmware", None))
}

/// The UF2 file that `lipstream flash` writes with these words, in `folder`.
pub(crate) fn uf2(folder: &Path, name: &str, words: &[&str]) -> PathBuf {
    let file = folder.join(name);
    let to = file.to_str().expect("an ordinary name");
    let words = [&["lipstream", "flash", "--board", "pico", "--file", to], words].concat();
    lipstream_cli::run(words.iter().map(OsString::from)).expect("flash writes a file");
    file
}

/// The program alone, as it is flashed.
pub(crate) fn flashed() -> &'static PathBuf {
    static FLASHED: OnceLock<PathBuf> = OnceLock::new();
    FLASHED.get_or_init(|| {
        let program = program().to_str().expect("an ordinary name");
        uf2(&common::folder("pico-uf2"), "pico.uf2", &["--program", program])
    })
}

/// What a board said.
pub(crate) struct Said {
    pub(crate) usb: Vec<ToHost>,
    pub(crate) uart: Vec<ToHost>,
    pub(crate) report: Value,
    /// What the links noticed.
    pub(crate) losses: [Losses; 2],
}

/// Lets the board hear `samples` while the host does `events`.
fn run(name: &str, samples: &[i16], events: &[Value]) -> Said {
    run_with(&model(), name, samples, json!({ "events": events }))
}

/// The same with any job for the emulator, when the board runs this model.
fn run_with(model: &AnyModel, name: &str, samples: &[i16], job: Value) -> Said {
    read(model, &emulate(name, samples, job))
}

/// What a board that runs this model said, from the folder with what came of it.
pub(crate) fn read(model: &AnyModel, folder: &Path) -> Said {
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

/// Any job for the emulator, in which a board hears `samples`; the folder with what came of it.
pub(crate) fn emulate(name: &str, samples: &[i16], job: Value) -> PathBuf {
    let sound: Vec<u8> = samples.iter().flat_map(|sample| sample.to_le_bytes()).collect();
    emulate_bytes(name, &sound, job)
}

/// The same with the bytes of the sound's file.
pub(crate) fn emulate_bytes(name: &str, sound: &[u8], mut job: Value) -> PathBuf {
    let emulator = common::root().join("tests/rp2040");
    assert!(
        emulator.join("node_modules/rp2040js").is_dir(),
        "no emulator: tests/setup npm:tests/rp2040 installs it"
    );
    let folder = common::folder(name);
    if job.get("flash").is_none() {
        job["flash"] = json!([flashed()]);
    }
    std::fs::write(folder.join("sound.pcm"), sound).expect("write the sound");
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

/// The address of a symbol of the program.
fn address(name: &str) -> u64 {
    let elf = std::fs::read(program()).expect("the program");
    let file = object::File::parse(&*elf).expect("an ELF file");
    let symbol = file
        .symbol_by_name(name)
        .unwrap_or_else(|| panic!("no symbol {name}"));
    symbol.address()
}

static MODEL: OnceLock<Vec<u8>> = OnceLock::new();

pub(crate) fn model() -> AnyModel<'static> {
    AnyModel::new_checked(MODEL.get_or_init(common::shipped_tables)).expect("the shipped model")
}

pub(crate) fn last_status(messages: &[ToHost]) -> Status {
    let status = messages.iter().rev().find_map(|message| match message {
        ToHost::Status(status) => Some(*status),
        _ => None,
    });
    status.expect("a Status")
}

/// The sound through the microphone's pins; the frames of the silence that follows it are the host's too.
#[test]
fn a_microphone_gives_the_hosts_bytes_on_usb_and_uart() {
    let settings = pico_settings(Profile::Standard);
    let mut samples = common::hello();
    let length = samples.len();
    let said = run("pico-microphone", &samples, &[]);
    let rounds = last_status(&said.usb);
    samples.extend([0; 1600]);
    let expected = host(&model(), settings, &samples);
    for messages in [&said.usb, &said.uart] {
        assert_eq!(messages[0], ToHost::Hello(expected_hello(&model(), settings)));
        let frames = frames(messages);
        // The last ones are still on their way when the emulator stops.
        assert!(frames.len() >= length / 160, "{} frames", frames.len());
        assert_same(&frames, &expected[..frames.len()]);
    }
    assert_eq!(said.losses, [Losses::default(); 2]);
    assert_eq!((rounds.overruns, rounds.dropped), (0, 0));
    // The device's own count, of every second.
    let loads = said.usb.iter().filter_map(|message| match message {
        ToHost::Status(status) => Some(status.load_permille),
        _ => None,
    });
    let loads: Vec<u16> = loads.collect();
    println!("{loads:?} {}", said.report);
    let mean = loads.iter().sum::<u16>() / loads.len() as u16;
    assert!(loads.len() >= 4 && (1..=MOST_LOAD).contains(&mean), "{loads:?}");
    assert_eq!(said.report["bitClock"], 1_024_000.0);
    assert_eq!(said.report["starts"], json!([]));
    assert!(said.report["blinks"].as_u64() >= Some(2), "{}", said.report);
    let [used, size] = ["stackUsed", "stackSize"].map(|name| said.report[name].as_u64().expect("a number"));
    assert!(used + 4096 <= size, "{used} of {size} bytes of stack");
}

/// `Pcm` over USB instead of the room's sound, from the host's `Start` to its `Stop`.
#[test]
fn sound_from_the_host_takes_the_microphones_place() {
    let settings = pico_settings(Profile::Live);
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
    let expected = host(&model(), pico_settings(Profile::Standard), &samples);
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
    assert_eq!(said.report["starts"], json!([]));
}

/// Another model than the built-in one, which makes other frames of the same sound.
pub(crate) fn other_tables() -> Vec<u8> {
    let model = RecurrentModel::read(&common::root().join("models/grid-s1.safetensors")).expect("a model");
    export_mge(&model, &MgeSettings { beam_bits: 8.0 })
        .expect("its tables")
        .bytes
}

/// What a board says beside its `Hello` to which nobody wrote a calibration.
const NO_SERVOS: &str = "servos stay off: there is no calibration in flash";

/// The words of the notices among messages.
pub(crate) fn notices(messages: &[ToHost]) -> Vec<&str> {
    let words = messages.iter().filter_map(|message| match message {
        ToHost::Notice(notice) => Some(notice.words.as_str()),
        _ => None,
    });
    words.collect()
}

/// A model in the region that is kept for another runs in place of the built-in one, which is still in the program.
#[test]
fn another_model_runs_without_a_new_program() {
    let folder = common::folder("pico-other-uf2");
    let tables = other_tables();
    std::fs::write(folder.join("other.tables"), &tables).expect("write the tables");
    let path = folder.join("other.tables");
    let words = ["--model", path.to_str().expect("an ordinary name")];
    let file = uf2(&folder, "other.uf2", &words);
    let other = AnyModel::new_checked(&tables).expect("a model");
    assert_ne!(other.head().id(), model().head().id());
    let samples = &common::hello()[..LENGTH / 2];
    let job = json!({ "events": [], "flash": [flashed(), file] });
    let said = run_with(&other, "pico-other", samples, job);
    // Its own beam is narrower than what the Pico sets.
    let settings = StreamSettings::of(Profile::Standard);
    assert_eq!(said.usb[0], ToHost::Hello(expected_hello(&other, settings)));
    let expected = host(&other, settings, samples);
    let came = frames(&said.usb);
    assert!(came.len() >= expected.len() - 10, "{} frames", came.len());
    let count = came.len().min(expected.len() - 10);
    assert_same(&came[..count], &expected[..count]);
    assert_eq!(notices(&said.usb), [NO_SERVOS]);
    // The shipped model gives others.
    assert_ne!(came[..count], host(&model(), settings, samples)[..count]);
}

/// One that got damaged on its way, or an older one's place: refused in words on both ports, and the built-in one runs.
#[test]
fn a_damaged_model_leaves_the_built_in_one_running() {
    let folder = common::folder("pico-damaged-uf2");
    let path = folder.join("other.tables");
    std::fs::write(&path, other_tables()).expect("write the tables");
    let words = ["--model", path.to_str().expect("an ordinary name")];
    let file = uf2(&folder, "other.uf2", &words);
    let mut blocks = std::fs::read(&file).expect("the file");
    // A bit of the 300th page.
    blocks[300 * 512 + 100] ^= 1;
    std::fs::write(&file, blocks).expect("write the file");
    let samples = &common::hello()[..LENGTH / 4];
    let job = json!({ "events": [], "flash": [flashed(), file] });
    let said = run_with(&model(), "pico-damaged", samples, job);
    let settings = pico_settings(Profile::Standard);
    let expected = host(&model(), settings, samples);
    for messages in [&said.usb, &said.uart] {
        assert_eq!(messages[0], ToHost::Hello(expected_hello(&model(), settings)));
        let words = notices(messages);
        assert_eq!(words[1..], [NO_SERVOS]);
        let refusal = "the model in flash is refused, the built-in one runs: model is damaged: checksum ";
        assert!(words[0].starts_with(refusal), "{words:?}");
        let came = frames(messages);
        let count = expected.len() - 10;
        assert_same(&came[..count], &expected[..count]);
    }
}

/// The built-in model damaged, and no other: words, and the LED's code instead of the heartbeat.
#[test]
fn a_damaged_program_ends_visibly() {
    let mut blocks = std::fs::read(flashed()).expect("the file");
    let at = address("__model_built_in") as usize + 1000 - 0x1000_0000;
    blocks[at / 256 * 512 + 32 + at % 256] ^= 1;
    let file = common::folder("pico-broken-uf2").join("broken.uf2");
    std::fs::write(&file, blocks).expect("write the file");
    let job = json!({ "events": [], "flash": [file], "milliseconds": 1500 });
    let said = run_with(&model(), "pico-broken", &[0; 16], job);
    let words = notices(&said.uart);
    assert!(
        words.len() == 1 && words[0].starts_with("model is damaged"),
        "{words:?}"
    );
    // Darkness, then the first blinks.
    assert!(said.report["blinks"].as_u64() >= Some(2), "{}", said.report);
}

/// Half-words that take the place of the handler that counts the microphone's sound, and run within 16 ms.
fn broken_handler(halves: &[u16]) -> Value {
    let start = address("DMA_IRQ_0") & !1;
    let places = (start..).step_by(2);
    json!({ "ms": 100, "write": places.zip(halves).collect::<Vec<_>>() })
}

/// The board comes back by itself, and then gives the host's bytes from the first on. What it said until then, and the emulator's word for why.
fn comes_back(name: &str, halves: &[u16]) -> (Vec<ToHost>, Value) {
    let samples = &common::hello()[..LENGTH / 4];
    let job = json!({ "events": [broken_handler(halves)], "restarts": 1 });
    let folder = emulate(name, samples, job);
    let report = std::fs::read(folder.join("report.json")).expect("the report");
    let report: Value = serde_json::from_slice(&report).expect("the report");
    let starts = report["starts"].as_array().expect("a list");
    assert_eq!(starts.len(), 1, "{report}");
    let expected = host(&model(), pico_settings(Profile::Standard), samples);
    let mut before = Vec::new();
    for port in ["usb", "uart"] {
        let wire = std::fs::read(folder.join(format!("{port}.wire"))).expect("what was sent");
        let (old, new) = wire.split_at(starts[0][port].as_u64().expect("a number") as usize);
        let read = |bytes: &[u8]| {
            let mut messages = Vec::new();
            let mut link = Link::new(None);
            link.push(bytes, |message| messages.push(message))
                .expect("our own protocol");
            messages
        };
        before = read(old);
        assert!(frames(&before).len() < 20, "{port} went on");
        let came = frames(&read(new));
        let count = expected.len() - 10;
        assert_same(&came[..count], &expected[..count]);
    }
    (before, starts[0].clone())
}

/// `wfi` for ever: the watchdog, within its second.
#[test]
fn a_program_that_hangs_is_started_anew() {
    let (_, start) = comes_back("pico-hangs", &[0xbf30, 0xe7fd]);
    assert_eq!(
        (&start["why"], &start["lockedUp"]),
        (&json!("watchdog"), &json!(false))
    );
    let ms = start["ms"].as_f64().expect("a number");
    assert!(
        (1300.0..1700.0).contains(&ms),
        "0.3 s of settling, 0.1 s of sound, a second: {ms}"
    );
}

/// `push {r0-r7, lr}`, again and again: the stack leaves the RAM instead of growing into what others keep there, the processor locks up,
/// and the watchdog starts it anew.
#[test]
fn a_stack_that_overflows_starts_the_board_anew() {
    let (_, start) = comes_back("pico-overflow", &[0xb5ff, 0xe7fd]);
    assert_eq!(
        (&start["why"], &start["lockedUp"]),
        (&json!("watchdog"), &json!(true))
    );
}

/// `udf`: words on the UART that say where, the LED's code, and a new start by the program itself.
#[test]
fn a_hard_fault_ends_visibly_and_starts_the_board_anew() {
    let (before, start) = comes_back("pico-fault", &[0xde00]);
    assert_eq!(start["why"], "program");
    let place = format!("hard fault at {:#x}", address("DMA_IRQ_0") & !1);
    assert_eq!(notices(&before), [NO_SERVOS, &place]);
}

/// How often a program on the host opens the port in the test of that. LIPSTREAM_OPENINGS asks for more: 3600 are an hour of one every second.
fn openings() -> usize {
    let Some(words) = std::env::var_os("LIPSTREAM_OPENINGS") else {
        return 50;
    };
    let number = words.to_str().and_then(|words| words.parse().ok());
    number
        .filter(|number| *number >= 50)
        .expect("LIPSTREAM_OPENINGS is a number, 50 or more")
}

/// A program on the host that opens and closes the port, over and over, every 24 ms: the other port's frames are all there, and what comes while it
/// is open are whole frames of the same sound.
#[test]
fn a_host_that_comes_and_goes_changes_nothing() {
    const PERIOD_MS: usize = 24;
    let openings = openings();
    // The speech over and over, until the last opening is some frames ago.
    let length = LENGTH.max((openings * PERIOD_MS + 50) * 16);
    let mut samples: Vec<i16> = common::hello().into_iter().cycle().take(length).collect();
    let events: Vec<Value> = (0..2 * openings)
        .map(|i| json!({ "ms": 20 + PERIOD_MS / 2 * i, "open": i % 2 == 1 }))
        .collect();
    let job = json!({ "events": events, "milliseconds": length / 16 + 2000 });
    let said = run_with(&model(), "pico-comes-and-goes", &samples, job);
    let heard = samples.len();
    samples.extend([0; 1600]);
    let expected = host(&model(), pico_settings(Profile::Standard), &samples);
    let uart = frames(&said.uart);
    assert!(uart.len() >= heard / 160, "{} frames", uart.len());
    assert_same(&uart, &expected[..uart.len()]);
    let usb = frames(&said.usb);
    assert!(usb.len() > 20 && usb.len() < uart.len(), "{} frames", usb.len());
    // In their order: each is looked for behind the one before it.
    let mut rest = expected.iter();
    assert!(usb.iter().all(|frame| rest.any(|other| other == frame)));
    let status = last_status(&said.uart);
    let loads: Vec<u16> = said
        .uart
        .iter()
        .filter_map(|message| match message {
            ToHost::Status(status) => Some(status.load_permille),
            _ => None,
        })
        .collect();
    let mean = loads.iter().map(|load| f64::from(*load)).sum::<f64>() / loads.len() as f64;
    println!(
        "{openings} openings in {} s of sound: {} frames on the UART, {} on USB, {status:?}, {:?}, {}; load {mean:.1} on average, {:?} at most",
        heard / 16_000,
        uart.len(),
        usb.len(),
        said.losses,
        said.report,
        loads.iter().max()
    );
    assert_eq!((status.overruns, status.dropped, status.unknown), (0, 0, 0));
    assert_eq!(said.report["starts"], json!([]));
}
