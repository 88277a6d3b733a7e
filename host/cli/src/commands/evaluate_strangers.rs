//! `lipstream evaluate VIDEOS --strangers`: how well a model's mouth follows people whom it has never seen.
use std::path::Path;

use anyhow::{Context as _, Result, bail};
use lipstream::engine::{Engine, Kind};
use lipstream::opening::OpeningReader;
use lipstream_make::evaluate::strangers::{Strangers, strangers};
use lipstream_media::files;

use super::check::videos_of;
use crate::progress::Terminal;

/// Measures `model`, as the device computes it, on the videos at `path`.
pub(super) fn run(path: &Path, model: Option<&Path>, output: Option<&Path>, as_json: bool) -> Result<()> {
    let (engine, reader) = match model {
        Some(model) => (
            Engine::open(model, Kind::Fixed)?,
            OpeningReader::of_file(model)?
                .with_context(|| format!("{} has no mouth whose lips can be measured", model.display()))?,
        ),
        None => {
            let reader = OpeningReader::shipped()?;
            (
                Engine::shipped(),
                reader.context("the shipped model has no mouth")?,
            )
        }
    };
    // Before minutes of work.
    let output = output
        .map(|path| Ok::<_, anyhow::Error>((path, ending(path)?)))
        .transpose()?;
    let report = strangers(&videos_of(path)?, &engine, &reader, &Terminal::default())?;
    match as_json {
        true => println!("{}", json(&report)?),
        false => print!("{}", report.markdown()),
    }
    if let Some((output, ending)) = output {
        let text = match ending {
            Ending::Json => json(&report)?,
            Ending::Markdown => report.markdown(),
        };
        files::write_bytes(output, text.as_bytes())?;
        eprintln!("written: {}", output.display());
    }
    Ok(())
}

enum Ending {
    Markdown,
    Json,
}

fn ending(output: &Path) -> Result<Ending> {
    let ending = output.extension().map(|e| e.to_string_lossy().to_lowercase());
    match ending.as_deref() {
        Some("md") => Ok(Ending::Markdown),
        Some("json") => Ok(Ending::Json),
        _ => bail!("{}: a report on strangers ends in .md or .json", output.display()),
    }
}

fn json(report: &Strangers) -> Result<String> {
    Ok(serde_json::to_string_pretty(report)? + "\n")
}
