//! The `lipstream` program: a thin door to the library's commands.
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

/// `println!` panics where standard output has been closed (`lipstream … | head`): there the program just ends, with the exit code
/// that a shell gives to one that SIGPIPE has ended.
fn end_where_nobody_reads() {
    let usual = panic::take_hook();
    panic::set_hook(Box::new(move |info| {
        let said = info.payload_as_str().unwrap_or_default();
        if said.starts_with("failed printing to stdout") && said.contains("Broken pipe") {
            process::exit(128 + 13);
        }
        usual(info);
    }));
}
