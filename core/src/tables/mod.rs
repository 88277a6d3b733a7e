//! Generated constants. Each file names the command that made it and its error; `xtask/src/generated.rs`
//! computes them, and a test checks that the files are what it computes.

pub mod dct;
pub mod fft;
pub mod floor;
pub mod log;
pub mod mel;
pub mod root;
pub mod window;
