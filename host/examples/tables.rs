//! Writes the generated constants into `core/src/tables/`.
use std::path::Path;

fn main() -> anyhow::Result<()> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../core/src/tables");
    for file in lipstream::reference::tables::generate() {
        let path = folder.join(file.name);
        lipstream::files::write_bytes(&path, file.text.as_bytes())?;
        println!("wrote core/src/tables/{}", file.name);
    }
    Ok(())
}
