//! The firmware of every board: what it says, byte for byte, where a machine can run it; what it takes of the board, everywhere.
#[path = "../common/mod.rs"]
mod common;

mod boards;
mod compare;
mod mps2;
mod pico;
mod pico_adc;
mod servos;
