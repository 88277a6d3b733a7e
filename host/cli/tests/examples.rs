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

/// The Blender script, read by Python itself, with a module in Blender's place that notes what it is told: Blender is too large to be installed for a test.
#[test]
fn blender_gets_a_keyframe_for_each_weight() {
    let folder = common::folder("examples-blender");
    let hello = common::root().join("data/hello.wav");
    let words = [
        "cues",
        hello.to_str().unwrap(),
        "--set",
        "vrm",
        "--rate",
        "25",
        "-o",
        "speech.csv",
    ];
    succeed(&folder, &words);
    let stand_in = "
from types import SimpleNamespace as Of

class Key:
    def __init__(self, name):
        self.name = name
    def keyframe_insert(self, path, frame):
        print(self.name, path, f'{frame:.3f}', self.value)

keys = {name: Key(name) for name in ('aa', 'ou')}
face = Of(name='Face', data=Of(shape_keys=Of(key_blocks=keys)))
scene = Of(frame_start=1, render=Of(fps=50, fps_base=2.0))
context = Of(object=face, scene=scene)
";
    std::fs::write(folder.join("bpy.py"), stand_in).unwrap();
    let run = |words: &[&str]| {
        let script = common::root().join("docs/examples/blender_shape_keys.py");
        let mut python = Command::new("python3");
        python.current_dir(&folder).env("PYTHONPATH", &folder).arg(script);
        python
            .args(words)
            .output()
            .expect("python3, which tests/run installs")
    };
    let output = run(&["--", "speech.csv"]);
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let table = std::fs::read_to_string(folder.join("speech.csv")).unwrap();
    let rows: Vec<Vec<&str>> = table
        .lines()
        .skip(1)
        .map(|row| row.split(',').collect())
        .collect();
    // The scene has 25 pictures a second and begins at 1: aa is the second column, ou the fourth.
    let mut want = String::new();
    for (k, row) in rows.iter().enumerate() {
        for (name, column) in [("aa", 1), ("ou", 3)] {
            let weight: f64 = row[column].parse().unwrap();
            want += &format!("{name} value {:.3} {weight:?}\n", 1.0 + k as f64);
        }
    }
    want += "without a shape key: ih, ee, oh\n";
    assert!(rows.len() == 106 && said == want, "{said}");
    assert!(!run(&["speech.csv"]).status.success());
}
