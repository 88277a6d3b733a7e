//! The board's memory map and the model's tables.
//!
//! The tables are `models/grid-s1.tables`, or the file that the environment variable LIPSTREAM_TABLES names; they
//! become part of the image, and their kind is that of the program.
use std::env;
use std::path::PathBuf;

use lipstream_core::AnyModel;

/// A board's Cargo feature as the environment spells it, and the symbol that chooses its memory in `memory.x`.
const BOARDS: [(&str, &str); 5] = [
    ("CARGO_FEATURE_MPS2_AN386", "BOARD_MPS2_AN386"),
    ("CARGO_FEATURE_NANO33_SENSE", "BOARD_NANO33_SENSE"),
    ("CARGO_FEATURE_PICO", "BOARD_PICO"),
    ("CARGO_FEATURE_PICO2", "BOARD_PICO2"),
    ("CARGO_FEATURE_XIAO_SENSE", "BOARD_XIAO_SENSE"),
];

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=../memory.x");
    println!("cargo::rerun-if-env-changed=LIPSTREAM_TABLES");
    let mut boards = BOARDS
        .iter()
        .filter(|(feature, _)| env::var_os(feature).is_some());
    // Without a board there is only the library.
    let Some((_, symbol)) = boards.next() else {
        return;
    };
    if boards.next().is_some() {
        println!("cargo::error=choose one board");
        return;
    }
    if env::var_os("CARGO_FEATURE_ADC").is_some() && *symbol != "BOARD_PICO" {
        println!("cargo::error=adc is a microphone of the Pico's: choose pico, or leave it out");
        return;
    }
    // Before cortex-m-rt's script: whoever names a section first has it.
    if ["BOARD_PICO", "BOARD_PICO2"].contains(symbol) {
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/boards/rp2/hot.x");
        println!("cargo::rerun-if-changed={script}");
        println!("cargo::rustc-link-arg-bins=-T{script}");
    }
    if env::var_os("CARGO_FEATURE_DEFMT").is_some() {
        if *symbol == "BOARD_MPS2_AN386" {
            println!(
                "cargo::error=mps2-an386 has no debug probe that reads logs: choose a board that one can buy"
            );
            return;
        }
        println!("cargo::rustc-link-arg-bins=-Tdefmt.x");
    }
    // memory.x is found in the workspace root.
    for argument in ["--nmagic", "-Tlink.x", &format!("--defsym={symbol}=1")] {
        println!("cargo::rustc-link-arg-bins={argument}");
    }

    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("..");
    let tables = match env::var_os("LIPSTREAM_TABLES") {
        // Relative to where cargo keeps the workspace.
        Some(path) => root.join(path),
        None => root.join("models/grid-s1.tables"),
    };
    println!("cargo::rerun-if-changed={}", tables.display());
    let Ok(bytes) = std::fs::read(&tables) else {
        println!(
            "cargo::error=no model tables at {}: `lipstream export` makes them, LIPSTREAM_TABLES names them",
            tables.display()
        );
        return;
    };
    println!("cargo::rustc-env=LIPSTREAM_TABLES_FILE={}", tables.display());
    // A program runs one kind of model, and has room for nothing else.
    let kind = match AnyModel::new_checked(&bytes) {
        Ok(model) => model.kind_name(),
        Err(error) => {
            // The device says it again at its start, whatever kind it was built for.
            println!("cargo::warning={} is no model: {error}", tables.display());
            "Recurrent"
        }
    };
    let to = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets it")).join("kind.rs");
    let text = format!(
        "/// The kind of the tables.\npub(crate) type Kind = lipstream_core::kinds::{kind}<'static>;\n"
    );
    if let Err(error) = std::fs::write(&to, text) {
        println!("cargo::error=cannot write {}: {error}", to.display());
    }
}
