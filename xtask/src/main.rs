//! The project's laboratory: `cargo xtask TOOL` measures what the documents state, or writes files that are made by program.
//!
//! | tool | what it does |
//! |---|---|
//! | `bless` | Writes the vectors of `tests/src/stream.rs` anew. |
//! | `beam` | Active joint states per frame against the width of the beam: `beam TABLES WAV...`. |
//! | `cost` | What front end, stream and firmware cost on Cortex-M, counted in QEMU: writes `docs/cost.md`, or checks it. |
//! | `cues` | Mouth shapes against phones whose times are known: `cues FOLDER`. |
//! | `faces` | Faces drawn onto a background against recordings of the same sentences. |
//! | `feedback` | The paper's EM feedback, live, at several exponents of the mouth. |
//! | `fidelity` | What the device costs a model, step by step. |
//! | `fit` | Whether texts are found to be what is said, and by what margin. |
//! | `gate` | How often the states that gate the maps are of the labelled phone and viseme. |
//! | `header` | Writes the C header of the core, `core/capi/lipstream.h`. |
//! | `hierarchical` | A hierarchical model's own numbers against recorded faces, and strangers' voices before it. |
//! | `landmarks` | How far found landmarks are off, against how many pictures were labelled: `landmarks CORPUS LANDMARKS`. |
//! | `pictures` | Drawn mouths against recorded ones, with and without fine detail. |
//! | `recognition` | Phone recognition under several settings, against labels. |
//! | `site` | Writes a page that turns a microphone into a mouth without a server: `site [FOLDER] [MODEL.safetensors]`. |
//! | `tables` | Writes the generated constants into `core/src/tables/`. |
//! | `vectors` | Writes the front end's byte vectors into `tests/vectors/`. |
//! | `voices` | A corpus of synthetic speech with exact phone times, by `flite`. |
use std::process::ExitCode;

use anyhow::{Result, bail};

mod beam;
mod bless;
mod cost;
mod cues;
mod faces;
mod feedback;
mod fidelity;
mod fit;
mod gate;
mod generated;
mod header;
mod hierarchical;
mod landmarks;
mod pictures;
mod recognition;
mod site;
mod tables;
mod vectors;
mod voices;

/// A tool's name and what it does with the words behind it.
type Tool = (&'static str, fn(&[String]) -> Result<()>);

const TOOLS: &[Tool] = &[
    ("beam", beam::run),
    ("bless", bless::run),
    ("cost", cost::run),
    ("cues", cues::run),
    ("faces", faces::run),
    ("feedback", feedback::run),
    ("fidelity", fidelity::run),
    ("fit", fit::run),
    ("gate", gate::run),
    ("header", header::run),
    ("hierarchical", hierarchical::run),
    ("landmarks", landmarks::run),
    ("pictures", pictures::run),
    ("recognition", recognition::run),
    ("site", site::run),
    ("tables", tables::run),
    ("vectors", vectors::run),
    ("voices", voices::run),
];

/// What a tool refuses is said in a line: a stack trace would say where in this program, not what to do.
fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("xtask: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let names = || TOOLS.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", ");
    let Some((name, rest)) = words.split_first() else {
        bail!("name a tool: {}", names());
    };
    match TOOLS.iter().find(|(tool, _)| tool == name) {
        Some((_, run)) => run(rest),
        None => bail!("no tool is called {name}: {}", names()),
    }
}
