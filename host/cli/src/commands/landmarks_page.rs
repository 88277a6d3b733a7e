//! `lipstream landmarks --page`: a person corrects what the model is least sure of, in a browser.
use std::net::{IpAddr, Ipv4Addr};
use std::path::{Path, PathBuf};
use std::sync::mpsc;

use anyhow::{Context as _, Result, ensure};
use lipstream::error::chain;
use lipstream_live::serve::{Labelling, Place, Progress, Proposal, Server};
use lipstream_make::corpus::discover::ClipFiles;
use lipstream_make::hierarchical::Landmarks;
use lipstream_make::landmarks::{Growth, growth};
use lipstream_media::encode;

use super::landmarks::{self, Report};
use crate::progress::Terminal;

/// Of the pictures on the page: what JPEG takes away lies below what points are put by.
const QUALITY: u8 = 95;

/// What was said about the page.
pub(super) struct Told {
    /// Its port; 0 is any.
    pub(super) port: u16,
    /// Whether standard output is for something else than its address.
    pub(super) keep_standard_output: bool,
}

/// Refuses a table of labels that is there and not read, or that the output would be written onto: its labels would be lost.
pub(super) fn keeps(table: &Path, labelled: &[PathBuf], output: &Path) -> Result<()> {
    ensure!(
        std::path::absolute(table)? != std::path::absolute(output)?,
        "{} cannot be the table of labels and the output: name two files",
        table.display()
    );
    let Ok(there) = table.canonicalize() else {
        return Ok(());
    };
    // A folder's files are read too.
    let read = |given: &PathBuf| given.canonicalize().is_ok_and(|given| there.starts_with(given));
    ensure!(
        labelled.iter().any(read),
        "{} is there: name it after --labelled too, to go on with its labels, or name another table",
        table.display()
    );
    // A table of another program's would come back in another form.
    Landmarks::read(table)
        .with_context(|| format!("{} cannot be written onto", table.display()))
        .map(drop)
}

pub(super) fn run(
    clips: Vec<ClipFiles>,
    labelled: Landmarks,
    table: &Path,
    output: &Path,
    told: &Told,
) -> Result<Report> {
    let port = told.port;
    let (written, reported) = mpsc::channel();
    let growth = Growth::begin(clips, labelled, table, &Terminal::default())?;
    let page = Page {
        proposal: growth
            .proposal()
            .map(|now| shown(now, growth.labelled()))
            .transpose()?,
        growth,
        table: table.to_owned(),
        output: output.to_owned(),
        written,
        done: false,
    };
    let place = Place {
        address: IpAddr::V4(Ipv4Addr::LOCALHOST),
        port,
    };
    let server = Server::label(page, &place).with_context(|| {
        format!("cannot serve a page on 127.0.0.1:{port} (--port 0 takes any port that is free)")
    })?;
    let line = format!(
        "open {} in a browser; what is accepted there is in {} at once, and Done writes {} and ends",
        server.url(),
        table.display(),
        output.display()
    );
    match told.keep_standard_output {
        true => eprintln!("{line}"),
        false => println!("{line}"),
    }
    Ok(reported.recv()?)
}

/// A proposal as the page has it.
fn shown(proposal: &growth::Proposal, labelled: &Landmarks) -> Result<Proposal> {
    let frames = &proposal.frames;
    let jpeg = encode::jpeg(&frames.rgb, (frames.width, frames.height), QUALITY, "")?;
    let groups = labelled.groups().iter();
    Ok(Proposal {
        clip: proposal.clip.clone(),
        picture: proposal.picture,
        size: proposal.size,
        points: proposal.points.clone(),
        groups: groups.map(|(name, range)| (name.clone(), range.len())).collect(),
        confidence: proposal.confidence,
        jpeg: jpeg.into(),
    })
}

/// What the page asks of the labels that grow.
struct Page {
    growth: Growth,
    proposal: Option<Proposal>,
    table: PathBuf,
    output: PathBuf,
    written: mpsc::Sender<Report>,
    done: bool,
}

impl Page {
    /// Does something with the labels that proposes another picture.
    fn go_on(
        &mut self,
        act: impl FnOnce(&mut Growth) -> lipstream_make::error::Result<()>,
    ) -> Result<(), String> {
        act(&mut self.growth).map_err(|error| chain(&error))?;
        let next = self
            .growth
            .proposal()
            .map(|next| shown(next, self.growth.labelled()));
        self.proposal = next.transpose().map_err(|error| format!("{error:#}"))?;
        Ok(())
    }
}

impl Labelling for Page {
    fn progress(&self) -> Progress {
        let found = self.growth.found();
        let (unsure, lost) = found.unsure();
        Progress {
            labelled: self.growth.labelled().labelled().len(),
            pictures: found.landmarks.pictures(),
            unsure: unsure.values().map(Vec::len).sum(),
            lost,
            expected: self.growth.expected(),
            labels: self.table.display().to_string(),
            output: self.output.display().to_string(),
            done: self.done,
        }
    }

    fn proposal(&self) -> Option<Proposal> {
        self.proposal.clone()
    }

    fn accept(&mut self, points: &[[f32; 2]]) -> Result<(), String> {
        self.go_on(|growth| growth.accept(points, &Terminal::default()))
    }

    fn skip(&mut self) -> Result<(), String> {
        self.go_on(Growth::skip)
    }

    fn done(&mut self) -> Result<(), String> {
        let labels = self.growth.found();
        let written =
            landmarks::summary(labels, &Terminal::default()).and_then(|()| Ok(labels.write(&self.output)?));
        written.map_err(|error| format!("{error:#}"))?;
        let growth = &self.growth;
        let report = Report::new(labels, growth.labelled(), growth.expected(), &self.output);
        self.done = true;
        // Nobody waits any more where Done was pressed twice.
        let _ = self.written.send(report);
        Ok(())
    }
}
