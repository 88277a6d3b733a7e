//! The cases that QEMU runs too (`tests/src`), on the host. They stand here, where nothing but the core is built, so that the
//! `checked` profile is quick to run: `cargo test -p lipstream-core --profile checked`.

macro_rules! as_tests {
    ($($module:ident { $($case:ident),* $(,)? })*) => {
        $(mod $module {
            $(#[test]
            fn $case() {
                lipstream_tests::$module::$case();
            })*
        })*
    };
}

lipstream_tests::cases!(as_tests);
