//! Writes the generated constants into `core/src/tables/`.
use std::path::Path;

pub(crate) fn run(_: &[String]) -> anyhow::Result<()> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../core/src/tables");
    for file in crate::generated::generate() {
        let path = folder.join(file.name);
        lipstream_media::files::write_bytes(&path, file.text.as_bytes())?;
        println!("wrote core/src/tables/{}", file.name);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    /// The checked-in constants are what their command makes.
    #[test]
    fn generated_tables_are_up_to_date() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../core/src/tables");
        for file in crate::generated::generate() {
            let path = folder.join(file.name);
            let there = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
            assert!(
                there == file.text,
                "{} is out of date: cargo xtask tables",
                path.display()
            );
        }
    }
}
