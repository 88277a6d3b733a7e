//! Measures what the front end, a whole stream, servos and the firmware cost on Cortex-M and writes `docs/cost.md`, or checks that nothing has grown.
//!
//! ```text
//! cargo xtask cost                                          writes docs/cost.md
//! cargo xtask cost --check                                  fails where a number there has grown by more than 5 %
//! cargo xtask cost --stream TABLES SOUND...                 counts a stream of these tables over these sounds
//! cargo xtask cost --scaling MODEL.safetensors SOUND...  the same as sizes and settings change
//! ```
//!
//! Instructions are counted in QEMU (`-icount`): the same on every machine and every run.
mod firmware;
mod scaling;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use anyhow::{Context, Result, bail};
use lipstream::export::export_hierarchical;
use lipstream::kinds::hierarchical::drawn;
use object::{Object, ObjectSection, ObjectSymbol};
use rand::SeedableRng as _;
use rand_pcg::Pcg64;

const TARGETS: [&str; 2] = ["thumbv7em-none-eabihf", "thumbv6m-none-eabi"];

/// Most instructions of a hop on Cortex-M4 with all 39 numbers.
const MOST_INSTRUCTIONS: u64 = 36_000;

/// Rows of the table: the program's name for a number, and ours.
const ROWS: [(&str, &str); 16] = [
    ("instructions energy", "energy"),
    ("instructions window", "pre-emphasis and window"),
    ("instructions fft", "FFT"),
    ("instructions magnitude", "split and magnitude"),
    ("instructions mel", "mel"),
    ("instructions log", "log"),
    ("instructions dct", "DCT and lifter"),
    ("instructions delta", "Δ and ΔΔ"),
    ("instructions normalise", "normalisation"),
    ("instructions whole_mean", "**a hop, all 39 numbers, mean**"),
    ("instructions whole_worst", "**a hop, worst**"),
    ("bytes code", "code, bytes"),
    ("bytes tables", "tables, bytes"),
    ("bytes state", "state (static RAM), bytes"),
    ("bytes stack", "stack of a hop, bytes"),
    ("bytes flash", "code and tables, bytes"),
];

/// Rows of the servos' table.
const SERVO_ROWS: [(&str, &str); 3] = [
    ("instructions servos_mean", "six servos, mean of a hop"),
    ("instructions servos_worst", "six servos, worst hop"),
    ("bytes servos", "state of six servos and the read-out, bytes"),
];

/// Rows of the stream's table.
const STREAM_ROWS: [(&str, &str); 19] = [
    ("instructions frontend_mean", "front end, mean of a hop"),
    ("instructions context_mean", "context and projection, mean"),
    ("instructions follow_mean", "following the joint states, mean"),
    ("instructions gates_mean", "occupancies and gates, mean"),
    ("instructions memory_mean", "memory and mouth, mean"),
    ("instructions second_mean", "second memory, mean"),
    ("instructions settle_mean", "settling and viseme weights, mean"),
    ("instructions frontend_worst", "front end, worst hop"),
    ("instructions context_worst", "context and projection, worst"),
    ("instructions follow_worst", "following the joint states, worst"),
    ("instructions gates_worst", "occupancies and gates, worst"),
    ("instructions memory_worst", "memory and mouth, worst"),
    ("instructions second_worst", "second memory, worst"),
    ("instructions settle_worst", "settling and viseme weights, worst"),
    ("instructions mean", "**a hop of the stream, mean**"),
    ("instructions worst", "**a hop of the stream, worst**"),
    ("active mean", "active joint states, mean"),
    ("active most", "active joint states, most"),
    ("bytes memory_stream", "state of the stream (static RAM), bytes"),
];
/// Rows of the table of a hierarchical model's stream.
const FACE_ROWS: [(&str, &str); 3] = [
    ("instructions face_mean", "a hop of the face's stream, mean"),
    ("instructions face_worst", "a hop of the face's stream, worst"),
    (
        "bytes face_stream",
        "state of the face's stream (static RAM), bytes",
    ),
];

/// Most instructions of a stream's hop over the shipped sound, on average and at worst.
const MOST_OF_STREAM: (u64, u64) = (200_000, 350_000);

pub(crate) type Numbers = BTreeMap<String, u64>;

pub(crate) fn run(words: &[String]) -> Result<()> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let check = match words.as_slice() {
        [] => false,
        ["--check"] => true,
        ["--stream", tables, sounds @ ..] if !sounds.is_empty() => {
            let sounds: Vec<PathBuf> = sounds.iter().map(PathBuf::from).collect();
            for (name, value) in measure_stream(&root, Path::new(tables), &sounds, None)? {
                println!("{name} {value}");
            }
            return Ok(());
        }
        ["--scaling", model, sounds @ ..] if !sounds.is_empty() => {
            let sounds: Vec<PathBuf> = sounds.iter().map(PathBuf::from).collect();
            return scaling::run(&root, Path::new(model), &sounds);
        }
        other => bail!(
            "unknown options {other:?}; there are --check, --stream TABLES SOUND... and --scaling MODEL SOUND..."
        ),
    };
    let document = root.join("docs/cost.md");
    let measured = TARGETS.map(|target| measure(&root, target));
    let [cortex_m4, cortex_m0] = measured;
    let mut columns = [cortex_m4?, cortex_m0?];
    for (target, numbers) in TARGETS.iter().zip(&mut columns) {
        numbers.extend(measure_face(&root, target)?);
    }
    let stream = measure_stream(
        &root,
        &root.join("models/grid-s1.tables"),
        &[root.join("data/hello.wav")],
        None,
    )?;
    let firmware = firmware::measure(&root)?;
    if check {
        let text = std::fs::read_to_string(&document).with_context(|| document.display().to_string())?;
        return compare(&text, &columns, &stream, &firmware);
    }
    std::fs::write(&document, render(&columns, &stream, &firmware))
        .with_context(|| document.display().to_string())?;
    println!("wrote docs/cost.md");
    Ok(())
}

/// Counts a stream of these tables over these sounds, one after the other, on Cortex-M4; the mouth re-estimated with
/// this exponent (Q16.16), or mapped.
pub(crate) fn measure_stream(
    root: &Path,
    tables: &Path,
    sounds: &[PathBuf],
    feedback: Option<u32>,
) -> Result<Numbers> {
    measure_stream_on(root, TARGETS[0], tables, sounds, feedback)
}

/// A stream of a hierarchical model of the sizes that are trained on GRID, its numbers random: what it costs does not depend on them.
fn measure_face(root: &Path, target: &str) -> Result<Numbers> {
    let model = drawn::random(&drawn::Sizes::full(), &mut Pcg64::seed_from_u64(1))?;
    let tables = tempfile::NamedTempFile::new()?;
    std::fs::write(tables.path(), export_hierarchical(&model)?.bytes)?;
    let sounds = [root.join("data/hello.wav")];
    let numbers = measure_stream_on(root, target, tables.path(), &sounds, None)?;
    let renamed = |(name, value): (String, u64)| match name.as_str() {
        "instructions mean" => Some(("instructions face_mean".to_owned(), value)),
        "instructions worst" => Some(("instructions face_worst".to_owned(), value)),
        "bytes face_stream" => Some((name, value)),
        _ => None,
    };
    Ok(numbers.into_iter().filter_map(renamed).collect())
}

/// [`measure_stream`] in another target's code.
fn measure_stream_on(
    root: &Path,
    target: &str,
    tables: &Path,
    sounds: &[PathBuf],
    feedback: Option<u32>,
) -> Result<Numbers> {
    let program = build(root, target, "stream_cost")?;
    let folder = tempfile::tempdir()?;
    std::fs::copy(tables, folder.path().join("model.tables"))
        .with_context(|| tables.display().to_string())?;
    std::fs::write(folder.path().join("sound.raw"), raw(sounds)?)?;
    if let Some(exponent) = feedback {
        std::fs::write(folder.path().join("feedback.raw"), exponent.to_le_bytes())?;
    }
    count(&program, folder.path())
}

/// Builds the counting program for a target, runs it, reads its symbols.
fn measure(root: &Path, target: &str) -> Result<Numbers> {
    let program = build(root, target, "frontend_cost")?;
    let mut numbers = count(&program, root)?;
    let (code, tables) = sizes(&std::fs::read(&program)?)?;
    numbers.insert("bytes code".to_owned(), code);
    numbers.insert("bytes tables".to_owned(), tables);
    numbers.insert("bytes flash".to_owned(), code + tables);
    Ok(numbers)
}

/// Builds an example for a target.
fn build(root: &Path, target: &str, example: &str) -> Result<PathBuf> {
    let what = ["--release", "-p", "lipstream-tests", "--example", example];
    Ok(cargo_build(root, target, &what)?
        .join("release/examples")
        .join(example))
}

/// `cargo build` of `what` for a target; the target's folder.
pub(crate) fn cargo_build(root: &Path, target: &str, what: &[&str]) -> Result<PathBuf> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let status = Command::new(cargo)
        .current_dir(root)
        .args(["build", "--locked", "--target", target])
        .args(what)
        .status()?;
    if !status.success() {
        bail!("cannot build {what:?} for {target} (`rustup target add {target}`?)");
    }
    let folder = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from);
    Ok(folder.join(target))
}

/// Runs a program in QEMU's mps2-an386 in `folder`, its instructions counted; `words` are what it is started with.
pub(crate) fn qemu(program: &Path, folder: &Path, words: &[&str]) -> Result<Output> {
    let mut semihosting = "enable=on,target=native".to_owned();
    for word in words {
        semihosting += &format!(",arg={word}");
    }
    Command::new("qemu-system-arm")
        .args(["-machine", "mps2-an386", "-display", "none", "-monitor", "none"])
        .args(["-serial", "null", "-icount", "shift=6,align=off,sleep=off"])
        .args(["-semihosting-config", &semihosting, "-kernel"])
        .arg(program.canonicalize()?)
        .current_dir(folder)
        .output()
        .context("qemu-system-arm (Debian's package of that name) is needed")
}

/// Samples of sounds one after the other, as bytes.
pub(crate) fn raw(sounds: &[PathBuf]) -> Result<Vec<u8>> {
    let mut raw = Vec::new();
    for sound in sounds {
        let samples = lipstream_media::sound::read(sound)?.samples;
        raw.extend(samples.iter().flat_map(|s| s.to_le_bytes()));
    }
    Ok(raw)
}

/// Runs a counting program in QEMU in `folder`: lines of a name and a number.
fn count(program: &Path, folder: &Path) -> Result<Numbers> {
    let output = qemu(program, folder, &[])?;
    let text = String::from_utf8_lossy(&output.stdout);
    if !output.status.success() {
        bail!("{} failed: {text}", program.display());
    }
    let mut numbers = Numbers::new();
    for line in text.lines() {
        let (name, value) = line.rsplit_once(' ').context("a line without a number")?;
        numbers.insert(name.to_owned(), value.parse()?);
    }
    Ok(numbers)
}

/// Bytes of the front end's functions and of its tables in a program.
fn sizes(program: &[u8]) -> Result<(u64, u64)> {
    let file = object::File::parse(program)?;
    let (mut code, mut tables) = (0, 0);
    for symbol in file.symbols() {
        let name = symbol.name()?;
        if !name.contains("lipstream_core") {
            continue;
        }
        if name.contains("6tables") {
            tables += symbol.size();
        } else if name.contains("8frontend") || name.contains("..frontend") {
            code += symbol.size();
        }
    }
    let text = file.section_by_name(".text").context("no .text")?.size();
    if code == 0 || tables == 0 || code > text {
        bail!("symbols of the front end: {code} bytes of code, {tables} of tables");
    }
    Ok((code, tables))
}

fn row(name: &str, label: &str, columns: &[Numbers]) -> String {
    let values: Vec<String> = columns
        .iter()
        .map(|numbers| numbers.get(name).map_or("?".to_owned(), u64::to_string))
        .collect();
    format!("| {label} | {} |\n", values.join(" | "))
}

fn render(columns: &[Numbers], stream: &Numbers, firmware: &Numbers) -> String {
    let both = |rows: &[(&str, &str)]| {
        let head = "| | Cortex-M4 (`thumbv7em`) | Cortex-M0+ (`thumbv6m`) |\n|---|---|---|\n";
        let rows = rows.iter().map(|(name, label)| row(name, label, columns));
        head.to_owned() + &rows.collect::<String>()
    };
    let mut of_stream = String::from("| | Cortex-M4 |\n|---|---|\n");
    for (name, label) in STREAM_ROWS {
        of_stream += &row(name, label, std::slice::from_ref(stream));
    }
    let mut of_firmware = String::from("| | bytes |\n|---|---|\n");
    for (name, label) in firmware::ROWS {
        of_firmware += &row(name, label, std::slice::from_ref(firmware));
    }
    include_str!("cost.md.in")
        .replace("FIRMWARE\n", &of_firmware)
        .replace("STREAM\n", &of_stream)
        .replace("SERVOS\n", &both(&SERVO_ROWS))
        .replace("FACE\n", &both(&FACE_ROWS))
        .replace("TABLE\n", &both(&ROWS))
}

/// Every number of the committed table, against what was measured now.
fn compare(text: &str, columns: &[Numbers], stream: &Numbers, firmware: &Numbers) -> Result<()> {
    let mut worse = Vec::new();
    let rows = ROWS
        .iter()
        .chain(&SERVO_ROWS)
        .chain(&FACE_ROWS)
        .map(|row| (row, columns));
    let of_stream = STREAM_ROWS.iter().map(|row| (row, std::slice::from_ref(stream)));
    let of_firmware = firmware::ROWS
        .iter()
        .map(|row| (row, std::slice::from_ref(firmware)));
    for ((name, label), columns) in rows.chain(of_stream).chain(of_firmware) {
        let line = text
            .lines()
            .find(|line| line.starts_with(&format!("| {label} |")))
            .with_context(|| format!("docs/cost.md has no row {label}"))?;
        let committed = line
            .split('|')
            .skip(2)
            .map(str::trim)
            .filter(|cell| !cell.is_empty());
        for ((target, numbers), was) in TARGETS.iter().zip(columns).zip(committed) {
            let was: u64 = was
                .parse()
                .with_context(|| format!("docs/cost.md, row {label}"))?;
            let is = *numbers
                .get(*name)
                .with_context(|| format!("{name} was not measured"))?;
            println!("{target:22} {label:34} {was:7} → {is:7}");
            if is * 100 > was * 105 {
                worse.push(format!("{label} on {target} grew from {was} to {is}"));
            }
        }
    }
    let whole = columns[0]["instructions whole_mean"];
    if whole > MOST_INSTRUCTIONS {
        worse.push(format!(
            "a hop costs {whole} instructions on Cortex-M4, more than {MOST_INSTRUCTIONS}"
        ));
    }
    let of_stream = (stream["instructions mean"], stream["instructions worst"]);
    if of_stream.0 > MOST_OF_STREAM.0 || of_stream.1 > MOST_OF_STREAM.1 {
        worse.push(format!(
            "a hop of the stream costs {of_stream:?} instructions on average and at worst, more than {MOST_OF_STREAM:?}"
        ));
    }
    for (name, most) in firmware::MOST {
        if firmware[name] > most {
            worse.push(format!(
                "{name} of the firmware: {}, more than {most}",
                firmware[name]
            ));
        }
    }
    if !worse.is_empty() {
        bail!("{}", worse.join("\n"));
    }
    Ok(())
}
