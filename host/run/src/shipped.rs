//! What every copy of the program carries with it.

/// Speech made with flite, see data/README.md.
pub const SOUND: &[u8] = include_bytes!("../shipped/hello.wav");
/// The shipped model, see models/README.md: what is drawn with, and what converts.
pub const MODEL: &[u8] = include_bytes!("../shipped/grid-s1.safetensors");
/// The shipped model's tables for the device.
pub const TABLES: &[u8] = include_bytes!("../shipped/grid-s1.tables");
