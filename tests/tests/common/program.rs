//! The `lipstream` program as a user runs it.
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

/// The program, built in the profile of this test.
pub(crate) fn program() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| {
        // target/PROFILE/deps/this-test
        let test = std::env::current_exe().expect("this program's path");
        let folder = test.ancestors().nth(2).expect("tests are two folders down");
        let profile = match folder.file_name().and_then(OsStr::to_str) {
            Some("debug") => "dev",
            Some(profile) => profile,
            None => panic!("no profile in {}", test.display()),
        };
        let target = folder.parent().expect("the target folder");
        let output = Command::new(env!("CARGO"))
            .current_dir(super::root())
            .args([
                "build",
                "--locked",
                "--package",
                "lipstream",
                "--bin",
                "lipstream",
                "--profile",
                profile,
            ])
            .arg("--target-dir")
            .arg(target)
            .output()
            .expect("run cargo");
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        folder.join(format!("lipstream{}", std::env::consts::EXE_SUFFIX))
    })
}

/// Runs the program in `folder` with an empty PATH: nothing but itself to rely on.
pub(crate) fn run<A: AsRef<OsStr>>(folder: &Path, arguments: &[A]) -> Output {
    Command::new(program())
        .current_dir(folder)
        .env("PATH", "")
        .args(arguments)
        .output()
        .expect("run lipstream")
}

/// Runs the program, which must succeed; gives what it printed.
pub(crate) fn succeed<A: AsRef<OsStr>>(folder: &Path, arguments: &[A]) -> String {
    let output = run(folder, arguments);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout).expect("words")
}

/// Runs the program, which must refuse: exit code 1, nothing printed, one line of error, which is given.
pub(crate) fn refuse<A: AsRef<OsStr>>(folder: &Path, arguments: &[A]) -> String {
    let output = run(folder, arguments);
    let error = String::from_utf8(output.stderr).expect("words");
    assert_eq!(output.status.code(), Some(1), "{error}");
    assert!(
        output.stdout.is_empty(),
        "{}",
        String::from_utf8_lossy(&output.stdout)
    );
    assert_eq!(error.lines().count(), 1, "{error}");
    let message = error.trim_end().strip_prefix("lipstream: ");
    message
        .unwrap_or_else(|| panic!("not our line: {error}"))
        .to_owned()
}
