//! The board's memory map and the model's tables.
//!
//! The tables are `models/grid-s1.tables`, or the file that the environment variable LIPSTREAM_TABLES names; they
//! become part of the image.
use std::env;
use std::path::PathBuf;

/// A board's Cargo feature as the environment spells it, and the symbol that chooses its memory in `memory.x`.
const BOARDS: [(&str, &str); 1] = [("CARGO_FEATURE_MPS2_AN386", "BOARD_MPS2_AN386")];

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
    if tables.is_file() {
        println!("cargo::rustc-env=LIPSTREAM_TABLES_FILE={}", tables.display());
    } else {
        println!(
            "cargo::error=no model tables at {}: `lipstream export` makes them, LIPSTREAM_TABLES names them",
            tables.display()
        );
    }
}
