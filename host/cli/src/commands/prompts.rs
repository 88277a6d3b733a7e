//! `lipstream prompts`: what to read aloud before a camera.
use anyhow::Result;
use lipstream_make::corpus::prompts::PROMPTS;

use super::streams;

/// Print sentences to read aloud before a camera
///
/// Two minutes in which every sound of English comes several times, a sentence a line. Look into the camera, in even light from the front, and pause
/// for a second between sentences: `lipstream prepare` cuts there.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_: Args) -> Result<()> {
    streams::write("-".as_ref(), |out| {
        Ok(out.write_all((PROMPTS.join("\n") + "\n").as_bytes())?)
    })
}
