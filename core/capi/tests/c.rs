//! The library as C programs see it: compiled by C compilers, linked, run, and held against the Rust program.
//!
//! Needs `cc`, and `arm-none-eabi-gcc` for the sketch of a board; `tests/run` installs them.
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Mutex;

use lipstream::engine::stream;
use lipstream_core::wire::Profile;
use lipstream_core::{AnyModel, StreamSettings};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Runs a program to its end; a failure shows what it said.
fn run(command: &mut Command) -> Output {
    let output = command.output().unwrap_or_else(|e| panic!("{command:?}: {e}"));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {said}");
    output
}

/// The static library, built in a Cargo profile, for the host or another target.
fn library(profile: &str, target: Option<&str>) -> PathBuf {
    static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
    let _guard = ONE_AT_A_TIME.lock().unwrap();
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).parent().unwrap();
    let mut cargo = Command::new(env!("CARGO"));
    cargo
        .current_dir(root())
        .args(["rustc", "--locked", "--package", "lipstream-capi", "--lib"]);
    cargo.args(["--crate-type", "staticlib", "--profile", profile]);
    cargo.arg("--target-dir").arg(folder);
    if let Some(target) = target {
        cargo.args(["--target", target]);
    }
    run(&mut cargo);
    let named = if profile == "dev" { "debug" } else { profile };
    folder
        .join(target.unwrap_or_default())
        .join(named)
        .join("liblipstream_c.a")
}

/// `examples/convert.c`, compiled with every warning an error.
fn convert(folder: &Path) -> PathBuf {
    let program = folder.join("convert");
    let capi = root().join("core/capi");
    run(Command::new("cc")
        .args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-I"])
        .arg(&capi)
        .arg(capi.join("examples/convert.c"))
        .arg(library("dev", None))
        .args(["-lpthread", "-ldl", "-lm", "-o"])
        .arg(&program));
    program
}

#[test]
fn a_c_program_converts_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let program = convert(folder.path());
    let (tables, speech) = (
        root().join("models/grid-s1.tables"),
        root().join("data/hello.wav"),
    );
    let said = run(Command::new(&program).arg(&tables).arg(&speech)).stdout;

    let bytes = std::fs::read(&tables).unwrap();
    let model = AnyModel::new_checked(&bytes).unwrap();
    let samples = lipstream_media::sound::read(&speech).unwrap().samples;
    let want = stream(&model, &samples, StreamSettings::of(Profile::Studio)).unwrap();
    let want: Vec<u8> = want.parameters.iter().flat_map(|v| v.to_le_bytes()).collect();
    assert!(
        said == want,
        "{} bytes from C, {} from Rust",
        said.len(),
        want.len()
    );

    // Damaged tables are refused in the core's own words.
    let mut damaged = bytes;
    damaged[1000] ^= 1;
    let path = folder.path().join("damaged.tables");
    std::fs::write(&path, damaged).unwrap();
    let refused = Command::new(&program).arg(&path).arg(&speech).output().unwrap();
    assert_eq!(refused.status.code(), Some(1));
    assert!(refused.stdout.is_empty());
    let why = String::from_utf8_lossy(&refused.stderr);
    assert!(why.contains("model is damaged: checksum"), "{why}");
}

/// The sketch compiles for a Cortex-M4 without any C library, and nothing that it calls is missing when it is linked.
#[test]
fn a_sketch_compiles_and_links_for_a_board() {
    let folder = tempfile::tempdir().unwrap();
    let capi = root().join("core/capi");
    let board = folder.path().join("board.cpp");
    let stubs = "extern \"C\" { extern const unsigned char grid_s1_tables[4] = {0, 0, 0, 0}; extern const unsigned int grid_s1_tables_len = 4;\n\
         int read_microphone(short *, int) { return 0; } void move_jaw(int) {} }\n\
         void setup(); void loop(); extern \"C\" void start() { setup(); for (;;) loop(); }\n";
    std::fs::write(&board, stubs).unwrap();
    let tables = "extern \"C\" { extern const unsigned char grid_s1_tables[]; extern const unsigned int grid_s1_tables_len; }\n";
    std::fs::write(folder.path().join("tables.h"), tables).unwrap();
    let program = folder.path().join("mouth.elf");
    run(Command::new("arm-none-eabi-gcc")
        .args([
            "-x",
            "c++",
            "-mcpu=cortex-m4",
            "-mthumb",
            "-mfloat-abi=hard",
            "-mfpu=fpv4-sp-d16",
        ])
        .args([
            "-Os",
            "-ffreestanding",
            "-fno-exceptions",
            "-Wall",
            "-Wextra",
            "-Werror",
            "-I",
        ])
        .arg(&capi)
        .arg("-I")
        .arg(folder.path())
        .arg(capi.join("examples/mouth/mouth.ino"))
        .arg(&board)
        .args(["-x", "none"])
        .arg(library("firmware", Some("thumbv7em-none-eabihf")))
        .args(["-nostdlib", "-lgcc", "-Wl,-e,start", "-o"])
        .arg(&program));
    assert!(std::fs::metadata(&program).unwrap().len() > 10_000);
}
