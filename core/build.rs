//! Says which targets have SMLAD and which no long multiplication, see `fixed`: the stable compiler has no `cfg` for either.
fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-check-cfg=cfg(smlad, smlad_of_m33, short_products)");
    let target = std::env::var("TARGET").unwrap_or_default();
    // Not every processor of Armv8-M has it: whoever builds for one that does says so.
    let chosen = target.starts_with("thumbv8m.main-") && std::env::var_os("CARGO_FEATURE_SMLAD").is_some();
    if target.starts_with("thumbv7em-") || chosen {
        println!("cargo::rustc-cfg=smlad");
        if chosen {
            println!("cargo::rustc-cfg=smlad_of_m33");
        }
    }
    // Cortex-M0+: 32 by 32 bits give the low 32.
    if target.starts_with("thumbv6m-") {
        println!("cargo::rustc-cfg=short_products");
    }
}
