//! `lipstream prompts`: what to read aloud before a camera.
use anyhow::Result;
use lipstream_make::corpus::prompts::PROMPTS;

use super::answer::Answer;
use super::streams;

/// Print sentences to read aloud before a camera
///
/// Two minutes in which every sound of English comes several times, a sentence a line. Look into the camera, in even light from the front, and pause
/// for a second between sentences: `lipstream prepare` cuts there.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    answer: Answer,
}

pub(crate) fn run(args: Args) -> Result<()> {
    let text = match args.answer.json {
        true => serde_json::to_string_pretty(&PROMPTS)?,
        false => PROMPTS.join("\n"),
    };
    streams::write("-".as_ref(), |out| Ok(out.write_all((text + "\n").as_bytes())?))
}
