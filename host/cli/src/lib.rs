//! The `lipstream` program: arguments, progress bars, words and exit codes. Everything else is in the libraries below it.
#![deny(unsafe_code)]

mod commands;
mod progress;

pub use commands::run;
