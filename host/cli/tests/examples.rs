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

/// Godot's script, read by gdtoolkit's parser and held against its rules of style; `tests/run` installs it. What the script looks up by name is in the file.
#[test]
fn godots_script_is_godots_language() {
    let reader = common::root().join("tests/python/installed");
    assert!(
        reader.is_dir(),
        "no gdtoolkit: tests/setup pip:tests/python installs it"
    );
    let read = |script: &std::path::Path| {
        let mut python = Command::new("python3");
        python.env("PYTHONPATH", &reader).args(["-m", "gdtoolkit.linter"]);
        python
            .arg(script)
            .output()
            .expect("python3, which tests/run installs")
    };
    let path = common::root().join("docs/examples/godot_blend_shapes.gd");
    let output = read(&path);
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(
        output.status.success(),
        "{said}{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let script = std::fs::read_to_string(&path).unwrap();
    let folder = common::folder("examples-godot");
    std::fs::write(
        folder.join("bad.gd"),
        script.replace("func _ready()", "func _ready("),
    )
    .unwrap();
    assert!(!read(&folder.join("bad.gd")).status.success());

    let hello = common::root().join("data/hello.wav");
    let words = ["cues", hello.to_str().unwrap(), "--set", "arkit", "--rate", "60"];
    succeed(&folder, &[&words[..], &["-o", "speech.json"]].concat());
    let table: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(folder.join("speech.json")).unwrap()).unwrap();
    let (names, frames) = (
        table["names"].as_array().unwrap(),
        table["frames"].as_array().unwrap(),
    );
    for frame in frames {
        assert!(frame["time"].is_f64() && frame["weights"].as_array().unwrap().len() == names.len());
    }
    for key in ["\"names\"", "\"frames\"", "\"time\"", "\"weights\""] {
        assert!(script.contains(key), "{key}");
    }
}

/// Spine's animation by the rules of its format: keys in order, the first without a time, each a picture that the slot has.
#[test]
fn spine_gets_a_key_for_each_shape() {
    let folder = common::folder("examples-spine");
    let hello = common::root().join("data/hello.wav");
    succeed(&folder, &["cues", hello.to_str().unwrap(), "-o", "speech.json"]);
    let skeleton = |shapes: &str| {
        let pictures: serde_json::Map<String, serde_json::Value> = shapes
            .chars()
            .map(|shape| (format!("mouth-{shape}"), serde_json::json!({})))
            .collect();
        serde_json::json!({
            "skeleton": { "spine": "4.2.0" },
            "bones": [{ "name": "root" }],
            "slots": [{ "name": "mouth", "bone": "root", "attachment": "mouth-A" }],
            "skins": [{ "name": "default", "attachments": { "mouth": pictures } }],
            "animations": { "walk": {} },
        })
    };
    let run = |skeleton: serde_json::Value| {
        std::fs::write(folder.join("skeleton.json"), skeleton.to_string()).unwrap();
        Command::new("python3")
            .current_dir(&folder)
            .arg(common::root().join("docs/examples/spine_mouth.py"))
            .args(["skeleton.json", "speech.json", "talking.json"])
            .output()
            .expect("python3, which tests/run installs")
    };
    let read = |name: &str| -> serde_json::Value {
        serde_json::from_str(&std::fs::read_to_string(folder.join(name)).unwrap()).unwrap()
    };
    let cues = read("speech.json")["mouthCues"].as_array().unwrap().clone();
    for extended in ["H", "X"] {
        assert!(cues.iter().any(|cue| cue["value"] == extended), "no {extended}");
    }

    // With every shape there is a key for each cue, at its moment.
    let output = run(skeleton("ABCDEFGHX"));
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let keys = |talking: &serde_json::Value| {
        assert!(talking["animations"]["walk"].is_object());
        let keys = &talking["animations"]["speech"]["slots"]["mouth"]["attachment"];
        keys.as_array().unwrap().clone()
    };
    let all = keys(&read("talking.json"));
    assert_eq!(all.len(), cues.len());
    assert!(all[0].get("time").is_none());
    for (key, cue) in all.iter().zip(&cues) {
        assert_eq!(
            key["name"],
            format!("mouth-{}", cue["value"].as_str().unwrap()).as_str()
        );
        assert_eq!(
            key.get("time").map_or(0.0, |time| time.as_f64().unwrap()),
            cue["start"].as_f64().unwrap()
        );
    }

    // With the six basic ones the others become these, and no key says what holds already.
    assert!(run(skeleton("ABCDEF")).status.success());
    let basic = keys(&read("talking.json"));
    assert!(basic.windows(2).all(|pair| pair[0]["name"] != pair[1]["name"]));
    assert!(basic.len() <= all.len());

    // A skeleton that cannot speak is refused in a line.
    let refused = run(skeleton("AB"));
    assert!(!refused.status.success());
    let why = String::from_utf8_lossy(&refused.stderr);
    assert!(
        why.starts_with("the slot has no attachment mouth-") && why.lines().count() == 1,
        "{why}"
    );
}
