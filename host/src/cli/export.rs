//! `lipstream export`: a float model to the device's tables.
use anyhow::{Result, bail};

/// Write the device's quantised tables
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: Args) -> Result<()> {
    bail!("`export` is not built yet")
}
