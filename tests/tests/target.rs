//! The shared cases in QEMU. The semihosting command line names the case to run; `--list` prints the names.
//! `tests/qemu-runner` boots a machine for each.
#![cfg_attr(target_os = "none", no_std, no_main)]

/// On the host there is nothing to run: `host.rs` has the same cases there.
#[cfg(not(target_os = "none"))]
fn main() {}

#[cfg(target_os = "none")]
mod target {
    use cortex_m_rt::{ExceptionFrame, entry, exception};
    use semihosting::experimental::env;
    use semihosting::{println, process};

    macro_rules! as_table {
        ($($module:ident { $($case:ident),* $(,)? })*) => {
            &[$($((
                concat!(stringify!($module), "::", stringify!($case)),
                lipstream_tests::$module::$case as fn(),
            ),)*)*]
        };
    }

    const CASES: &[(&str, fn())] = lipstream_tests::cases!(as_table);

    #[entry]
    fn main() -> ! {
        let arguments = env::args::<512>().expect("the semihosting command line");
        let Some(Ok(wanted)) = arguments.last() else {
            println!("name a case, or --list");
            process::exit(2)
        };
        if wanted == "--list" {
            for (name, _) in CASES {
                println!("{name}");
            }
            process::exit(0)
        }
        match CASES.iter().find(|(name, _)| *name == wanted) {
            Some((_, case)) => {
                case();
                process::exit(0)
            }
            None => {
                println!("no case is called {wanted}");
                process::exit(2)
            }
        }
    }

    #[panic_handler]
    fn panic(info: &core::panic::PanicInfo) -> ! {
        println!("{info}");
        process::exit(1)
    }

    #[exception]
    unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
        println!("hard fault: {frame:?}");
        process::exit(3)
    }
}
