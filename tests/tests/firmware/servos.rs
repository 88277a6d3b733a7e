//! Pulses for servos as they leave the boards, measured at the Pico's pins and read off the emulated board's line, against what the core asks for with the same
//! sound.
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use lipstream::link::Link;
use lipstream::opening::OpeningReader;
use lipstream_core::servo::{
    Calibration, Channel, Driver, Mouth, Role, STRAIGHT, Servos, WEIGHT_ONE, output,
};
use lipstream_core::wire::{Profile, ToHost};
use lipstream_core::{AnyModel, StreamSettings};
use serde_json::{Value, json};

use crate::common;
use crate::common::build::build_firmware;
use crate::common::qemu::run_on_file_with;
use crate::pico::{emulate, flashed, model, notices, other_tables, pico_settings, uf2};

/// Speech for the slow start of three servos, and for what moves them then.
const LENGTH: usize = 30_000;
/// Where the calibration lies in the emulated board's flash (`memory.x`).
const MPS2_SERVOS: usize = 0x10_0000;

/// A jaw, the width, and a tongue by visemes, for the shipped model.
fn calibration(driver: Driver) -> Calibration {
    let jaw = Channel {
        role: Role::Jaw,
        output: 5,
        reversed: false,
        lowest: 4_000,
        centre: 4_000,
        highest: 8_000,
        speed: 400,
        acceleration: 200,
        gap_weight: WEIGHT_ONE,
        width_weight: 0,
        viseme_weights: [0; 13],
        curve: STRAIGHT,
    };
    let width = Channel {
        role: Role::Width,
        output: 0,
        reversed: true,
        centre: 6_001,
        gap_weight: 0,
        width_weight: WEIGHT_ONE,
        ..jaw
    };
    let tongue = Channel {
        role: Role::Tongue,
        output: 2,
        gap_weight: 0,
        viseme_weights: std::array::from_fn(|k| if k == 10 || k == 7 { WEIGHT_ONE } else { 8 }),
        ..jaw
    };
    let model = model();
    let reader = OpeningReader::shipped()
        .expect("the shipped model")
        .expect("a mouth");
    let scales: Vec<f32> = model.head().parameter_scales().collect();
    Calibration::of(&[jaw, width, tongue])
        .expect("a calibration")
        .driven_by(driver)
        .reading(reader.read_out(model.head().id(), &scales))
}

type Wanted = Vec<(u8, Option<u16>)>;

/// What the core asks for, hop by hop.
fn wanted(settings: StreamSettings, calibration: &Calibration, samples: &[i16]) -> Vec<Wanted> {
    let mut servos = Servos::slowly(calibration);
    let read_out = calibration.read_out().expect("a read-out");
    let frames = common::host_frames(&model(), settings, samples);
    let hops = frames.iter().map(|frame| {
        let (gap, width) = read_out.read(&frame.values);
        servos.step(&Mouth {
            gap,
            width,
            viseme_weights: &frame.viseme_weights,
        });
        servos.driven().collect()
    });
    hops.collect()
}

/// The file by which `lipstream flash` writes the table, in a folder of this name.
fn flashed_table(name: &str, calibration: &Calibration) -> PathBuf {
    let folder = common::folder(name);
    let table = folder.join("servos.table");
    std::fs::write(&table, calibration.to_bytes()).expect("write the table");
    uf2(
        &folder,
        "servos.uf2",
        &["--servos", table.to_str().expect("an ordinary name")],
    )
}

/// A pulse at a pin, µs.
#[derive(Clone, Copy, Debug)]
struct Pulse {
    rose: f64,
    high: f64,
}

/// Pulses by pin.
fn pulses(folder: &Path) -> BTreeMap<u8, Vec<Pulse>> {
    let text = std::fs::read(folder.join("pulses.json")).expect("the pulses");
    let all: Vec<(u8, f64, f64)> = serde_json::from_slice(&text).expect("pulses");
    let mut pins = BTreeMap::<u8, Vec<Pulse>>::new();
    for (pin, rose, high) in all {
        pins.entry(pin).or_default().push(Pulse { rose, high });
    }
    pins
}

/// Whether every pulse is that of the hop that a period of 20 ms took it from, `first` for the first of them all, or of one to either side: which frame
/// is ready when a period begins goes by what it took to compute.
fn is_of_hops(pins: &BTreeMap<u8, Vec<Pulse>>, hops: &[Wanted], first: usize) -> Result<usize, String> {
    let begin = pins.values().map(|p| p[0].rose).fold(f64::MAX, f64::min);
    let mut compared = 0;
    for (k, (output, _)) in hops[0].iter().enumerate() {
        let pulses = pins.get(&(2 + output)).map_or(&[][..], |p| p);
        let mut before = 0;
        for pulse in pulses {
            let periods = (pulse.rose - begin) / 20_000.0;
            let hop = first + 2 * periods.round() as usize;
            // The slices were started one after the other.
            let off = (periods - periods.round()).abs();
            let near = hop.saturating_sub(1).max(before)..=(hop + 1).min(hops.len() - 1);
            // Steps of ½ µs.
            let at = near.clone().find(|hop| {
                let want = hops[*hop][k].1.map(|pulse| f64::from(pulse.div_ceil(2)) / 2.0);
                want.is_some_and(|want| (want - pulse.high).abs() < 0.02)
            });
            match at {
                Some(hop) if off < 0.01 => before = hop,
                _ => {
                    return Err(format!(
                        "output {output}: {pulse:?} is of none of the hops {near:?}"
                    ));
                }
            }
            compared += 1;
        }
        // None is left out: from the channel's first hop to the last that was still made.
        let begun = hops.iter().take_while(|hop| hop[k].1.is_none()).count();
        let expected = (LENGTH / 160 - begun) / 2;
        if pulses.len() + 2 < expected {
            return Err(format!(
                "output {output}: {} pulses, not {expected}",
                pulses.len()
            ));
        }
    }
    Ok(compared)
}

/// What the board said by a port.
fn messages(folder: &Path, port: &str) -> Vec<ToHost> {
    let mut messages = Vec::new();
    let wire = std::fs::read(folder.join(port)).expect("what was sent");
    Link::new(Some(model().head().id()))
        .push(&wire, |message| messages.push(message))
        .expect("our own protocol and model");
    messages
}

#[test]
fn the_picos_pins_make_the_cores_pulses() {
    let calibration = calibration(Driver::Pins);
    let mut samples = common::hello()[..LENGTH].to_vec();
    let file = flashed_table("pico-servos-uf2", &calibration);
    let job = json!({ "events": [], "flash": [flashed(), file] });
    let folder = emulate("pico-servos", &samples, job);
    samples.extend([0; 1600]);
    let hops = wanted(pico_settings(Profile::Standard), &calibration, &samples);
    let pins = pulses(&folder);
    assert_eq!(
        pins.keys().copied().collect::<Vec<_>>(),
        [2, 4, 7],
        "only these are servos"
    );
    let fits: Vec<Result<usize, String>> = (0..4).map(|first| is_of_hops(&pins, &hops, first)).collect();
    assert!(fits.iter().any(Result::is_ok), "{fits:?}");
    println!("{fits:?}");
    // The comparison is of something: the jaw opens, and the second and third servo began later.
    let longest = pins[&7].iter().map(|pulse| pulse.high).fold(0.0, f64::max);
    assert!(longest > 1_150.0, "{longest}");
    let begin = [7, 2, 4].map(|pin| pins[&pin][0].rose);
    assert!((begin[1] - begin[0] - 250_000.0).abs() < 20_001.0, "{begin:?}");
    assert!((begin[2] - begin[1] - 250_000.0).abs() < 20_001.0, "{begin:?}");
}

/// A hard fault in the middle of it: the pulses end with their period, and the board says what happened.
#[test]
fn a_fault_lets_the_picos_servos_go() {
    let file = flashed_table("pico-servos-fault-uf2", &calibration(Driver::Pins));
    let job = json!({
        "events": [{ "ms": 300, "fault": true }],
        "flash": [flashed(), file],
        "milliseconds": 900,
    });
    let folder = emulate("pico-servos-fault", &common::hello()[..8_000], job);
    let report = std::fs::read(folder.join("report.json")).expect("the report");
    let report: Value = serde_json::from_slice(&report).expect("the report");
    let fault = report["faultUs"].as_f64().expect("a fault");
    let pins = pulses(&folder);
    let jaw = &pins[&7];
    assert!(jaw.len() > 8, "{} pulses before", jaw.len());
    let last = jaw.last().expect("a pulse");
    assert!(last.rose < fault + 20_000.0, "{last:?} after {fault}");
    // None is cut off, which a servo would follow: all are the centre's.
    assert!(
        jaw.iter().all(|pulse| (pulse.high - 1_000.0).abs() < 0.02),
        "{jaw:?}"
    );
    let said = messages(&folder, "uart.wire");
    let words = notices(&said);
    assert!(
        words.len() == 1 && words[0].starts_with("hard fault at 0x"),
        "{words:?}"
    );
}

/// A calibration that is damaged in flash: no pulses, words, and the mouth goes on.
#[test]
fn a_damaged_calibration_leaves_the_picos_servos_off() {
    let file = flashed_table("pico-servos-damaged-uf2", &calibration(Driver::Pins));
    let mut blocks = std::fs::read(&file).expect("the file");
    // Byte 30 of the table, behind the 32 that begin a block.
    blocks[32 + 30] ^= 1;
    std::fs::write(&file, blocks).expect("write the file");
    let folder = emulate(
        "pico-servos-damaged",
        &common::hello()[..4_000],
        json!({ "events": [], "flash": [flashed(), file] }),
    );
    assert!(pulses(&folder).is_empty());
    let messages = messages(&folder, "usb.wire");
    let ToHost::Notice(notice) = &messages[1] else {
        panic!("{:?}", &messages[1]);
    };
    assert!(
        notice
            .words
            .starts_with("servos stay off: a damaged servo calibration"),
        "{}",
        notice.words
    );
    assert!(
        messages
            .iter()
            .filter(|message| matches!(message, ToHost::Frame(_)))
            .count()
            > 20
    );
}

/// A damaged model and a calibration for another: both are said, one after the other, and the built-in model runs without servos.
#[test]
fn a_refused_model_and_refused_servos_are_both_said() {
    let folder = common::folder("pico-both-refused-uf2");
    let tables = other_tables();
    std::fs::write(folder.join("other.tables"), &tables).expect("write the tables");
    let path = folder.join("other.tables");
    let words = ["--model", path.to_str().expect("an ordinary name")];
    let other = uf2(&folder, "other.uf2", &words);
    let mut blocks = std::fs::read(&other).expect("the file");
    blocks[300 * 512 + 100] ^= 1;
    std::fs::write(&other, blocks).expect("write the file");
    let id = AnyModel::new_checked(&tables).expect("a model").head().id();
    let reader = OpeningReader::shipped()
        .expect("the shipped model")
        .expect("a mouth");
    let scales: Vec<f32> = model().head().parameter_scales().collect();
    let calibration = calibration(Driver::Pins).reading(reader.read_out(id, &scales));
    let servos = flashed_table("pico-both-servos-uf2", &calibration);
    let folder = emulate(
        "pico-both-refused",
        &common::hello()[..2_000],
        json!({ "events": [], "flash": [flashed(), other, servos] }),
    );
    assert!(pulses(&folder).is_empty());
    for port in ["usb.wire", "uart.wire"] {
        let said = messages(&folder, port);
        let words = notices(&said);
        assert_eq!(words.len(), 2, "{words:?}");
        assert!(words[0].starts_with("the model in flash is refused"), "{words:?}");
        assert!(words[1].starts_with("servos stay off"), "{words:?}");
    }
}

/// The emulated board says its servos' pulses on its second UART.
#[test]
fn the_emulated_boards_line_carries_the_cores_pulses() {
    let folder = common::folder("mps2-servos");
    let program = build_firmware("mps2-an386", &folder, "firmware", None);
    let loader = format!("loader,file=servos.table,addr={MPS2_SERVOS:#x},force-raw=on");
    let words = [
        "-serial",
        "null",
        "-serial",
        "file:servos.line",
        "-device",
        &loader,
    ];
    for driver in [Driver::Csv, Driver::Maestro] {
        let calibration = calibration(driver);
        std::fs::write(folder.join("servos.table"), calibration.to_bytes()).expect("write the table");
        run_on_file_with(&program, &folder, &common::hello(), &words);
        let line = std::fs::read(folder.join("servos.line")).expect("what was sent");
        let mut expected = Vec::new();
        if driver == Driver::Maestro {
            (0..24).for_each(|k| expected.extend(output::maestro(k, output::MAESTRO_OFF)));
        }
        let settings = StreamSettings::of(Profile::Standard);
        for hop in wanted(settings, &calibration, &common::hello()) {
            if driver == Driver::Csv {
                let mut text = String::new();
                output::csv(hop.iter().map(|(_, pulse)| pulse.unwrap_or(0)), &mut text).expect("text");
                expected.extend(text.into_bytes());
            } else {
                let asked = hop
                    .iter()
                    .filter_map(|(output, pulse)| Some((*output, (*pulse)?)));
                asked.for_each(|(channel, pulse)| expected.extend(output::maestro(channel, pulse)));
            }
        }
        assert!(
            line == expected,
            "{driver:?}: {} bytes, not {}",
            line.len(),
            expected.len()
        );
    }
}
