//! `lipstream render`: a video of the mouth, with sound.
use anyhow::{Result, bail};

/// Draw the mouth that parameters or speech describe
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: Args) -> Result<()> {
    bail!("`render` is not built yet")
}
