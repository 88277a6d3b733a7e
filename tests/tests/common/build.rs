//! Firmware, built as it is flashed.
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;

use super::root;

/// Every board and its processor.
pub(crate) const BOARDS: [(&str, &str); 5] = [
    ("mps2-an386", "thumbv7em-none-eabihf"),
    ("pico", "thumbv6m-none-eabi"),
    ("pico2", "thumbv8m.main-none-eabihf"),
    ("xiao-sense", "thumbv7em-none-eabihf"),
    ("nano33-sense", "thumbv7em-none-eabihf"),
];

/// Builds the firmware for a board in a Cargo profile, with these tables or the shipped ones; puts the program into `folder`.
pub(crate) fn build_firmware(board: &str, folder: &Path, profile: &str, tables: Option<&[u8]>) -> PathBuf {
    build_firmware_with(board, board, folder, profile, tables)
}

/// The same with these Cargo features, the board's among them.
pub(crate) fn build_firmware_with(
    board: &str,
    features: &str,
    folder: &Path,
    profile: &str,
    tables: Option<&[u8]>,
) -> PathBuf {
    /// Both builds would leave their program at the same place.
    static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
    let _guard = ONE_AT_A_TIME.lock().expect("no build before this one failed");
    let (_, processor) = BOARDS.iter().find(|(name, _)| *name == board).expect("a board");
    let target = Path::new(env!("CARGO_TARGET_TMPDIR"))
        .parent()
        .expect("inside the target folder");
    let mut cargo = Command::new(env!("CARGO"));
    cargo
        .current_dir(root())
        .args(["build", "--locked", "--package", "lipstream-firmware"])
        .args(["--features", features, "--bin", board])
        .args(["--profile", profile, "--target", processor])
        .arg("--target-dir")
        .arg(target)
        .env_remove("LIPSTREAM_TABLES");
    if let Some(tables) = tables {
        let path = folder.join("model.tables");
        std::fs::write(&path, tables).expect("write the tables");
        cargo.env("LIPSTREAM_TABLES", path);
    }
    let output = cargo.output().expect("run cargo");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let program = folder.join(board);
    let built = target.join(processor).join(profile).join(board);
    std::fs::copy(built, &program).expect("the program");
    program
}
