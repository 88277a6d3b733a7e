//! The shared cases on the host.

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
