//! `lipstream evaluate VIDEOS --strangers` and `lipstream evaluate FEATURES --voices`: one model's mouth, as the device computes it, against people whom it need not know.
use std::path::Path;

use anyhow::{Context as _, Result, bail};
use lipstream::engine::{Engine, Kind};
use lipstream::opening::OpeningReader;
use lipstream_make::evaluate::{strangers, voices};
use lipstream_make::features::{FeatureFolder, Split};
use lipstream_media::files;
use serde::Serialize;

use super::check::videos_of;
use crate::progress::{Terminal, say};

/// What is measured, and where the report goes.
pub(super) struct Asked<'a> {
    pub(super) path: &'a Path,
    pub(super) model: Option<&'a Path>,
    pub(super) output: Option<&'a Path>,
    pub(super) as_json: bool,
}

/// Measures on videos.
pub(super) fn strangers(asked: &Asked) -> Result<()> {
    asked.report(strangers::Strangers::markdown, |engine, reader| {
        let videos = videos_of(asked.path)?;
        Ok(strangers::strangers(
            &videos,
            engine,
            reader,
            &Terminal::default(),
        )?)
    })
}

/// Measures on the sound of a feature folder, of `split` or all.
pub(super) fn voices(asked: &Asked, split: Option<Split>) -> Result<()> {
    asked.report(voices::Voices::markdown, |engine, reader| {
        let folder = FeatureFolder::open(asked.path)?;
        Ok(voices::voices(
            &folder,
            split,
            engine,
            reader,
            &Terminal::default(),
        )?)
    })
}

impl Asked<'_> {
    /// Prints what `measure` finds of the model, and writes it where that is asked for.
    fn report<R: Serialize>(
        &self,
        markdown: impl Fn(&R) -> String,
        measure: impl FnOnce(&Engine, &OpeningReader) -> Result<R>,
    ) -> Result<()> {
        let (engine, reader) = self.mouth()?;
        let output = destination(self.output)?;
        let report = measure(&engine, &reader)?;
        print_and_write(&report, markdown(&report), self.as_json, output)
    }

    /// The model, and what reads its lips.
    fn mouth(&self) -> Result<(Engine, OpeningReader)> {
        Ok(match self.model {
            Some(model) => (
                Engine::open(model, Kind::Fixed)?,
                OpeningReader::of_file(model)?.with_context(|| {
                    format!("{} has no mouth whose lips can be measured", model.display())
                })?,
            ),
            None => {
                let reader = OpeningReader::shipped()?;
                (
                    Engine::shipped(),
                    reader.context("the shipped model has no mouth")?,
                )
            }
        })
    }
}

/// Prints a report, and writes it where that is asked for.
pub(super) fn print_and_write(
    report: &impl Serialize,
    markdown: String,
    as_json: bool,
    output: Option<(&Path, Ending)>,
) -> Result<()> {
    match as_json {
        true => println!("{}", json(report)?),
        false => print!("{markdown}"),
    }
    if let Some((output, ending)) = output {
        let text = match ending {
            Ending::Json => json(report)?,
            Ending::Markdown => markdown,
        };
        files::write_bytes(output, text.as_bytes())?;
        say(&format!("written: {}", output.display()));
    }
    Ok(())
}

pub(super) enum Ending {
    Markdown,
    Json,
}

/// A report's file with its kind, refused in words before minutes of work.
pub(super) fn destination(output: Option<&Path>) -> Result<Option<(&Path, Ending)>> {
    output.map(|path| Ok((path, ending(path)?))).transpose()
}

fn ending(output: &Path) -> Result<Ending> {
    let ending = output.extension().map(|e| e.to_string_lossy().to_lowercase());
    match ending.as_deref() {
        Some("md") => Ok(Ending::Markdown),
        Some("json") => Ok(Ending::Json),
        _ => bail!("{}: this report ends in .md or .json", output.display()),
    }
}

fn json(report: &impl Serialize) -> Result<String> {
    Ok(serde_json::to_string_pretty(report)? + "\n")
}
