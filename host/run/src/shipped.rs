//! What every copy of the program carries with it.

/// Speech made with flite, see data/README.md.
pub const SOUND: &[u8] = include_bytes!("../shipped/hello.wav");
/// The shipped model, see models/README.md: what is drawn with, and what converts.
pub const MODEL: &[u8] = include_bytes!("../shipped/grid-s1.safetensors");
/// What messages call it.
pub const NAME: &str = "the shipped model";
/// What `lipstream --version` says: the version, and on what terms program and shipped model are to be had (models/README.md says more).
pub const VERSION: &str = concat!(
    env!("CARGO_PKG_VERSION"),
    "\nprogram: MIT or Apache-2.0\n",
    "shipped model: CC BY 4.0 (its mouth and its words are talker 1's of the GRID corpus, other voices are flite's); see models/README.md"
);
/// The shipped model's tables for the device.
pub const TABLES: &[u8] = include_bytes!("../shipped/grid-s1.tables");
