//! `lipstream completions` and `lipstream man`: what shells and `man` know of the commands, made from the very arguments that the program parses.
use std::io::Write as _;
use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap_complete::Shell;
use lipstream_media::files;

use super::streams::say;

/// Write what a shell needs to complete commands and options, on standard output
#[derive(Debug, clap::Args)]
pub(crate) struct Completions {
    /// Shell that is to complete: `source <(lipstream completions bash)`
    #[arg(value_enum)]
    shell: Shell,
}

/// Write the manual, a page for each command: `man DIR/lipstream-render.1`
#[derive(Debug, clap::Args)]
pub(crate) struct Man {
    /// Folder for the pages; made if there is none
    #[arg(value_name = "DIR")]
    folder: PathBuf,
}

pub(crate) fn completions(args: Completions, mut command: clap::Command) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, "lipstream", &mut script);
    let mut out = std::io::stdout().lock();
    out.write_all(&script)
        .and_then(|()| out.flush())
        .context("cannot write to standard output")
}

pub(crate) fn man(args: &Man, mut command: clap::Command) -> Result<()> {
    std::fs::create_dir_all(&args.folder)
        .with_context(|| format!("cannot make the folder {}", args.folder.display()))?;
    // The commands' names get the program's before them, as in `lipstream-render`.
    command.build();
    let pages = std::iter::once(command.clone()).chain(command.get_subcommands().cloned());
    let mut count = 0;
    for page in pages.filter(|page| page.get_name() != "help") {
        let page = clap_mangen::Man::new(page);
        let mut text = Vec::new();
        page.render(&mut text)
            .context("cannot make a page of the manual")?;
        files::write_bytes(&args.folder.join(page.get_filename()), &text)?;
        count += 1;
    }
    say(&args.folder, &format!("{count} pages"));
    Ok(())
}
