//! The examples of the documents, run by the programs that they are for.
mod common;

use std::process::Command;

use common::program::succeed;

/// The Python example plots a conversion; numpy is all it needs, which `tests/run` installs.
#[test]
fn python_plots_a_conversion() {
    let folder = common::folder("examples-python");
    let hello = common::root().join("data/hello.wav");
    let hello = hello.to_str().unwrap();
    succeed(&folder, &["convert", hello, "-o", "mouth.json"]);
    succeed(&folder, &["cues", hello, "--set", "facs", "-o", "jaw.csv"]);
    let plotted = Command::new("python3")
        .current_dir(&folder)
        .arg(common::root().join("docs/examples/plot_conversion.py"))
        .args(["mouth.json", "jaw.csv", "plot.svg"])
        .output()
        .expect("python3, which tests/run installs");
    let error = String::from_utf8_lossy(&plotted.stderr);
    assert!(plotted.status.success(), "{error}");
    let picture = std::fs::read_to_string(folder.join("plot.svg")).unwrap();
    assert!(picture.starts_with("<svg ") && picture.trim_end().ends_with("</svg>"));
    // A point a frame of the opening, a row a viseme, and bars that change as speech does.
    let points = picture
        .split("points=\"")
        .nth(1)
        .unwrap()
        .split('"')
        .next()
        .unwrap();
    assert_eq!(points.split(' ').count(), 420);
    for viseme in lipstream::phones::VISEMES {
        assert!(picture.contains(&format!(">{viseme}</text>")), "{viseme}");
    }
    let bars = picture.matches("<rect ").count();
    assert!((20..200).contains(&bars), "{bars} bars");
}
