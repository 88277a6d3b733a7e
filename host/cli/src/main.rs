//! The `lipstream` program: a thin door to the library's commands.
use std::io::{self, Write as _};
use std::panic;
use std::process::{self, ExitCode};

fn main() -> ExitCode {
    end_where_nobody_reads();
    match lipstream_cli::run(std::env::args_os()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("lipstream: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// `println!` and `eprintln!` panic where nothing can be written. A reader that has left (`lipstream … | head`) ends the program with the exit
/// code that a shell gives to one that SIGPIPE has ended; a full disk is said in a line.
fn end_where_nobody_reads() {
    let usual = panic::take_hook();
    panic::set_hook(Box::new(move |info| {
        let said = info.payload_as_str().unwrap_or_default();
        let why = said
            .strip_prefix("failed printing to stdout: ")
            .or_else(|| said.strip_prefix("failed printing to stderr: "));
        match why {
            Some(why) if why.contains("Broken pipe") => process::exit(128 + 13),
            Some(why) => {
                // Where standard error is full as well, only the exit code is left to tell.
                let _ = writeln!(io::stderr(), "lipstream: cannot write to standard output: {why}");
                process::exit(1);
            }
            None => usual(info),
        }
    }));
}
