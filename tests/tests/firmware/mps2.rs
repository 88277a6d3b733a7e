//! The firmware in QEMU gives what the core gives on the host, byte for byte, over its UART and from files.
use std::path::PathBuf;
use std::sync::OnceLock;

use crate::common;
use crate::common::build::build_firmware;
use crate::common::qemu::{self, Machine, bytes, pcm, run_on_file};
use crate::compare::{assert_same, expected_hello, frames, host, is_status};
use lipstream::link::{Link, Losses, greeting};
use lipstream_core::wire::{Notice, PROTOCOL, Profile, Status, ToDevice, ToHost};
use lipstream_core::{AnyModel, StreamSettings};

const BOARD: &str = "mps2-an386";

struct Firmware {
    program: PathBuf,
    tables: Vec<u8>,
}

/// The firmware as it is shipped, built once for all tests here.
fn firmware() -> &'static Firmware {
    static FIRMWARE: OnceLock<Firmware> = OnceLock::new();
    FIRMWARE.get_or_init(|| Firmware {
        program: build_firmware(BOARD, &common::folder("firmware"), "firmware", None),
        tables: common::shipped_tables(),
    })
}

/// Enough speech for more than one round of `Hello` and `Status` where a test does not need all of it.
const SHORT: usize = 24_000;

#[test]
fn uart_gives_the_hosts_bytes() {
    let firmware = firmware();
    let model = AnyModel::new_checked(&firmware.tables).unwrap();
    let samples = &common::hello()[..];
    let host = host(&model, StreamSettings::of(Profile::Standard), samples);

    let mut machine = Machine::boot(&firmware.program);
    let mut link = Link::new(Some(model.head().id()));
    let mut line = bytes(ToDevice::Start);
    line.extend(pcm(samples, 160).concat());
    line.extend(bytes(ToDevice::Stop));
    let rounds = host.len() / 100;
    // The last Status is the one at Stop.
    let messages = machine.talk(line, &mut link, |messages| {
        messages.iter().filter(|message| is_status(message)).count() > rounds
    });

    assert_same(&frames(&messages), &host);
    let hello = ToHost::Hello(expected_hello(&model, StreamSettings::of(Profile::Standard)));
    assert_eq!(messages[0], hello);
    assert_eq!(
        messages.iter().filter(|message| **message == hello).count(),
        1 + rounds
    );
    for message in &messages {
        if let ToHost::Status(status) = message {
            assert_eq!((status.overruns, status.dropped), (0, 0));
            assert!((1..=1000).contains(&status.load_permille), "{status:?}");
        }
    }
    assert_eq!(link.losses(), Losses::default());
}

/// Everything that comes for `line`, up to the one `Status` at `Stop`; for less than a second of speech.
fn until_status(machine: &mut Machine, line: Vec<u8>, link: &mut Link) -> Vec<ToHost> {
    machine.talk(line, link, |messages| messages.last().is_some_and(is_status))
}

#[test]
fn profiles_and_restarts() {
    let firmware = firmware();
    let model = AnyModel::new_checked(&firmware.tables).unwrap();
    let samples = &common::hello()[4000..][..SHORT / 2];
    let mut machine = Machine::boot(&firmware.program);
    let mut link = Link::new(None);
    for profile in [Profile::Studio, Profile::Live, Profile::Standard, Profile::Live] {
        // Profile starts anew by itself. Pieces of another length make no difference.
        let mut line = bytes(ToDevice::Profile(profile));
        line.extend(pcm(samples, 97).concat());
        line.extend(bytes(ToDevice::Stop));
        let messages = until_status(&mut machine, line, &mut link);
        assert_eq!(
            messages[0],
            ToHost::Hello(expected_hello(&model, StreamSettings::of(profile)))
        );
        assert_same(
            &frames(&messages),
            &host(&model, StreamSettings::of(profile), samples),
        );
    }
    // Start keeps the profile.
    let mut line = bytes(ToDevice::Start);
    line.extend(pcm(samples, 160).concat());
    line.extend(bytes(ToDevice::Stop));
    let messages = until_status(&mut machine, line, &mut link);
    assert_same(
        &frames(&messages),
        &host(&model, StreamSettings::of(Profile::Live), samples),
    );
    let lags = [Profile::Live, Profile::Standard, Profile::Studio]
        .map(|profile| expected_hello(&model, StreamSettings::of(profile)).lag_samples);
    assert!(lags.is_sorted() && lags[0] < lags[2], "{lags:?}");
}

#[test]
fn damage_on_the_way_to_the_device_is_counted_and_survived() {
    let firmware = firmware();
    let model = AnyModel::new_checked(&firmware.tables).unwrap();
    let samples = &common::hello()[..SHORT / 2];
    let mut machine = Machine::boot(&firmware.program);
    let mut link = Link::new(None);
    // Before Start: sound is not wanted, noise does no harm.
    machine.send_bytes(&[0x55; 700]);
    machine.send_bytes(&[0]);
    machine.send_bytes(&pcm(samples, 160)[0]);
    machine.send(ToDevice::Stop);

    let mut parts = pcm(samples, 160);
    // One damaged, one lost, one cut short by a stray zero: 3 hops do not arrive.
    parts[10][30] ^= 0x04;
    parts[20].clear();
    parts[30][40] = 0;
    let mut line = bytes(ToDevice::Start);
    line.extend(parts.concat());
    line.extend(bytes(ToDevice::Stop));
    let messages = until_status(&mut machine, line, &mut link);
    let Some(ToHost::Status(Status {
        overruns, dropped, ..
    })) = messages.last()
    else {
        panic!("the last message is {:?}", messages.last());
    };
    assert_eq!((*overruns, *dropped), (3, 0));

    let arrived: Vec<i16> = samples
        .chunks(160)
        .enumerate()
        .filter(|(i, _)| ![10, 20, 30].contains(i))
        .flat_map(|(_, hop)| hop.iter().copied())
        .collect();
    assert_same(
        &frames(&messages),
        &host(&model, StreamSettings::of(Profile::Standard), &arrived),
    );
}

/// Sound whose number has been seen before is heard, and nothing counts as lost.
#[test]
fn a_host_that_counts_anew_loses_nothing() {
    let firmware = firmware();
    let samples = &common::hello()[..SHORT / 4];
    let mut machine = Machine::boot(&firmware.program);
    let mut link = Link::new(None);
    let parts = pcm(samples, 160);
    let mut line = bytes(ToDevice::Start);
    for part in parts[..5]
        .iter()
        .chain([&parts[4]])
        .chain(&parts[..3])
        .chain([&parts[4]])
    {
        line.extend(part);
    }
    line.extend(bytes(ToDevice::Stop));
    let messages = until_status(&mut machine, line, &mut link);
    let Some(ToHost::Status(Status { overruns, .. })) = messages.last() else {
        panic!("the last message is {:?}", messages.last());
    };
    // Between the third hop and the fifth one is missing.
    assert_eq!(*overruns, 1);
}

/// A device says who it is when it is asked, to hosts of every protocol; it refuses those of another, and skips what it does not know.
#[test]
fn hello_can_be_asked_for_and_unknown_messages_are_counted() {
    let firmware = firmware();
    let model = AnyModel::new_checked(&firmware.tables).unwrap();
    let hello = ToHost::Hello(expected_hello(&model, StreamSettings::of(Profile::Standard)));
    let mut machine = Machine::boot(&firmware.program);
    let mut link = Link::new(Some(model.head().id()));
    // Beside it goes what people should know: nobody wrote a calibration for servos.
    let notice = Notice::new(format_args!("servos stay off: there is no calibration in flash"));
    let notice = ToHost::Notice(notice);
    let messages = machine.talk(greeting(), &mut link, |messages| messages.len() == 2);
    assert_eq!(messages, [hello.clone(), notice.clone()]);
    // Message 9 between the sound, its CRC right: counted, and nothing is lost.
    let samples = &common::hello()[..SHORT / 4];
    let unknown = with_crc(9);
    let mut line = bytes(ToDevice::Start);
    for part in pcm(samples, 160) {
        line.extend(part);
        line.extend(&unknown);
    }
    line.extend(bytes(ToDevice::Stop));
    let messages = until_status(&mut machine, line, &mut link);
    let settings = StreamSettings::of(Profile::Standard);
    assert_same(&frames(&messages), &host(&model, settings, samples));
    let status = messages.iter().rev().find_map(|message| match message {
        ToHost::Status(status) => Some((status.unknown, status.overruns)),
        _ => None,
    });
    assert_eq!(status, Some((samples.len().div_ceil(160) as u32, 0)));
    // A host of another protocol in the middle of a stream: who the device is, and no frames any more.
    let mut line = bytes(ToDevice::Start);
    line.extend(bytes(ToDevice::Hello {
        protocol: PROTOCOL + 1,
    }));
    line.extend(pcm(samples, 160).concat());
    line.extend(bytes(ToDevice::Stop));
    line.extend(greeting());
    let messages = machine.talk(line, &mut link, |messages| messages.len() == 5);
    assert_eq!(
        messages,
        [hello.clone(), notice.clone(), hello.clone(), hello, notice]
    );
    assert_eq!(link.losses(), Losses::default());
}

/// The message of this number and no fields as one frame.
fn with_crc(number: u8) -> Vec<u8> {
    let mut crc = 0xffff_u16 ^ (u16::from(number) << 8);
    for _ in 0..8 {
        let carry = crc & 0x8000 != 0;
        crc = (crc << 1) ^ if carry { 0x1021 } else { 0 };
    }
    let [low, high] = crc.to_le_bytes();
    assert!(low != 0 && high != 0, "no COBS code inside");
    vec![4, number, low, high, 0]
}

/// Speech, silence, full-scale square wave, noise, speech much too loud: the firmware's bytes are the host's.
fn check_on_files(name: &str, firmware: &Firmware) {
    let model = AnyModel::new_checked(&firmware.tables).unwrap();
    let speech = common::hello();
    let mut samples = speech.clone();
    samples.extend([0; 8000]);
    samples.extend((0..8000).map(|i| if i / 40 % 2 == 0 { i16::MAX } else { i16::MIN }));
    let mut random = lipstream_tests::random::Random::new(3);
    samples.extend((0..8000).map(|_| random.next_u32() as i16));
    samples.extend(speech.iter().map(|sample| sample.saturating_mul(20)));
    let (sent, said) = run_on_file(&firmware.program, &common::folder(name), &samples);
    let mut link = Link::new(Some(model.head().id()));
    let mut messages = Vec::new();
    link.push(&sent, |message| messages.push(message)).unwrap();
    assert_eq!(link.losses(), Losses::default());
    assert_same(
        &frames(&messages),
        &host(&model, StreamSettings::of(Profile::Standard), &samples),
    );
    let (_, narrowed) = common::host_run(&model, StreamSettings::of(Profile::Standard), &samples);
    let status = Status {
        narrowed,
        ..Status::default()
    };
    assert_eq!(messages.last(), Some(&ToHost::Status(status)));
    assert!(said.starts_with("stack: "), "{said}");
}

#[test]
fn files_give_the_hosts_bytes() {
    check_on_files("firmware-files", firmware());
}

/// Another model, of random numbers, and every overflow and debug assertion of the device's code checked.
#[test]
fn random_model_with_every_check() {
    let tables = common::synthetic_tables();
    let program = build_firmware(
        BOARD,
        &common::folder("firmware-checked"),
        "checked",
        Some(&tables),
    );
    check_on_files("firmware-checked-files", &Firmware { program, tables });
}

/// Damaged tables end the program with one line.
#[test]
fn damaged_tables_are_refused() {
    let folder = common::folder("firmware-damaged");
    let mut tables = common::shipped_tables();
    let middle = tables.len() / 2;
    tables[middle] ^= 1;
    let program = build_firmware(BOARD, &folder, "firmware", Some(&tables));
    let said = qemu::refuses(&program);
    assert!(said.starts_with("lipstream: model is damaged"), "{said}");
    assert_eq!(said.trim_end().lines().count(), 1, "{said}");
}

/// Ten minutes of many speakers' speech through the firmware: the host's bytes. Needs LIPSTREAM_RESEARCH.
#[test]
#[ignore = "needs the research data: tests/run --research"]
fn ten_minutes_of_speech_give_the_hosts_bytes() {
    let shared =
        std::env::var_os("LIPSTREAM_RESEARCH").expect("LIPSTREAM_RESEARCH names the folder that holds data/");
    const LENGTH: usize = 10 * 60 * 16_000;
    let mut sounds = Vec::new();
    let mut folders = vec![PathBuf::from(shared).join("data/timit-sample")];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("the corpus") {
            let path = entry.expect("the corpus").path();
            match path.extension().and_then(|e| e.to_str()) {
                Some("wav") => sounds.push(path),
                _ if path.is_dir() => folders.push(path),
                _ => (),
            }
        }
    }
    sounds.sort();
    assert!(!sounds.is_empty(), "no sound in the corpus");
    let samples: Vec<i16> = sounds
        .iter()
        .cycle()
        .flat_map(|path| lipstream_media::sound::read(path).expect("speech").samples)
        .take(LENGTH)
        .collect();
    let firmware = firmware();
    let model = AnyModel::new_checked(&firmware.tables).unwrap();
    let (sent, _) = run_on_file(
        &firmware.program,
        &common::folder("firmware-ten-minutes"),
        &samples,
    );
    let mut link = Link::new(Some(model.head().id()));
    let mut messages = Vec::new();
    link.push(&sent, |message| messages.push(message)).unwrap();
    assert_eq!(link.losses(), Losses::default());
    let device = frames(&messages);
    assert_eq!(device.len(), (LENGTH - 400) / 160 + 1);
    assert_same(
        &device,
        &host(&model, StreamSettings::of(Profile::Standard), &samples),
    );
}
