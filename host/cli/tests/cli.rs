//! The command line, end to end, as a user meets it.
mod common;

use std::path::Path;
use std::process::{Command, Stdio};

use common::program::{program, refuse, run, succeed};
use lipstream_core::{AnyModel, Model, Recurrent, StreamSettings};

const COMMANDS: [&str; 21] = [
    "align",
    "check",
    "completions",
    "convert",
    "cues",
    "demo",
    "evaluate",
    "export",
    "features",
    "flash",
    "folds",
    "landmarks",
    "man",
    "mos",
    "prepare",
    "prompts",
    "record",
    "render",
    "servo",
    "train",
    "view",
];

fn path(path: &Path) -> String {
    path.to_str().expect("an ordinary name").to_owned()
}

fn hello() -> String {
    path(&common::root().join("data/hello.wav"))
}

/// Names of the files in `folder`, sorted.
fn files(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = folder
        .read_dir()
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn every_command_explains_itself() {
    let folder = common::folder("cli-help");
    let overview = succeed(&folder, &["--help"]);
    for command in COMMANDS {
        assert!(
            overview.contains(&format!("\n  {command} ")),
            "{command} is not in:\n{overview}"
        );
        let help = succeed(&folder, &[command, "--help"]);
        assert!(help.contains(&format!("Usage: lipstream {command}")), "{help}");
        // What has results has them for programs too; scripts and pages of the manual are for one reader each.
        let is_text = ["completions", "man"].contains(&command);
        let several = ["mos"].contains(&command); // its parts have their own
        assert!(
            is_text || several || help.contains("--json"),
            "{command} has no --json"
        );
        // Nobody asked for colours, and this is no terminal.
        assert!(!help.contains('\u{1b}'), "{help}");
    }
    let listed = overview.lines().skip_while(|line| *line != "Commands:").skip(1);
    let listed: Vec<&str> = listed
        .take_while(|line| !line.is_empty())
        .filter_map(|line| line.split_whitespace().next())
        .filter(|name| *name != "help")
        .collect();
    assert_eq!(listed, COMMANDS, "COMMANDS is not what the program offers");
    let short = concat!("lipstream ", env!("CARGO_PKG_VERSION"));
    assert_eq!(succeed(&folder, &["-V"]).trim(), short);
    // On what terms program and model are to be had.
    let long = succeed(&folder, &["--version"]);
    assert!(
        long.starts_with(short) && long.contains("MIT") && long.contains("CC BY 4.0"),
        "{long}"
    );
}

/// The shipped model is in the program: whoever names none gets it, in either arithmetic.
#[test]
fn without_a_model_it_is_the_shipped_one() {
    let folder = common::folder("cli-shipped");
    let models = common::root().join("models");
    let (model, tables) = (
        path(&models.join("grid-s1.safetensors")),
        path(&models.join("grid-s1.tables")),
    );
    let hello = hello();
    for (engine, named) in [("fixed", &tables), ("float", &model)] {
        let words = ["convert", &hello, "--engine", engine, "-o"];
        succeed(&folder, &[&words[..], &["own.csv"]].concat());
        succeed(&folder, &[&words[..], &["named.csv", "-m", named]].concat());
        let read = |name: &str| std::fs::read(folder.join(name)).unwrap();
        assert!(read("own.csv") == read("named.csv"), "{engine}");
        let words = ["cues", &hello, "--engine", engine];
        let own = succeed(&folder, &words);
        assert_eq!(
            own,
            succeed(&folder, &[&words[..], &["-m", named]].concat()),
            "{engine}"
        );
    }
    succeed(&folder, &["render", &hello, "-o", "own.mp4"]);
    succeed(&folder, &["render", &hello, "-o", "named.mp4", "-m", &model]);
    assert!(
        std::fs::read(folder.join("own.mp4")).unwrap() == std::fs::read(folder.join("named.mp4")).unwrap()
    );
}

/// The scripts and pages name every command, and the shell that is here takes its script.
#[test]
fn shells_and_man_know_every_command() {
    let folder = common::folder("cli-manual");
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = succeed(&folder, &["completions", shell]);
        assert!(COMMANDS.iter().all(|command| script.contains(command)), "{shell}");
    }
    std::fs::write(
        folder.join("lipstream.bash"),
        succeed(&folder, &["completions", "bash"]),
    )
    .unwrap();
    let checked = std::process::Command::new("bash")
        .current_dir(&folder)
        .args(["-c", "source ./lipstream.bash && complete -p lipstream"])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&checked.stdout).into_owned();
    assert!(checked.status.success() && said.contains("_lipstream"), "{said}");

    succeed(&folder, &["man", "pages"]);
    let mut want: Vec<String> = COMMANDS
        .iter()
        .map(|command| format!("lipstream-{command}.1"))
        .collect();
    want.push("lipstream.1".to_owned());
    want.sort();
    assert_eq!(files(&folder.join("pages")), want);
    let page = std::fs::read_to_string(folder.join("pages/lipstream-render.1")).unwrap();
    assert!(page.starts_with(".ie") || page.contains(".TH"), "{page}");
    std::fs::write(folder.join("taken"), "").unwrap();
    assert!(refuse(&folder, &["man", "taken/pages"]).contains("cannot make the folder taken/pages"));
}

#[test]
fn wrong_words_are_refused() {
    let folder = common::folder("cli-words");
    for words in [
        &[][..],
        &["speak"],
        &["convert", "--loud"],
        &["export"],
        &["train", "x", "-o", "y", "--sound-only", "--viterbi-start"],
        &["evaluate", "x", "--voices", "--also", "other=y"],
    ] {
        let output = run(&folder, words);
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{words:?}: {error}");
        assert!(error.contains("Usage: lipstream"), "{words:?}: {error}");
    }
}

/// What is not there is named, in one line, with exit code 1, and nothing is written.
#[test]
fn missing_files_are_named() {
    let folder = common::folder("cli-missing");
    let hello = hello();
    for words in [
        &["convert", "missing", "-m", "missing", "-o", "out.npy"][..],
        &["convert", &hello, "-m", "missing", "-o", "out.npy"],
        &["cues", "missing", "-m", "missing", "-o", "out.tsv"],
        &["cues", &hello, "-m", "missing", "-o", "out.tsv"],
        &["demo", "-m", "missing"],
        &["evaluate", "missing", "-m", "missing"],
        &["evaluate", "missing", "--also", "other=missing"],
        &["export", "missing", "-o", "out.tables"],
        &["features", "missing", "-o", "out.npy"],
        &["prepare", "missing", "-o", "out"],
        &["render", "missing.npy", "-m", "missing", "-o", "out.mp4"],
        &["train", "missing", "-o", "out.safetensors"],
    ] {
        let error = refuse(&folder, words);
        assert!(error.contains("missing"), "{words:?}: {error}");
    }
    assert_eq!(files(&folder), [""; 0]);
}

/// Files that are not what they are taken for: named, in one line, and nothing is written.
#[test]
fn wrong_files_are_named() {
    let folder = common::folder("cli-wrong");
    let hello = hello();
    let model = common::synthetic_model();
    model.write(&folder.join("model.safetensors")).unwrap();
    let tables = common::synthetic_tables();
    std::fs::write(folder.join("empty.wav"), []).unwrap();
    std::fs::write(folder.join("text.wav"), "This is no sound.\n".repeat(100)).unwrap();
    std::fs::write(folder.join("empty.safetensors"), []).unwrap();
    let whole = std::fs::read(folder.join("model.safetensors")).unwrap();
    std::fs::write(folder.join("cut.safetensors"), &whole[..whole.len() / 2]).unwrap();
    std::fs::write(folder.join("cut.tables"), &tables[..1000]).unwrap();
    let mut damaged = tables;
    let middle = damaged.len() / 2;
    damaged[middle] ^= 1;
    std::fs::write(folder.join("damaged.tables"), damaged).unwrap();
    std::fs::write(folder.join("wrong.npy"), "not numpy").unwrap();

    let before = files(&folder);
    for words in [
        &["convert", "empty.wav", "-m", "model.safetensors", "-o", "out.npy"][..],
        &["convert", "text.wav", "-m", "model.safetensors", "-o", "out.npy"],
        &["convert", &hello, "-m", "empty.safetensors", "-o", "out.npy"],
        &["convert", &hello, "-m", "cut.safetensors", "-o", "out.npy"],
        &["convert", &hello, "-m", "cut.tables", "-o", "out.npy"],
        &["convert", &hello, "-m", "damaged.tables", "-o", "out.npy"],
        &["cues", "text.wav", "-m", "model.safetensors", "-o", "out.tsv"],
        &["demo", "-m", "cut.safetensors"],
        &["demo", "--wav", "text.wav", "-m", "model.safetensors"],
        &["export", "cut.safetensors", "-o", "out.tables"],
        &["export", "text.wav", "-o", "out.tables"],
        &["features", "text.wav", "-o", "out.npy"],
        &["features", "empty.wav", "-o", "out.npy"],
        &["render", "wrong.npy", "-m", "model.safetensors", "-o", "out.mp4"],
    ] {
        let error = refuse(&folder, words);
        let culprit = words.iter().find(|word| {
            ["empty.", "text.", "cut.", "damaged.", "wrong."]
                .iter()
                .any(|start| word.starts_with(start))
        });
        assert!(error.contains(culprit.unwrap()), "{words:?}: {error}");
        assert_eq!(files(&folder), before, "{words:?} left a file");
    }
}

/// `export`, then `convert` with the tables: the core's numbers in the model's units.
#[test]
fn export_and_convert() {
    let folder = common::folder("cli-convert");
    let hello = hello();
    let float = common::synthetic_model();
    float.write(&folder.join("model.safetensors")).unwrap();
    succeed(&folder, &["export", "model.safetensors", "-o", "model.tables"]);
    let tables = std::fs::read(folder.join("model.tables")).unwrap();
    assert!(
        tables == common::synthetic_tables(),
        "the program exports other tables than the library"
    );

    let model = AnyModel::new_checked(&tables).unwrap();
    let frames = common::host_frames(&model, StreamSettings::default(), &common::hello());
    let scales: Vec<f32> = model.head().parameter_scales().collect();
    for source in ["model.tables", "model.safetensors"] {
        succeed(&folder, &["convert", &hello, "-m", source, "-o", "out.npy"]);
        let converted: ndarray::Array2<f32> = ndarray_npy::read_npy(folder.join("out.npy")).unwrap();
        assert_eq!(converted.dim(), (frames.len(), scales.len()));
        for (row, frame) in converted.outer_iter().zip(&frames) {
            for ((value, units), scale) in row.iter().zip(&frame.values).zip(&scales) {
                let expected = f32::from(*units) * scale;
                assert!(
                    (value - expected).abs() <= expected.abs() * 1e-6,
                    "{value} {expected}"
                );
            }
        }
    }
    for (option, limit, said) in [
        ("--flash", "100", "no model fits 100 KiB"),
        ("--cycles", "9000", "no model fits 9000 instructions a hop"),
    ] {
        let error = refuse(
            &folder,
            &["export", "model.safetensors", "-o", "big.tables", option, limit],
        );
        assert!(error.contains(said), "{error}");
    }
    assert!(!folder.join("big.tables").exists());
}

/// Where nobody reads what it prints (`lipstream … | head`) the program ends without a word, its work done.
#[test]
fn a_closed_pipe_ends_it_quietly() {
    let folder = common::folder("cli-pipe");
    let model = path(&common::root().join("models/grid-s1.safetensors"));
    let mut child = Command::new(program())
        .current_dir(&folder)
        .args(["export", &model, "-o", "grid-s1.tables"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(String::from_utf8_lossy(&output.stderr), "");
    assert_eq!(output.status.code(), Some(141));
    assert_eq!(files(&folder), ["grid-s1.tables"]);
}

/// A budget of instructions chooses the widest beam that it has room for.
#[test]
fn a_budget_chooses_the_beam() {
    let folder = common::folder("cli-budget");
    let model = path(&common::root().join("models/grid-s1.safetensors"));
    let beam = |cycles: &str| {
        let said = succeed(
            &folder,
            &[
                "export",
                &model,
                "-o",
                "fit.tables",
                "--cycles",
                cycles,
                "--flash",
                "190",
            ],
        );
        let tables = std::fs::read(folder.join("fit.tables")).unwrap();
        let model = Model::<Recurrent>::new_checked(&tables).unwrap();
        let beam = model.own().settings().beam.q12() >> 12;
        assert!(said.contains(&format!("beam {beam} bits: 173.9 KiB")), "{said}");
        assert_eq!(said.matches(": chosen\n").count(), 1, "{said}");
        beam
    };
    assert_eq!([beam("140000"), beam("165000"), beam("1000000")], [7, 10, 14]);
    let words = ["export", &model, "-o", "never.tables", "--cycles", "100000"];
    let error = refuse(&folder, &words);
    assert!(
        error.contains("no model fits 100000 instructions a hop"),
        "{error}"
    );
    assert!(!folder.join("never.tables").exists());
}

/// EM in the lag window and settling: each for the kind of model that knows it, refused by the other.
#[test]
fn switches_of_one_kind_of_model() {
    let folder = common::folder("cli-switches");
    let hello = hello();
    let shipped = path(&common::root().join("models/grid-s1.tables"));
    common::synthetic_model()
        .write(&folder.join("likely.safetensors"))
        .unwrap();
    for (output, more) in [("maps.tables", None), ("both.tables", Some("--visual-densities"))] {
        let words = ["export", "likely.safetensors", "-o", output];
        succeed(&folder, &[&words[..], more.as_slice()].concat());
    }
    let convert = |model: &str, more: &[&str]| {
        let words = ["convert", &hello, "-m", model, "-o", "out.npy"];
        succeed(&folder, &[&words[..], more].concat());
        let out: ndarray::Array2<f32> = ndarray_npy::read_npy(folder.join("out.npy")).unwrap();
        out
    };
    let (maps, em) = (
        convert("both.tables", &[]),
        convert("both.tables", &["--feedback", "0.1"]),
    );
    assert_eq!(maps, convert("maps.tables", &[]));
    assert_eq!(em, convert("likely.safetensors", &["--feedback", "0.1"]));
    assert_eq!(em.dim(), maps.dim());
    assert_ne!(em, maps);
    let (settled, lively) = (convert(&shipped, &[]), convert(&shipped, &["--no-settling"]));
    assert_eq!(settled.dim(), lively.dim());
    assert_ne!(settled, lively);

    for (model, more, said) in [
        ("maps.tables", &["--feedback", "0.1"][..], "no visual densities"),
        (&shipped, &["--feedback", "0.1"], "no visual densities"),
        ("both.tables", &["--feedback", "5"], "0 to 4"),
        ("both.tables", &["--no-settling"], "leave --no-settling out"),
        (
            "likely.safetensors",
            &["--no-settling", "--engine", "float"],
            "leave --no-settling out",
        ),
    ] {
        let words = ["convert", &hello, "-m", model, "-o", "refused.npy"];
        let error = refuse(&folder, &[&words[..], more].concat());
        assert!(error.contains(said), "{error}");
    }
    assert!(!folder.join("refused.npy").exists());
}

/// Every way to find the mouth says something else; each is there in floats only, for likelihood-trained models only.
#[test]
fn the_mouth_is_found_in_four_ways() {
    let folder = common::folder("cli-mouth-by");
    let hello = hello();
    let shipped = path(&common::root().join("models/grid-s1.safetensors"));
    common::synthetic_model()
        .write(&folder.join("likely.safetensors"))
        .unwrap();
    let words = ["convert", &hello, "-m", "likely.safetensors", "-o", "out.npy"];
    let ways = ["means", "posterior", "viterbi", "local-linear"];
    let said = ways.map(|way| {
        let more = ["--engine", "float", "--mouth-by", way];
        succeed(&folder, &[&words[..], &more].concat());
        let out: ndarray::Array2<f32> = ndarray_npy::read_npy(folder.join("out.npy")).unwrap();
        out
    });
    for (n, one) in said.iter().enumerate() {
        assert_eq!(one.dim(), said[0].dim());
        for (way, other) in ways.iter().zip(&said).take(n) {
            assert_ne!(one, other, "{way} says what {} says", ways[n]);
        }
    }
    for (model, more) in [
        ("likely.safetensors", &[][..]),
        (&shipped, &[]),
        (&shipped, &["--engine", "float"]),
    ] {
        let words = [
            "convert",
            &hello,
            "-m",
            model,
            "-o",
            "no.npy",
            "--mouth-by",
            "means",
        ];
        let error = refuse(&folder, &[&words[..], more].concat());
        assert!(error.contains("likelihood-trained model in floats"), "{error}");
    }
    assert!(!folder.join("no.npy").exists());
}

/// The shipped tables are the shipped model's.
#[test]
fn shipped_tables_are_up_to_date() {
    let folder = common::folder("cli-shipped");
    let model = path(&common::root().join("models/grid-s1.safetensors"));
    succeed(&folder, &["export", &model, "-o", "grid-s1.tables"]);
    assert!(
        std::fs::read(folder.join("grid-s1.tables")).unwrap() == common::shipped_tables(),
        "lipstream export models/grid-s1.safetensors -o models/grid-s1.tables"
    );
    let said = refuse(&folder, &["export", &model, "--one-memory", "-o", "light.tables"]);
    assert!(said.contains("no second memory to leave out"), "{said}");
    assert!(!folder.join("light.tables").exists());
}

/// The demo without ffmpeg, away from the repository: a video with sound, a page that needs nothing else, cues.
#[test]
fn demo_stands_alone() {
    let folder = common::folder("cli-demo");
    let said = succeed(&folder, &["demo"]);
    let out = folder.join("out");
    let video = std::fs::read(out.join("hello.mp4")).unwrap();
    assert_eq!(&video[4..8], b"ftyp");
    for part in [b"avc1", b"mp4a"] {
        assert!(
            video.windows(4).any(|bytes| bytes == part),
            "no {} in the video",
            part.escape_ascii()
        );
    }
    let page = std::fs::read_to_string(out.join("hello.html")).unwrap();
    assert!(
        page.contains("data:video/mp4;base64,"),
        "the page carries no video"
    );
    for outside in [
        "src=\"http",
        "href=\"http",
        "src=\"/",
        "url(http",
        "@import",
        "fetch(",
    ] {
        assert!(!page.contains(outside), "the page needs {outside}");
    }
    let files = files(&out);
    assert!(files.len() >= 3);
    for file in files {
        let place = Path::new("out").join(file);
        assert!(
            said.contains(&path(&place)),
            "{} is not in:\n{said}",
            place.display()
        );
    }
}

/// What the program gives on standard output for a file on standard input.
fn through(folder: &Path, input: &str, arguments: &[&str]) -> Vec<u8> {
    let output = Command::new(program())
        .current_dir(folder)
        .env("PATH", "")
        .args(arguments)
        .stdin(std::fs::File::open(input).unwrap())
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{arguments:?}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    output.stdout
}

#[test]
fn a_dash_is_standard_input_and_output() {
    let folder = common::folder("cli-dash");
    let (hello, model) = (hello(), path(&common::root().join("models/grid-s1.tables")));
    for format in ["csv", "json", "npy"] {
        let file = format!("out.{format}");
        succeed(&folder, &["convert", &hello, "-m", &model, "-o", &file]);
        let piped = through(
            &folder,
            &hello,
            &["convert", "-", "-m", &model, "-o", "-", "--format", format],
        );
        assert!(piped == std::fs::read(folder.join(&file)).unwrap(), "{format}");
    }
    succeed(&folder, &["cues", &hello, "-m", &model, "-o", "out.tsv"]);
    let piped = through(&folder, &hello, &["cues", "-", "-m", &model, "-o", "-"]);
    assert!(piped == std::fs::read(folder.join("out.tsv")).unwrap());
    for format in ["htk", "npy"] {
        let file = format!("out.{format}");
        succeed(&folder, &["features", &hello, "-o", &file]);
        let piped = through(&folder, &hello, &["features", "-", "-o", "-", "--format", format]);
        assert!(piped == std::fs::read(folder.join(&file)).unwrap(), "{format}");
    }
    let error = refuse(&folder, &["convert", &hello, "-m", &model, "-o", "out.txt"]);
    assert_eq!(error, "out.txt: write .npy, .csv or .json");
}

/// An ending that no format has is no folder's name, and capitals make no difference.
#[test]
fn alignments_go_where_their_name_says() {
    let folder = common::folder("cli-align-endings");
    std::fs::write(
        folder.join("text.txt"),
        "Hello. I read your sound, and I move this mouth with it, live.",
    )
    .unwrap();
    let hello = hello();
    let align = |out: &str| ["align", &hello, "-t", "text.txt", "-o", out].map(str::to_owned);
    let error = refuse(&folder, &align("s.ctm"));
    assert!(error.starts_with("s.ctm: write .lab"), "{error}");
    assert!(!folder.join("s.ctm").exists());
    succeed(&folder, &align("S.JSON"));
    assert!(folder.join("S.JSON").is_file());
    succeed(&folder, &align("v1.2/"));
    assert!(folder.join("v1.2/hello.TextGrid").is_file());
}

/// What cannot be written is said in a line, whether it is the answer itself or only the word about it.
#[test]
fn a_full_standard_output_is_said() {
    let folder = common::folder("cli-full");
    let (hello, model) = (hello(), path(&common::root().join("models/grid-s1.tables")));
    for output in ["-", "out.tsv"] {
        let full = Command::new(program())
            .current_dir(&folder)
            .args(["cues", &hello, "-m", &model, "-o", output])
            .stdout(std::fs::File::create("/dev/full").unwrap())
            .stderr(Stdio::piped())
            .output()
            .unwrap();
        let error = common::program::one_line(full);
        assert!(error.starts_with("cannot write to standard output: "), "{error}");
    }
    assert!(folder.join("out.tsv").is_file());
}

/// A writer to a pipe cannot say how long the sound becomes.
#[test]
fn a_streamed_sound_is_read_to_its_end() {
    let folder = common::folder("cli-streamed");
    let (hello, model) = (hello(), path(&common::root().join("models/grid-s1.tables")));
    let mut streamed = std::fs::read(&hello).unwrap();
    for at in [4, 40] {
        streamed[at..at + 4].fill(0xff);
    }
    std::fs::write(folder.join("streamed.wav"), &streamed).unwrap();
    succeed(&folder, &["convert", &hello, "-m", &model, "-o", "whole.csv"]);
    succeed(
        &folder,
        &["convert", "streamed.wav", "-m", &model, "-o", "file.csv"],
    );
    let whole = std::fs::read(folder.join("whole.csv")).unwrap();
    assert!(whole == std::fs::read(folder.join("file.csv")).unwrap());
    let streamed = path(&folder.join("streamed.wav"));
    assert!(whole == through(&folder, &streamed, &["convert", "-", "-m", &model, "-o", "-"]));
}

/// Pictures on a pipe and in a folder are the same ones.
#[test]
fn pictures_go_to_a_pipe_or_a_folder() {
    let folder = common::folder("cli-pictures");
    let (hello, model) = (hello(), path(&common::root().join("models/grid-s1.safetensors")));
    let render = [
        "render", &hello, "-m", &model, "--scale", "1", "--fps", "10", "-o",
    ];
    let raw = through(&folder, &hello, &[&render[..], &["-"]].concat());
    let said = succeed(&folder, &[&render[..], &["frames/"]].concat());
    let names = files(&folder.join("frames"));
    assert_eq!(names.first().map(String::as_str), Some("000001.png"));
    assert!(
        said.contains(&format!("{} pictures of 64×48", names.len())),
        "{said}"
    );
    assert_eq!(raw.len(), names.len() * 64 * 48 * 3);
    let error = refuse(&folder, &[&render[..], &["frames/"]].concat());
    assert!(error.contains("frames/ exists"), "{error}");
}

/// What is recorded live is what is converted from the file, and it is drawn and read back.
#[test]
fn a_recording_is_what_was_spoken() {
    let folder = common::folder("cli-record");
    let (hello, tables) = (hello(), path(&common::root().join("models/grid-s1.tables")));
    let model = path(&common::root().join("models/grid-s1.safetensors"));
    let said = succeed(
        &folder,
        &["record", "--wav", &hello, "-o", "a.stream", "--to", "csv:a.csv"],
    );
    assert!(said.contains("a.stream: 420 frames, 0 lost, 0 damaged"), "{said}");
    succeed(&folder, &["convert", "a.stream", "-o", "live.npy"]);
    let convert = [
        "convert",
        &hello,
        "-m",
        &tables,
        "--profile",
        "standard",
        "-o",
        "file.npy",
    ];
    succeed(&folder, &convert);
    let read = |name: &str| std::fs::read(folder.join(name)).unwrap();
    assert!(read("live.npy") == read("file.npy"));
    assert_eq!(String::from_utf8(read("a.csv")).unwrap().lines().count(), 421);
    // The sound beside it is the sound, from the first frame's window on.
    let heard = lipstream_media::sound::read(&folder.join("a.wav"))
        .unwrap()
        .samples;
    assert_eq!(
        heard,
        lipstream_media::sound::read(hello.as_ref()).unwrap().samples
    );
    let render = ["render", "a.stream", "-m", &model, "--scale", "1", "-o", "a.mp4"];
    assert!(succeed(&folder, &render).contains("106 pictures of 64×48"));
    // Nothing is overwritten, and what is no stream is refused.
    let error = refuse(&folder, &["record", "--wav", &hello, "-o", "a.stream"]);
    assert!(error.starts_with("cannot write a.stream: "), "{error}");
    std::fs::write(folder.join("b.stream"), b"words").unwrap();
    let error = refuse(&folder, &["convert", "b.stream", "-o", "b.csv"]);
    assert!(error.starts_with("b.stream is no recorded stream"), "{error}");
    let error = refuse(&folder, &["record", "no/such/port", "-o", "c.stream"]);
    assert!(error.starts_with("no/such/port: no such port or file"), "{error}");
    let output = Command::new(program())
        .args(["record", "a.stream", "-o", "c.stream", "--to", "osc://box"])
        .output()
        .unwrap();
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.code() == Some(2) && error.contains("a target is vmc://"),
        "{error}"
    );
}
