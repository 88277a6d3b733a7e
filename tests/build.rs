//! Linker arguments of the programs for QEMU.
fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    if std::env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        // memory.x is found in the workspace root.
        println!("cargo::rerun-if-changed=../memory.x");
        for argument in ["--nmagic", "-Tlink.x"] {
            println!("cargo::rustc-link-arg-tests={argument}");
            println!("cargo::rustc-link-arg-examples={argument}");
        }
    }
}
