//! The checked-in constants are what their command makes.
use std::path::Path;

#[test]
fn generated_tables_are_up_to_date() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../core/src/tables");
    for file in lipstream::reference::tables::generate() {
        let path = folder.join(file.name);
        let there = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        assert!(
            there == file.text,
            "{} is out of date: cargo run -p lipstream --example tables",
            path.display()
        );
    }
}
