//! The `lipstream` program as a user runs it.
use std::ffi::OsStr;
use std::path::Path;
use std::process::{Child, Command, Output};

/// The program, built with this test.
pub(crate) fn program() -> &'static Path {
    Path::new(env!("CARGO_BIN_EXE_lipstream"))
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

/// Runs the program in `folder` with what is installed, such as ffmpeg, at hand.
pub(crate) fn run_with_programs<A: AsRef<OsStr>>(folder: &Path, arguments: &[A]) -> Output {
    Command::new(program())
        .current_dir(folder)
        .args(arguments)
        .output()
        .expect("run lipstream")
}

/// What a program printed.
pub(crate) fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
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
    one_line(run(folder, arguments))
}

/// Presses Ctrl-C for a program that runs.
pub(crate) fn interrupt(program: &Child) {
    let pid = program.id().to_string();
    let killed = Command::new("kill").args(["-INT", &pid]).status();
    assert!(killed.expect("run kill").success());
}

/// The line of a program that must have refused.
pub(crate) fn one_line(output: Output) -> String {
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

/// Makes a video without a face.
pub(crate) fn test_picture(path: &Path) {
    let drawn = Command::new("ffmpeg")
        .args(["-v", "error", "-f", "lavfi", "-i"])
        .arg("testsrc=size=160x120:rate=25:duration=1")
        .arg(path)
        .status();
    assert!(drawn.expect("ffmpeg, which tests/run installs").success());
}
