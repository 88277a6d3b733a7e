//! Writes `core/capi/lipstream.h`, the C header of the core, from `core/capi/src/lib.rs`.
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};

/// What stands above the declarations.
const ABOVE: &str = "/* Speech in, mouth parameters out: lipstream's core for C and C++ (docs/c.md). Made by `cargo xtask header`; do not edit. */";

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../core/capi")
}

/// The header's text.
fn text() -> Result<String> {
    let mut settings = cbindgen::Config {
        language: cbindgen::Language::C,
        header: Some(ABOVE.to_owned()),
        include_guard: Some("LIPSTREAM_H".to_owned()),
        cpp_compat: true,
        usize_is_size_t: true,
        // What a compiler has without any library.
        no_includes: true,
        sys_includes: ["stdbool.h", "stddef.h", "stdint.h"].map(str::to_owned).into(),
        documentation_style: cbindgen::DocumentationStyle::C,
        ..cbindgen::Config::default()
    };
    settings.export.include.push("LipstreamProfile".to_owned());
    let header = cbindgen::Builder::new()
        .with_config(settings)
        .with_src(folder().join("src/lib.rs"))
        .generate()
        .context("cannot make a header of core/capi")?;
    let mut text = Vec::new();
    header.write(&mut text);
    Ok(String::from_utf8(text)?)
}

pub(crate) fn run(_: &[String]) -> Result<()> {
    lipstream_media::files::write_bytes(&folder().join("lipstream.h"), text()?.as_bytes())?;
    println!("wrote core/capi/lipstream.h");
    Ok(())
}

#[cfg(test)]
mod tests {
    /// The checked-in header is what its command makes.
    #[test]
    fn the_header_is_up_to_date() {
        let there = std::fs::read_to_string(super::folder().join("lipstream.h")).unwrap();
        assert!(there == super::text().unwrap(), "out of date: cargo xtask header");
    }
}
