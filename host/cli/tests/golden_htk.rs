//! The front end against the pair in `tests/golden/htk`: a sound of ours and its `MFCC_E_D_A` by a program that is not
//! ours to tune, written from HTK's definition (`hcopy.py`, with its distance from the real HCopy in the `README.md` beside it).
mod common;

use std::path::Path;

use common::hcopy::{self, Pair};

fn golden() -> Vec<Pair> {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut folders = package.ancestors().map(|folder| folder.join("tests/golden/htk"));
    let folder = folders.find(|folder| folder.is_dir()).expect("tests/golden/htk");
    hcopy::pairs(&folder, 1)
}

#[test]
fn every_coefficient_equals_hcopy() {
    hcopy::every_coefficient_equals_hcopy(&golden());
}

#[test]
fn the_program_writes_what_hcopy_writes() {
    hcopy::the_program_writes_what_hcopy_writes(&golden(), env!("CARGO_BIN_EXE_lipstream"));
}

#[test]
fn integers_are_close_to_hcopy() {
    hcopy::integers_are_close_to_hcopy(&golden(), 40.0);
}

#[test]
fn integers_are_accurate_at_every_level() {
    hcopy::integers_are_accurate_at_every_level(&golden());
}
