//! Measures what the front end costs on Cortex-M and writes `docs/cost.md`, or checks that nothing has grown.
//!
//! ```text
//! cargo run -p lipstream-tests --example cost               writes docs/cost.md
//! cargo run -p lipstream-tests --example cost -- --check    fails where a number there has grown by more than 5 %
//! ```
//!
//! Instructions are counted in QEMU (`-icount`): the same on every machine and every run.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    loop {}
}

#[cfg(not(target_os = "none"))]
fn main() -> anyhow::Result<()> {
    host::main()
}

#[cfg(not(target_os = "none"))]
mod host {
    use std::collections::BTreeMap;
    use std::path::{Path, PathBuf};
    use std::process::Command;

    use anyhow::{Context, Result, bail};
    use object::{Object, ObjectSection, ObjectSymbol};

    const TARGETS: [&str; 2] = ["thumbv7em-none-eabihf", "thumbv6m-none-eabi"];

    /// Most instructions of a hop on Cortex-M4 with all 39 numbers.
    const MOST_INSTRUCTIONS: u64 = 35_000;

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

    type Numbers = BTreeMap<String, u64>;

    pub(crate) fn main() -> Result<()> {
        let check = match std::env::args().nth(1).as_deref() {
            None => false,
            Some("--check") => true,
            Some(other) => bail!("unknown option {other}; there is --check"),
        };
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let document = root.join("docs/cost.md");
        let measured = TARGETS.map(|target| measure(&root, target));
        let [cortex_m4, cortex_m0] = measured;
        let columns = [cortex_m4?, cortex_m0?];
        if check {
            let text = std::fs::read_to_string(&document).with_context(|| document.display().to_string())?;
            return compare(&text, &columns);
        }
        std::fs::write(&document, render(&columns)).with_context(|| document.display().to_string())?;
        println!("wrote docs/cost.md");
        Ok(())
    }

    /// Builds the counting program for a target, runs it, reads its symbols.
    fn measure(root: &Path, target: &str) -> Result<Numbers> {
        let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
        let arguments = [
            "build",
            "--release",
            "-p",
            "lipstream-tests",
            "--example",
            "frontend_cost",
        ];
        let status = Command::new(cargo)
            .current_dir(root)
            .args(arguments)
            .args(["--target", target])
            .status()?;
        if !status.success() {
            bail!("cannot build frontend_cost for {target} (`rustup target add {target}`?)");
        }
        let folder = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from);
        let program = folder.join(target).join("release/examples/frontend_cost");
        let output = Command::new("qemu-system-arm")
            .args([
                "-machine",
                "mps2-an386",
                "-display",
                "none",
                "-monitor",
                "none",
                "-serial",
                "null",
            ])
            .args(["-icount", "shift=6,align=off,sleep=off"])
            .args(["-semihosting-config", "enable=on,target=native"])
            .arg("-kernel")
            .arg(&program)
            .output()
            .context("qemu-system-arm (Debian's package of that name) is needed")?;
        let text = String::from_utf8_lossy(&output.stdout);
        if !output.status.success() {
            bail!("frontend_cost failed on {target}: {text}");
        }
        let mut numbers = Numbers::new();
        for line in text.lines() {
            let (name, value) = line.rsplit_once(' ').context("a line without a number")?;
            numbers.insert(name.to_owned(), value.parse()?);
        }
        let (code, tables) = sizes(&std::fs::read(&program)?)?;
        numbers.insert("bytes code".to_owned(), code);
        numbers.insert("bytes tables".to_owned(), tables);
        numbers.insert("bytes flash".to_owned(), code + tables);
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

    fn render(columns: &[Numbers]) -> String {
        let mut table =
            String::from("| | Cortex-M4 (`thumbv7em`) | Cortex-M0+ (`thumbv6m`) |\n|---|---|---|\n");
        for (name, label) in ROWS {
            table += &row(name, label, columns);
        }
        include_str!("cost.md.in").replace("TABLE\n", &table)
    }

    /// Every number of the committed table, against what was measured now.
    fn compare(text: &str, columns: &[Numbers]) -> Result<()> {
        let mut worse = Vec::new();
        for (name, label) in ROWS {
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
                    .get(name)
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
        if !worse.is_empty() {
            bail!("{}", worse.join("\n"));
        }
        Ok(())
    }
}
