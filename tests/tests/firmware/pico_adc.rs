//! The Pico with an amplifier's voltage at its ADC (feature `adc`), in rp2040js: counts of 12 bits come by the ADC, its FIFO and DMA; what leaves by USB and
//! UART is what the core gives on the host for the sound that the firmware's own filter makes of the same counts.
use lipstream_core::wire::{Profile, ToHost};
use lipstream_firmware::decimate::{Decimator, FACTOR};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg32;
use serde_json::json;

use crate::common;
use crate::common::build::build_firmware_with;
use crate::compare::{assert_same, expected_hello, frames, host};
use crate::pico::{emulate_bytes, last_status, model, pico_settings, read, uf2};

/// What the board does not listen to while a microphone settles.
const SETTLING: usize = 4800;
const LENGTH: usize = 20_000;
/// The amplifier's output in silence, 1.25 V of 3.3 (MAX9814).
const SILENCE: f64 = 1551.0;

/// The converter's counts while the microphone settles, which are noise from end to end, and then for speech, a line from sample to sample, with two
/// counts of the converter's own noise.
fn counts(speech: &[i16]) -> Vec<u16> {
    let mut random = Pcg32::seed_from_u64(17);
    let mut counts: Vec<u16> = (0..SETTLING * FACTOR)
        .map(|_| random.random_range(0..4096))
        .collect();
    for pair in speech.windows(2) {
        let [from, to] = [pair[0], pair[1]].map(f64::from);
        counts.extend((0..FACTOR).map(|k| {
            let between = from + (to - from) * k as f64 / FACTOR as f64;
            let noise: f64 = random.random_range(-2.0..2.0);
            (SILENCE + between / 16.0 + noise).round().clamp(0.0, 4095.0) as u16
        }));
    }
    counts
}

#[test]
fn a_voltage_gives_the_hosts_bytes() {
    let folder = common::folder("pico-adc-program");
    let program = build_firmware_with("pico", "pico,adc", &folder, "firmware", None);
    let program = program.to_str().expect("an ordinary name");
    let file = uf2(&folder, "pico.uf2", &["--program", program]);
    let mut counts = counts(&common::hello()[..LENGTH]);
    let bytes: Vec<u8> = counts.iter().flat_map(|count| count.to_le_bytes()).collect();
    let job = json!({ "events": [], "flash": [file], "adc": true });
    let model = model();
    let said = read(&model, &emulate_bytes("pico-adc", &bytes, job));
    // The last one is heard until the emulator stops.
    counts.extend(vec![counts[counts.len() - 1]; 1600 * FACTOR]);
    let mut decimator = Decimator::new();
    let eights = counts.as_chunks().0.iter();
    let sound: Vec<i16> = eights.map(|counts| decimator.push(*counts)).collect();
    let settings = pico_settings(Profile::Standard);
    let expected = host(&model, settings, &sound[SETTLING..]);
    for messages in [&said.usb, &said.uart] {
        assert_eq!(messages[0], ToHost::Hello(expected_hello(&model, settings)));
        let frames = frames(messages);
        assert!(frames.len() >= LENGTH / 160, "{} frames", frames.len());
        assert_same(&frames, &expected[..frames.len()]);
    }
    let status = last_status(&said.usb);
    println!("{status:?} {}", said.report);
    assert_eq!((status.overruns, status.dropped), (0, 0));
    assert_eq!(said.report["countClock"], 128_000);
    assert_eq!(said.report["starts"], json!([]));
    // The sound, its filter, USB and UART, everything: some of a second is left.
    let [awake, cycles] = ["awake", "cycles"].map(|name| said.report[name].as_f64().expect("a number"));
    assert!(awake / cycles < 0.75, "{}", awake / cycles);
}
