//! `lipstream evaluate`: measures models on a feature folder.
use anyhow::{Result, bail};

/// Measure models on a feature folder
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: Args) -> Result<()> {
    bail!("`evaluate` is not built yet")
}
