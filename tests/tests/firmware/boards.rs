//! What every board's program takes of its flash and RAM, against what it may take.
use std::collections::BTreeMap;

use object::{Object, ObjectSection};

use crate::common;
use crate::common::build::{BOARDS, build_firmware_with};

/// Bytes at most: of the program without its model; of RAM that lives on, without stack and a model's copy.
const MOST_PROGRAM: u64 = 160 * 1024;
const MOST_STATIC: u64 = 32 * 1024;
/// The counts of 32 ms beside those, where the ADC hears (`firmware/boards/rp2/sound.rs`).
const ADC_RING: u64 = 8 * 1024;
/// Code and constants that are copied to RAM, at most (`firmware/boards/rp2/hot.x`).
const MOST_HOT: u64 = 72 * 1024;
/// Room for copies of a model's sections in RAM, where the board makes them (`firmware/boards/rp2/fast.rs`).
const COPIES: [(&str, u64); 2] = [("pico", 116 * 1024), ("pico2", 352 * 1024)];

#[test]
fn every_board_fits() {
    let tables = common::shipped_tables();
    let all = BOARDS.iter().map(|(board, _)| (*board, *board));
    // With what can be chosen for it beside the board.
    for (board, features) in all.chain([("pico", "pico,adc")]) {
        let folder = common::folder(&format!("fits-{features}"));
        let program = build_firmware_with(board, features, &folder, "firmware", None);
        let bytes = std::fs::read(program).expect("the program");
        let file = object::File::parse(&*bytes).expect("an ELF file");
        let sections: BTreeMap<&str, u64> = file
            .sections()
            .filter_map(|section| Some((section.name().ok()?, section.size())))
            .collect();
        let size = |names: &[&str]| names.iter().filter_map(|name| sections.get(name)).sum::<u64>();
        let program = size(&[
            ".boot2",
            ".hot",
            ".vector_table",
            ".start_block",
            ".text",
            ".rodata",
            ".data",
        ]);
        let copy = COPIES
            .iter()
            .find(|(name, _)| *name == board)
            .map_or(0, |(_, size)| *size);
        let lives_on = size(&[".data", ".bss", ".uninit"]) - copy;
        let hot = size(&[".hot"]);
        println!(
            "{features}: program {program}, model {}, RAM {lives_on}, code {hot} and {copy} for the model",
            sections[".model"]
        );
        assert!(hot <= MOST_HOT, "{features}: {hot} bytes of code in RAM");
        assert_eq!(sections[".model"], tables.len() as u64, "{features}");
        assert!(program <= MOST_PROGRAM, "{features}: program of {program} bytes");
        let most = MOST_STATIC + if features == "pico,adc" { ADC_RING } else { 0 };
        assert!(lives_on <= most, "{features}: {lives_on} bytes of RAM");
    }
}
