//! `lipstream features`: audio observations of a sound file.
use anyhow::{Result, bail};

/// Write audio observations (MFCC_E_D_A)
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: Args) -> Result<()> {
    bail!("`features` is not built yet")
}
