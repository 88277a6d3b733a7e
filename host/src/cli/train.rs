//! `lipstream train`: features to a model.
use anyhow::{Result, bail};

/// Train a model
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: Args) -> Result<()> {
    bail!("`train` is not built yet")
}
