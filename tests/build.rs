//! Linker arguments of the programs for QEMU.
fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    if std::env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        // memory.x is found in the workspace root.
        println!("cargo::rerun-if-changed=../memory.x");
        let mut arguments = vec!["--nmagic", "-Tlink.x"];
        if std::env::var("TARGET").is_ok_and(|target| target.starts_with("thumbv8m")) {
            arguments.push("--defsym=QEMU_MPS2_AN505=1");
        }
        for argument in arguments {
            println!("cargo::rustc-link-arg-tests={argument}");
            println!("cargo::rustc-link-arg-examples={argument}");
        }
    }
}
