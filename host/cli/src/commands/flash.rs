//! `lipstream flash`: a program, a model, or the calibration of servos, onto a board, with the tools that people have.
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use clap::builder::PossibleValuesParser;
use lipstream_core::AnyModel;
use lipstream_core::model::ModelError;
use lipstream_live::board::{BOARDS, Board, Piece, Program, drive};
use lipstream_media::files;
use serde_json::json;

use super::answer::{Answer, Done};
use super::streams::{ending, is_standard, name, write};
use tools::{Probe, Source};

mod tools;

/// Put the firmware, another model for it, or the calibration of its servos, onto a board
///
/// Without --model, --built-in, --servos and --program the program is built from the source tree, with the model that LIPSTREAM_TABLES names or the shipped one. It goes to the drive of a board in its boot loader if there is one, else through probe-rs (docs/boards.md).
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Board
    #[arg(long, value_parser = PossibleValuesParser::new(BOARDS.iter().map(|board| board.name)))]
    board: String,
    /// Tables of `lipstream export` that the board's program shall run in place of its built-in ones; they alone are written
    #[arg(long, value_name = "TABLES")]
    model: Option<PathBuf>,
    /// Take such tables away again: the built-in ones run
    #[arg(long, conflicts_with = "model")]
    built_in: bool,
    /// Calibration of the board's servos, a table of `lipstream servo --write-table`
    #[arg(long, value_name = "TABLE")]
    servos: Option<PathBuf>,
    /// Program (ELF) in place of one built here; with --model and --servos all are written
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
    /// Source tree of lipstream [default: the one around this folder]
    #[arg(long, value_name = "DIR", conflicts_with = "program")]
    source: Option<PathBuf>,
    /// What the program hears by: i2s, or adc (an amplifier's voltage, on a Pico); pdm on boards that bring a microphone [default: the board's first]
    #[arg(long, value_name = "NAME", conflicts_with = "program")]
    microphone: Option<String>,
    /// The program also logs for a debug probe: starts, refusals, counters once a second, how it ends (docs/firmware.md)
    #[arg(long, conflicts_with = "program")]
    log: bool,
    /// Only write the file that would be flashed: .uf2 for a boot loader's drive, .bin for other tools
    #[arg(long, value_name = "FILE", conflicts_with_all = ["drive", "probe"])]
    file: Option<PathBuf>,
    /// The drive of the board's boot loader [default: looked for where systems show drives]
    #[arg(long, value_name = "DIR", conflicts_with = "probe")]
    drive: Option<PathBuf>,
    /// Use probe-rs and a debug probe
    #[arg(long)]
    probe: bool,
    /// Print the commands that would run, and what is missing for them
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    answer: Answer,
}

/// Where it goes.
enum Way {
    File(PathBuf),
    Drive(PathBuf),
    Probe(Probe),
}

pub(crate) fn run(args: Args) -> Result<()> {
    let board = Board::named(&args.board).context("no such board")?;
    let only_parts = args.model.is_some() || args.built_in || args.servos.is_some();
    if only_parts && (args.microphone.is_some() || args.log) {
        bail!(
            "--microphone and --log are of a program that is built here, and --model, --built-in and --servos write none: call this twice"
        );
    }
    let features = features(&args, board)?;
    let mut steps = Steps::default();
    let way = match way(&args, board) {
        Ok(way) => way,
        Err(missing) if args.dry_run => {
            steps.note(format!("{missing:#}"));
            Way::Probe(Probe::named())
        }
        Err(missing) => return Err(missing),
    };
    let source = match &args.program {
        None if !only_parts => Some(Source::find(args.source.as_deref(), board, &features)?),
        _ => None,
    };
    if args.dry_run {
        plan(&mut steps, &args, board, &way, source.as_ref())?;
        steps.print(args.answer);
        return Ok(());
    }
    let file = match (&args.program, source) {
        (Some(path), _) => Some(path.clone()),
        (None, Some(source)) => Some(source.build(board)?),
        (None, None) => None,
    };
    let program = file
        .as_deref()
        .map(|path| read_program(path, board))
        .transpose()?;
    let parts = parts(&args, board, program)?;
    match &way {
        Way::File(path) => to_file(path, board, &parts, args.answer),
        Way::Drive(folder) => to_drive(folder, board, &parts, args.answer),
        Way::Probe(probe) => {
            if let Some(path) = &file {
                probe.program(board, path)?;
            }
            for piece in parts.model.iter().chain(&parts.servos) {
                probe.bytes(board, piece)?;
            }
            probe.reset(board)?;
            if args.answer.json {
                args.answer.note(&told(board, &parts));
            }
            Ok(())
        }
    }
}

/// Cargo features beside the board's.
fn features(args: &Args, board: &Board) -> Result<Vec<&'static str>> {
    let microphone = match &args.microphone {
        None => None,
        Some(name) => board.microphone(name).map_err(|names| {
            anyhow::anyhow!(
                "--microphone {name}: the program for the {} hears by {names}",
                board.title
            )
        })?,
    };
    Ok(microphone
        .into_iter()
        .chain(args.log.then_some("defmt"))
        .collect())
}

fn way(args: &Args, board: &Board) -> Result<Way> {
    if let Some(path) = &args.file {
        return Ok(Way::File(path.clone()));
    }
    if args.probe {
        return Ok(Way::Probe(Probe::find()?));
    }
    let Some(loader) = &board.drive else {
        if args.drive.is_some() {
            bail!(
                "the {} has no boot loader that shows itself as a drive: use a debug probe (--probe), or --file FILE.bin for bossac",
                board.title
            );
        }
        return Ok(Way::Probe(Probe::find().with_context(|| {
            format!(
                "the {} is flashed by probe-rs, or by bossac with --file FILE.bin (docs/boards.md)",
                board.title
            )
        })?));
    };
    if let Some(folder) = &args.drive {
        loader
            .is_at(folder)
            .map_err(|why| anyhow::anyhow!("--drive {}: {why}", folder.display()))?;
        return Ok(Way::Drive(folder.clone()));
    }
    match &loader.find()[..] {
        [folder] => Ok(Way::Drive(folder.clone())),
        [] => Ok(Way::Probe(Probe::find().with_context(|| {
            format!(
                "no drive of a {}: {}, or write a file (--file FILE.uf2) and copy it there; with a debug probe",
                board.title, loader.how
            )
        })?)),
        several => bail!(
            "{} drives of a {} are there: name one of them (--drive), such as {}",
            several.len(),
            board.title,
            several[0].display()
        ),
    }
}

/// What would be done: commands that would run, and notes on what is written or missing, in their order.
#[derive(Default)]
struct Steps(Vec<(Step, String)>);

#[derive(Clone, Copy, PartialEq, Eq)]
enum Step {
    Command,
    Note,
}

impl Steps {
    fn command(&mut self, words: String) {
        self.0.push((Step::Command, words));
    }

    fn note(&mut self, words: String) {
        self.0.push((Step::Note, words));
    }

    /// As a shell script, or as an object.
    fn print(&self, answer: Answer) {
        let of = |kind| {
            let steps = self.0.iter().filter(move |(is, _)| *is == kind);
            steps.map(|(_, words)| words).collect::<Vec<_>>()
        };
        if answer.json {
            println!(
                "{}",
                json!({ "commands": of(Step::Command), "notes": of(Step::Note) })
            );
            return;
        }
        for (kind, words) in &self.0 {
            match kind {
                Step::Command => println!("{words}"),
                Step::Note => println!("# {words}"),
            }
        }
    }
}

/// Adds what would be done to `steps`.
fn plan(steps: &mut Steps, args: &Args, board: &Board, way: &Way, source: Option<&Source>) -> Result<()> {
    if let Some(source) = source {
        steps.command(source.shown(board));
        if let Err(missing) = source.check(board) {
            steps.note(format!("{missing:#}"));
        }
    }
    let program = match (&args.program, source) {
        (Some(path), _) => Some(path.clone()),
        (None, Some(source)) => Some(source.usual_place(board)),
        (None, None) => None,
    };
    let known = args
        .program
        .as_deref()
        .map(|path| read_program(path, board))
        .transpose()?;
    let parts = parts(args, board, known)?;
    match way {
        Way::File(path) => steps.note(format!("{} would be written", name(path))),
        Way::Drive(folder) => steps.note(format!(
            "{} would be written",
            folder.join(file_name(board)).display()
        )),
        Way::Probe(probe) => {
            if let Some(path) = &program {
                steps.command(probe.program_shown(board, path));
            }
            if let Some(piece) = &parts.model {
                let path = args.model.as_deref().unwrap_or(Path::new("erased.bin"));
                steps.command(probe.bytes_shown(board, piece.address, path));
            }
            if let (Some(piece), Some(path)) = (&parts.servos, &args.servos) {
                steps.command(probe.bytes_shown(board, piece.address, path));
            }
            steps.command(probe.reset_shown(board));
        }
    }
    Ok(())
}

fn read_program(path: &Path, board: &Board) -> Result<Program> {
    let bytes = files::read_bytes(path)?;
    board.program(&bytes).with_context(|| path.display().to_string())
}

/// What is written.
struct Parts {
    program: Option<Program>,
    model: Option<Piece>,
    servos: Option<Piece>,
}

impl Parts {
    /// All of it, and whether it is a program alone.
    fn pieces(&self) -> (Vec<Piece>, bool) {
        let program = self.program.iter().flat_map(|program| &program.pieces);
        let all = program.chain(&self.model).chain(&self.servos);
        (
            all.cloned().collect(),
            self.model.is_none() && self.servos.is_none(),
        )
    }
}

fn parts(args: &Args, board: &Board, program: Option<Program>) -> Result<Parts> {
    let model = model(args, board, program.as_ref())?;
    let servos = args.servos.as_deref().map(|path| servos(path, board));
    let servos = servos.transpose()?;
    Ok(Parts {
        program,
        model,
        servos,
    })
}

fn servos(path: &Path, board: &Board) -> Result<Piece> {
    let bytes = files::read_bytes(path)?;
    board.servos(&bytes).with_context(|| path.display().to_string())
}

/// What goes into the region for models, if anything does.
fn model(args: &Args, board: &Board, program: Option<&Program>) -> Result<Option<Piece>> {
    if args.built_in {
        return Ok(Some(board.no_model()?));
    }
    let Some(path) = &args.model else {
        return Ok(None);
    };
    let kind = match program {
        Some(program) => program.kind.context("the program has no model of its own that tells which kind it runs: build it with tables that are whole")?,
        // A program that is on the board already: as it is built where nobody says otherwise.
        None => AnyModel::new_checked(lipstream::shipped::TABLES)?.kind_name(),
    };
    let bytes = files::read_bytes(path)?;
    let piece = board.model(&bytes, kind).map_err(|error| {
        let hint = match error {
            lipstream_live::board::BoardError::Model(ModelError::NoModel) => {
                ": a board takes the tables that `lipstream export` writes"
            }
            _ => "",
        };
        anyhow::anyhow!("{}: {error}{hint}", path.display())
    })?;
    Ok(Some(piece))
}

/// What is in them.
fn told(board: &Board, written: &Parts) -> Done {
    let mut parts = Vec::new();
    if let Some(program) = &written.program {
        let bytes: usize = program.pieces.iter().map(|piece| piece.bytes.len()).sum();
        parts.push(format!("program of {bytes} bytes"));
    }
    if let Some(piece) = &written.model {
        let is_model = piece.bytes.iter().any(|byte| *byte != 0xff);
        parts.push(match is_model {
            true => format!("model of {} bytes at {:#x}", piece.bytes.len(), piece.address),
            false => format!("no model any more at {:#x}", piece.address),
        });
    }
    if let Some(piece) = &written.servos {
        parts.push(format!("calibration of servos at {:#x}", piece.address));
    }
    let bytes = |piece: &Option<Piece>| piece.as_ref().map(|piece| piece.bytes.len());
    Done::new(
        format!("{}: {}", board.name, parts.join(", ")),
        json!({
            "board": board.name,
            "program": written.program.as_ref().map(|p| p.pieces.iter().map(|piece| piece.bytes.len()).sum::<usize>()),
            "model": bytes(&written.model),
            "servos": bytes(&written.servos),
        }),
    )
}

fn to_file(path: &Path, board: &Board, parts: &Parts, answer: Answer) -> Result<()> {
    let pieces = parts.pieces().0;
    let bytes = match ending(path).as_str() {
        "bin" if !is_standard(path) => flat(&pieces),
        "uf2" => uf2(board, parts).with_context(|| format!("--file {}", path.display()))?,
        "" if is_standard(path) => uf2(board, parts)?,
        _ => bail!(
            "--file {}: name a file that ends in .uf2 (for a boot loader's drive) or .bin (from the first address on)",
            path.display()
        ),
    };
    write(path, |file| Ok(file.write_all(&bytes)?))?;
    answer.tell(path, &told(board, parts));
    Ok(())
}

/// From the first address to the last, what lies between as erased flash.
fn flat(pieces: &[Piece]) -> Vec<u8> {
    let start = pieces.iter().map(|piece| piece.address).min().unwrap_or(0);
    let mut bytes = Vec::new();
    for piece in pieces {
        let at = (piece.address - start) as usize;
        bytes.resize(bytes.len().max(at + piece.bytes.len()), 0xff);
        bytes[at..at + piece.bytes.len()].copy_from_slice(&piece.bytes);
    }
    bytes
}

fn file_name(board: &Board) -> String {
    format!("lipstream-{}.uf2", board.name)
}

/// What the board's boot loader takes.
fn uf2(board: &Board, parts: &Parts) -> Result<Vec<u8>> {
    let (pieces, is_program) = parts.pieces();
    board.uf2(&pieces, is_program).with_context(|| {
        format!(
            "the boot loader of the {} takes no .uf2; write a .bin",
            board.title
        )
    })
}

fn to_drive(folder: &Path, board: &Board, parts: &Parts, answer: Answer) -> Result<()> {
    let bytes = uf2(board, parts)?;
    drive::copy(&bytes, folder, &file_name(board))
        .with_context(|| format!("cannot copy to {}", folder.display()))?;
    answer.tell(folder, &told(board, parts));
    Ok(())
}
