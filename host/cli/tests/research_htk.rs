//! The front end against files that HTK's own HCopy has written: recordings among the research data, in the folder that
//! LIPSTREAM_RESEARCH names. `golden_htk.rs` does the same with a pair that is in the repository.
mod common;

use std::path::Path;

use common::hcopy::{self, Pair};
use lipstream::reference;

fn golden() -> Vec<Pair> {
    let shared =
        std::env::var_os("LIPSTREAM_RESEARCH").expect("LIPSTREAM_RESEARCH names the folder that holds data/");
    hcopy::pairs(&Path::new(&shared).join("golden/htk"), 3)
}

#[test]
#[ignore = "needs the research data: tests/run --research"]
fn every_coefficient_equals_hcopy() {
    let pairs = golden();
    hcopy::every_coefficient_equals_hcopy(&pairs);
}

/// The same through the program, in both formats: header words and numbers of HCopy's own files.
#[test]
#[ignore = "needs the research data: tests/run --research"]
fn the_program_writes_what_hcopy_writes() {
    let pairs = golden();
    hcopy::the_program_writes_what_hcopy_writes(&pairs, env!("CARGO_BIN_EXE_lipstream"));
}

/// The integers on c1..c12 against HCopy itself.
#[test]
#[ignore = "needs the research data: tests/run --research"]
fn integers_are_close_to_hcopy() {
    let pairs = golden();
    hcopy::integers_are_close_to_hcopy(&pairs, 40.0);
}

/// … and against the `f64` front end at three levels.
#[test]
#[ignore = "needs the research data: tests/run --research"]
fn integers_are_accurate_at_every_level() {
    let pairs = golden();
    hcopy::integers_are_accurate_at_every_level(&pairs);
}

/// Which share of recorded sentences the gate calls speech: the time constant of 256 such frames is four to seven seconds of talk.
#[test]
#[ignore = "needs the research data: tests/run --research"]
fn the_gate_passes_half_of_recorded_talk() {
    let pairs = golden();
    for pair in pairs {
        let raw = reference::statics(&pair.samples);
        let mut gate = reference::normalise::SpeechGate::default();
        let open = raw.column(12).iter().filter(|&&e| gate.next(e)).count();
        let seconds = 2.56 * raw.nrows() as f64 / open as f64;
        println!("{}: {seconds:.1} s of talk", pair.name);
        assert!((3.5..7.0).contains(&seconds), "{}: {seconds} s", pair.name);
    }
}
