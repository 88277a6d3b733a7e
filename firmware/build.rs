//! The board's memory map and the model's tables.
//!
//! The tables are `models/grid-s1.tables`, or the file that the environment variable LIPSTREAM_TABLES names; they
//! become part of the image.
use std::env;
use std::path::PathBuf;

use lipstream_core::model::Model;

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
    println!("cargo::rustc-check-cfg=cfg(model_with_memory)");
    let Ok(bytes) = std::fs::read(&tables) else {
        println!(
            "cargo::error=no model tables at {}: `lipstream export` makes them, LIPSTREAM_TABLES names them",
            tables.display()
        );
        return;
    };
    println!("cargo::rustc-env=LIPSTREAM_TABLES_FILE={}", tables.display());
    // The stream gets as much room as this kind of model needs.
    match Model::new_checked(&bytes) {
        Ok(model) if model.is_recurrent() => println!("cargo::rustc-cfg=model_with_memory"),
        Ok(_) => (),
        // The device says it again at its start.
        Err(error) => println!("cargo::warning={} is no model: {error}", tables.display()),
    }
}
