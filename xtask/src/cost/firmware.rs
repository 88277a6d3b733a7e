//! What the firmware with the shipped model takes of a device: image, RAM, stack.
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use object::{Object, ObjectSection};

use super::{Numbers, cargo_build, qemu, raw};

const TARGET: &str = "thumbv7em-none-eabihf";
const PROGRAM: &str = "mps2-an386";

/// Rows of the table.
pub(crate) const ROWS: [(&str, &str); 8] = [
    ("bytes tables", "tables"),
    ("bytes rest", "code, constants and words, without the tables"),
    ("bytes image", "**image**"),
    (
        "bytes static",
        "RAM for everything that lives on (one stream, its line)",
    ),
    ("bytes running", "stack while it runs"),
    ("bytes ram", "**RAM while it runs**"),
    (
        "bytes starting",
        "stack while the stream is made, before any sound",
    ),
    ("bytes most", "**RAM at most**"),
];
/// What they may be at most, the aim that `docs/cost.md` states.
pub(crate) const MOST: [(&str, u64); 3] = [
    ("bytes tables", 256 * 1024),
    ("bytes image", 384 * 1024),
    ("bytes most", 48 * 1024),
];

/// Builds it as it is flashed, and lets it hear the shipped sound.
pub(crate) fn measure(root: &Path) -> Result<Numbers> {
    let what = ["--profile", "firmware", "-p", "lipstream-firmware"];
    let which = ["--features", PROGRAM, "--bin", PROGRAM];
    let program = cargo_build(root, TARGET, &[what, which].concat())?
        .join("firmware")
        .join(PROGRAM);
    let bytes = std::fs::read(&program).with_context(|| program.display().to_string())?;
    let file = object::File::parse(&*bytes)?;
    let size = |names: &[&str]| -> u64 {
        let sections = names.iter().filter_map(|name| file.section_by_name(name));
        sections.map(|section| section.size()).sum()
    };
    let image = size(&[".vector_table", ".text", ".rodata", ".data", ".model"]);
    let lives_on = size(&[".data", ".bss", ".uninit"]);
    let tables = std::fs::metadata(root.join("models/grid-s1.tables"))?.len();
    let (starting, running) = stack(&program, root.join("data/hello.wav"))?;
    let numbers = [
        ("bytes tables", tables),
        ("bytes rest", image - tables),
        ("bytes image", image),
        ("bytes static", lives_on),
        ("bytes running", running),
        ("bytes ram", lives_on + running),
        ("bytes starting", starting),
        ("bytes most", lives_on + starting.max(running)),
    ];
    Ok(numbers.map(|(name, value)| (name.to_owned(), value)).into())
}

/// Bytes of stack to make the stream and to run it, as the program says them itself.
fn stack(program: &Path, sound: PathBuf) -> Result<(u64, u64)> {
    let folder = tempfile::tempdir()?;
    std::fs::write(folder.path().join("input.pcm"), raw(&[sound])?)?;
    let output = qemu(program, folder.path(), &[PROGRAM, "--files"])?;
    let said = String::from_utf8_lossy(&output.stdout);
    let numbers: Vec<u64> = said
        .split_whitespace()
        .filter_map(|word| word.parse().ok())
        .collect();
    match numbers[..] {
        [starting, running] if said.starts_with("stack: ") => Ok((starting, running)),
        _ => bail!("the firmware said {said:?}, not what stack it used"),
    }
}
