//! `lipstream prepare`: a corpus to features and eigenmouths.
use anyhow::{Result, bail};

/// Turn video, sound and labels into features and eigenmouths
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: Args) -> Result<()> {
    bail!("`prepare` is not built yet")
}
