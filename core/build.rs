//! Says which targets have SMLAD, see `fixed::mul_halves`: the stable compiler has no `cfg` for it.
fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-check-cfg=cfg(smlad)");
    if std::env::var("TARGET").is_ok_and(|target| target.starts_with("thumbv7em-")) {
        println!("cargo::rustc-cfg=smlad");
    }
}
