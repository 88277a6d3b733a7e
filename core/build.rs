//! Says which targets have SMLAD and which no long multiplication, see `fixed`: the stable compiler has no `cfg` for either.
fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-check-cfg=cfg(smlad, short_products)");
    let target = std::env::var("TARGET").unwrap_or_default();
    if target.starts_with("thumbv7em-") {
        println!("cargo::rustc-cfg=smlad");
    }
    // Cortex-M0+: 32 by 32 bits give the low 32.
    if target.starts_with("thumbv6m-") {
        println!("cargo::rustc-cfg=short_products");
    }
}
