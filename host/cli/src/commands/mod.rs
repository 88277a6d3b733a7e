//! The command line: one file per command.
use std::ffi::OsString;

use anyhow::{Context as _, Result};
use clap::{CommandFactory as _, Parser, Subcommand};

use crate::progress;

mod advice;
mod align;
mod answer;
mod batch;
mod check;
mod choices;
mod convert;
mod cues;
mod cues_events;
mod demo;
mod evaluate;
mod evaluate_held_out;
mod evaluate_mouth;
mod export;
mod faces;
mod features;
mod flash;
mod folds;
mod landmarks;
mod landmarks_page;
mod manual;
mod mos;
mod prepare;
mod prompts;
mod record;
mod render;
mod servo;
mod sources;
mod streams;
mod train;
mod train_hierarchical;
mod train_mge;
mod train_shards;
mod view;

/// Speech in, a talking mouth out.
#[derive(Debug, Parser)]
#[command(name = "lipstream", version, long_version = lipstream::shipped::VERSION, about)]
struct Cli {
    /// Say nothing but results and what is wrong
    #[arg(short, long, global = true)]
    quiet: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Align(align::Args),
    Check(check::Args),
    Completions(manual::Completions),
    Convert(convert::Args),
    Cues(cues::Args),
    Demo(demo::Args),
    Evaluate(evaluate::Args),
    Export(export::Args),
    Features(features::Args),
    Flash(flash::Args),
    Folds(folds::Args),
    Landmarks(landmarks::Args),
    Man(manual::Man),
    Mos(mos::Args),
    Prepare(prepare::Args),
    Prompts(prompts::Args),
    Record(record::Args),
    Render(render::Args),
    Servo(Box<servo::Args>),
    Train(Box<train::Train>),
    View(view::Args),
}

/// Parses the arguments (the first is the program's name) and runs the command.
pub fn run(args: impl IntoIterator<Item = OsString>) -> Result<()> {
    let Cli { quiet, command } = Cli::parse_from(args);
    progress::be_quiet(quiet);
    // These end in their own way when somebody presses Ctrl-C: what they have recorded stays, and servos go back to rest.
    let own_end = match &command {
        Command::Record(_) | Command::View(_) => true,
        Command::Servo(args) => args.is_live(),
        _ => false,
    };
    if !own_end {
        end_without_leftovers()?;
    }
    let done = match command {
        Command::Align(args) => align::run(args),
        Command::Check(args) => check::run(args),
        Command::Completions(args) => manual::completions(args, Cli::command()),
        Command::Convert(args) => convert::run(args),
        Command::Cues(args) => cues::run(args),
        Command::Demo(args) => demo::run(args),
        Command::Evaluate(args) => evaluate::run(args),
        Command::Export(args) => export::run(args),
        Command::Features(args) => features::run(args),
        Command::Flash(args) => flash::run(args),
        Command::Folds(args) => folds::run(args),
        Command::Landmarks(args) => landmarks::run(args),
        Command::Man(args) => manual::man(&args, Cli::command()),
        Command::Mos(args) => mos::run(args),
        Command::Prepare(args) => prepare::run(args),
        Command::Prompts(args) => prompts::run(args),
        Command::Record(args) => record::run(args),
        Command::Render(args) => render::run(args),
        Command::Servo(args) => servo::run(*args),
        Command::Train(args) => train::run(*args),
        Command::View(args) => view::run(args),
    };
    done.map_err(advice::with_flags)
}

/// Whoever ends the program before its time finds no file that is not whole, nor what would have become one.
fn end_without_leftovers() -> Result<()> {
    let listening = ctrlc::set_handler(|| {
        lipstream_media::files::abandon_unfinished();
        std::process::exit(130);
    });
    match listening {
        // A program that runs several commands has done so already.
        Err(ctrlc::Error::MultipleHandlers) => Ok(()),
        listening => listening.context("cannot listen for Ctrl-C"),
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    #[test]
    fn the_arguments_do_not_contradict_each_other() {
        super::Cli::command().debug_assert();
    }
}
