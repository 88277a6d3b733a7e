//! The programs that build and flash: cargo and probe-rs. What is missing is said, and how to get it.
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result, bail};
use lipstream_live::board::{Board, Piece};

const PROBE_RS: &str = "probe-rs";

/// A source tree of lipstream, and what of it is built beside the board.
pub(super) struct Source {
    tree: PathBuf,
    /// Cargo features, the board's too.
    features: String,
}

impl Source {
    /// The named one, or the one around this folder, built with these features beside the board's.
    pub(super) fn find(named: Option<&Path>, board: &Board, features: &[&str]) -> Result<Self> {
        let features = [&[board.name], features].concat().join(",");
        let is_tree =
            |folder: &Path| folder.join("memory.x").is_file() && folder.join("firmware/boards").is_dir();
        if let Some(folder) = named {
            if !is_tree(folder) {
                bail!("--source {}: no source tree of lipstream", folder.display());
            }
            let tree = folder.to_owned();
            return Ok(Self { tree, features });
        }
        let here = std::env::current_dir().context("cannot tell which folder this is")?;
        let tree = here.ancestors().find(|folder| is_tree(folder));
        let tree = tree.map(Path::to_owned).with_context(|| {
            format!(
                "no source tree of lipstream here, from which the program for the {} is built: call this in one, name it (--source DIR) or a program that was built elsewhere (--program FILE); a model alone (--model) needs none",
                board.title
            )
        })?;
        Ok(Self { tree, features })
    }

    fn command(&self, board: &Board) -> Command {
        let mut cargo = Command::new("cargo");
        cargo
            .current_dir(&self.tree)
            .args([
                "build",
                "--locked",
                "-p",
                "lipstream-firmware",
                "--features",
                &self.features,
            ])
            .args([
                "--bin",
                board.name,
                "--profile",
                "firmware",
                "--target",
                board.target,
            ]);
        cargo
    }

    pub(super) fn shown(&self, board: &Board) -> String {
        shown(&self.command(board))
    }

    /// Where the program is if nobody chose another folder for cargo.
    pub(super) fn usual_place(&self, board: &Board) -> PathBuf {
        let target = self.tree.join("target").join(board.target);
        target.join("firmware").join(board.name)
    }

    /// Whether all is here to build.
    pub(super) fn check(&self, board: &Board) -> Result<()> {
        let said = Command::new("rustc")
            .current_dir(&self.tree)
            .args(["--print", "target-libdir", "--target", board.target])
            .stderr(Stdio::null())
            .output()
            .ok()
            .filter(|said| said.status.success())
            .context("no Rust compiler is here to build with: https://rustup.rs installs it")?;
        let folder = String::from_utf8_lossy(&said.stdout).trim().to_owned();
        if !Path::new(&folder).is_dir() {
            bail!(
                "the Rust compiler has no library for {}: rustup target add {}",
                board.target,
                board.target
            );
        }
        Ok(())
    }

    /// Builds the program; where it is.
    pub(super) fn build(&self, board: &Board) -> Result<PathBuf> {
        self.check(board)?;
        let mut command = self.command(board);
        command.arg("--message-format=json-render-diagnostics");
        let output = command
            .stdin(Stdio::null())
            .stderr(Stdio::inherit())
            .output()
            .context("cannot run cargo: https://rustup.rs installs it")?;
        if !output.status.success() {
            bail!("the program for the {} was not built, see above", board.title);
        }
        let words = String::from_utf8_lossy(&output.stdout);
        let program = words
            .lines()
            .filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok())
            .filter(|message| message["target"]["name"] == board.name)
            .find_map(|message| message["executable"].as_str().map(PathBuf::from));
        program.context("cargo did not say where it put the program")
    }
}

/// probe-rs, and a probe.
pub(super) struct Probe(PathBuf);

impl Probe {
    /// Whether it is here or not.
    pub(super) fn named() -> Self {
        Self(PathBuf::from(PROBE_RS))
    }

    pub(super) fn find() -> Result<Self> {
        let runs = Command::new(PROBE_RS)
            .arg("--version")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
        if !runs.is_ok_and(|status| status.success()) {
            bail!("probe-rs is not here: https://probe.rs/docs/getting-started/installation has it");
        }
        Ok(Self::named())
    }

    fn command(&self, what: &str, board: &Board) -> Command {
        let mut command = Command::new(&self.0);
        command.args([what, "--chip", board.chip]);
        command
    }

    fn program_command(&self, board: &Board, program: &Path) -> Command {
        let mut command = self.command("download", board);
        command.arg(program);
        command
    }

    fn bytes_command(&self, board: &Board, address: u32, file: &Path) -> Command {
        let mut command = self.command("download", board);
        command
            .args(["--binary-format", "bin", "--base-address"])
            .arg(format!("{address:#x}"))
            .arg(file);
        command
    }

    pub(super) fn program_shown(&self, board: &Board, program: &Path) -> String {
        shown(&self.program_command(board, program))
    }

    pub(super) fn bytes_shown(&self, board: &Board, address: u32, file: &Path) -> String {
        shown(&self.bytes_command(board, address, file))
    }

    pub(super) fn reset_shown(&self, board: &Board) -> String {
        shown(&self.command("reset", board))
    }

    /// Writes an ELF file.
    pub(super) fn program(&self, board: &Board, program: &Path) -> Result<()> {
        run(self.program_command(board, program))
    }

    /// Writes bytes to their address.
    pub(super) fn bytes(&self, board: &Board, piece: &Piece) -> Result<()> {
        let mut file = tempfile::Builder::new()
            .suffix(".bin")
            .tempfile()
            .context("cannot make a temporary file")?;
        file.write_all(&piece.bytes)
            .and_then(|()| file.flush())
            .context("cannot write a temporary file")?;
        run(self.bytes_command(board, piece.address, file.path()))
    }

    /// Starts the program.
    pub(super) fn reset(&self, board: &Board) -> Result<()> {
        run(self.command("reset", board))
    }
}

fn run(mut command: Command) -> Result<()> {
    let what = shown(&command);
    let status = command
        .stdin(Stdio::null())
        .status()
        .with_context(|| format!("cannot run {what}"))?;
    match status.success() {
        true => Ok(()),
        false => bail!("{what}: failed, see above; is the probe plugged in and wired to the board?"),
    }
}

/// A command as one types it.
fn shown(command: &Command) -> String {
    let words = std::iter::once(command.get_program()).chain(command.get_args());
    let quoted = words.map(|word| {
        let word = word.to_string_lossy();
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,+@".contains(c);
        match !word.is_empty() && word.chars().all(plain) {
            true => word.into_owned(),
            false => format!("'{}'", word.replace('\'', r"'\''")),
        }
    });
    let line = quoted.collect::<Vec<_>>().join(" ");
    match command.get_current_dir() {
        Some(folder) if std::env::current_dir().ok().as_deref() != Some(folder) => {
            format!("(cd {} && {line})", folder.display())
        }
        _ => line,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_shown_as_one_types_them() {
        let mut command = Command::new("probe-rs");
        command.args(["download", "a b", "it's"]);
        assert_eq!(shown(&command), r"probe-rs download 'a b' 'it'\''s'");
    }
}
