//! `lipstream demo`: the shipped model on the shipped speech.
use anyhow::{Result, bail};

/// Run the shipped model on the shipped speech: video, page, cues
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: Args) -> Result<()> {
    bail!("`demo` is not built yet")
}
