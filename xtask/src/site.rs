//! Writes a page that needs no server: the model as a WebAssembly module, its mouth, and an example, in one file (`docs/web.md`).
//!
//!     cargo xtask site [FOLDER] [MODEL.safetensors]
//!
//! FOLDER is `target/site` if none is named, and gets an `index.html` that can be opened as a file or put on any web server. Without a model it is the shipped one.
use std::path::Path;

use anyhow::{Result, bail};
use lipstream_web::site;

pub(crate) fn run(words: &[String]) -> Result<()> {
    let (folder, model) = match words {
        [] => ("target/site", None),
        [folder] => (folder.as_str(), None),
        [folder, model] => (folder.as_str(), Some(Path::new(model))),
        _ => bail!("write [FOLDER] [MODEL.safetensors]"),
    };
    let written = site::write(Path::new(folder), model)?;
    let kib = |bytes: usize| bytes.div_ceil(1024);
    println!(
        "{}: {} KiB; before they are text the module takes {} KiB, the tables {} and the mouth {}",
        written.file.display(),
        kib(written.page),
        kib(written.module),
        kib(written.tables),
        kib(written.mouth),
    );
    Ok(())
}
