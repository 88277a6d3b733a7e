//! The `lipstream` program: a thin door to the library's commands.
use std::process::ExitCode;

fn main() -> ExitCode {
    match lipstream::cli::run(std::env::args_os()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("lipstream: {error:#}");
            ExitCode::FAILURE
        }
    }
}
