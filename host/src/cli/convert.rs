//! `lipstream convert`: sound in, mouth parameters out.
use anyhow::{Result, bail};

/// Convert speech to mouth parameters
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: Args) -> Result<()> {
    bail!("`convert` is not built yet")
}
