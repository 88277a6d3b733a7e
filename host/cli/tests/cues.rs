//! `lipstream cues`, and many sounds at once, as a user meets them.
mod common;

use std::path::Path;
use std::process::{Command, Stdio};

use common::program::{interrupt, program, refuse, run, succeed};

fn path(path: &Path) -> String {
    path.to_str().expect("an ordinary name").to_owned()
}

fn hello() -> String {
    path(&common::root().join("data/hello.wav"))
}

/// Every file in `folder` and the folders in it, sorted.
fn tree(folder: &Path) -> Vec<String> {
    fn walk(folder: &Path, root: &Path, out: &mut Vec<String>) {
        for entry in folder.read_dir().unwrap() {
            let at = entry.unwrap().path();
            match at.is_dir() {
                true => walk(&at, root, out),
                false => out.push(path(at.strip_prefix(root).unwrap())),
            }
        }
    }
    let mut out = Vec::new();
    walk(folder, folder, &mut out);
    out.sort();
    out
}

/// A folder with two sounds, one of them deeper, and something that is none.
fn sounds(folder: &Path) {
    std::fs::create_dir_all(folder.join("in/deep")).unwrap();
    for name in ["in/a.b.wav", "in/deep/c.wav"] {
        std::fs::copy(hello(), folder.join(name)).unwrap();
    }
    std::fs::write(folder.join("in/notes.txt"), "no sound").unwrap();
}

/// Rhubarb Lip Sync's typical calls, with its program's name replaced.
#[test]
fn a_rhubarb_user_changes_one_word() {
    let folder = common::folder("cli-rhubarb");
    std::fs::copy(hello(), folder.join("my-recording.wav")).unwrap();
    std::fs::write(
        folder.join("dialog.txt"),
        "Hello. I read your sound, and I move this mouth with it, live.",
    )
    .unwrap();
    // The simplest one writes TSV, whatever the file is called.
    succeed(&folder, &["cues", "-o", "output.txt", "my-recording.wav"]);
    let tsv = std::fs::read_to_string(folder.join("output.txt")).unwrap();
    assert!(
        tsv.starts_with("0.00\tX\n") && tsv.ends_with("4.22\tX\n"),
        "{tsv}"
    );
    assert_eq!(succeed(&folder, &["cues", "my-recording.wav"]), tsv);
    let json = succeed(
        &folder,
        &["cues", "-f", "json", "-r", "phonetic", "-q", "my-recording.wav"],
    );
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(
        json["metadata"]["soundFile"],
        path(&std::path::absolute(folder.join("my-recording.wav")).unwrap())
    );
    assert_eq!(json["metadata"]["duration"], 4.22);
    let six = succeed(
        &folder,
        &[
            "cues",
            "--exportFormat",
            "tsv",
            "--extendedShapes",
            "",
            "my-recording.wav",
        ],
    );
    assert!(
        six.starts_with("0.00\tA\n") && !six.contains(['G', 'H', 'X']),
        "{six}"
    );
    let dat = [
        "cues",
        "-f",
        "dat",
        "--datFrameRate",
        "30",
        "--datUsePrestonBlair",
        "-o",
        "out.dat",
        "my-recording.wav",
    ];
    succeed(&folder, &dat);
    let dat = std::fs::read_to_string(folder.join("out.dat")).unwrap();
    assert!(
        dat.starts_with("MohoSwitch1\n1 rest\n") && dat.ends_with("127 rest\n"),
        "{dat}"
    );

    // With the text the times are those of its phones; with another one the sound alone decides, and that is said.
    let run = |words: &[&str]| {
        let output = run(&folder, words);
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        (
            common::program::text(&output.stdout),
            common::program::text(&output.stderr),
        )
    };
    let (said, _) = run(&["cues", "-q", "-d", "dialog.txt", "my-recording.wav"]);
    std::fs::write(
        folder.join("other.txt"),
        "Seven green bottles were standing there",
    )
    .unwrap();
    let (other, warned) = run(&["cues", "-d", "other.txt", "my-recording.wav"]);
    assert!(warned.contains("other.txt do not fit what is heard"), "{warned}");
    assert_eq!(other, tsv);
    // As there, --quiet speaks of errors alone, unless another level is asked for.
    let quiet = ["cues", "-q", "-d", "other.txt", "my-recording.wav"];
    assert_eq!(run(&quiet), (tsv.clone(), String::new()));
    let (_, warned) = run(&[&quiet[..], &["--consoleLevel", "warning"]].concat());
    assert!(warned.contains("do not fit"), "{warned}");
    assert!(!said.is_empty());

    // For programs: a JSON object a line.
    let lines = |text: &str| -> Vec<serde_json::Value> {
        text.lines().map(|l| serde_json::from_str(l).unwrap()).collect()
    };
    let (_, events) = run(&["cues", "--machineReadable", "my-recording.wav"]);
    let kinds: Vec<String> = lines(&events)
        .iter()
        .map(|e| e["type"].as_str().unwrap().to_owned())
        .collect();
    assert_eq!(
        (kinds.first().unwrap().as_str(), kinds.last().unwrap().as_str()),
        ("start", "success")
    );
    // Progress begins at 0, only rises, ends at 1, and there is some between.
    let values = lines(&events);
    let values: Vec<f64> = values.iter().filter_map(|e| e["value"].as_f64()).collect();
    assert_eq!(values.len(), kinds.len() - 2, "{events}");
    assert!(values.is_sorted() && values.len() > 2, "{values:?}");
    assert_eq!((values[0], *values.last().unwrap()), (0.0, 1.0));
    let failed = common::program::run(&folder, &["cues", "--machineReadable", "missing.wav"]);
    let events = lines(&common::program::text(&failed.stderr));
    assert_eq!(failed.status.code(), Some(1));
    assert_eq!(events.last().unwrap()["type"], "failure");
    assert!(
        events.last().unwrap()["reason"]
            .as_str()
            .unwrap()
            .contains("missing.wav")
    );

    for words in [
        &["cues", "--extendedShapes", "GQ", "my-recording.wav"][..],
        &["cues", "-f", "dat", "--datFrameRate", "12", "my-recording.wav"],
        &["cues", "-r", "magic", "my-recording.wav"],
    ] {
        assert_eq!(
            common::program::run(&folder, words).status.code(),
            Some(2),
            "{words:?}"
        );
    }
    let error = refuse(&folder, &["cues", "--datUsePrestonBlair", "my-recording.wav"]);
    assert!(error.contains("are for --format dat"), "{error}");
    let error = refuse(&folder, &["cues", "-o", "x.foo", "my-recording.wav"]);
    assert!(error.starts_with("x.foo: write .tsv"), "{error}");
}

/// The set's weights at a film's pictures, as rows and as an object.
#[test]
fn weights_at_a_chosen_rate() {
    let folder = common::folder("cues-weights");
    let hello = hello();
    for (set, names) in [
        ("oculus", 15),
        ("arkit", 52),
        ("azure", 22),
        ("polly", 18),
        ("vrm", 5),
        ("facs", 11),
    ] {
        let csv = succeed(&folder, &["cues", &hello, "--set", set, "--rate", "29.97"]);
        let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
        // 4.22 s of 30000/1001 pictures a second.
        assert_eq!(rows.len(), 1 + 127, "{set}");
        assert!(rows.iter().all(|row| row.len() == names + 2), "{set}");
        assert_eq!((rows[0][0], rows[0][names + 1]), ("time", "open"));
        let open: Vec<f64> = rows[1..]
            .iter()
            .map(|row| row[names + 1].parse().unwrap())
            .collect();
        let most = open.iter().fold(0.0, |a: f64, b| a.max(*b));
        assert!(
            most > 0.5 && open.iter().any(|open| *open < 0.1),
            "{set}: {open:?}"
        );
        succeed(
            &folder,
            &[
                "cues",
                &hello,
                "--set",
                set,
                "--rate",
                "30000/1001",
                "-o",
                "out.json",
            ],
        );
        let json: serde_json::Value =
            serde_json::from_slice(&std::fs::read(folder.join("out.json")).unwrap()).unwrap();
        assert_eq!(json["frames"].as_array().unwrap().len(), rows.len() - 1, "{set}");
    }
    let vtt = succeed(&folder, &["cues", &hello, "-f", "vtt"]);
    assert!(vtt.starts_with("WEBVTT\n\n00:00:00.000 --> "), "{vtt}");
    for words in [
        &["cues", &hello, "--rate", "25"][..],
        &["cues", &hello, "--set", "arkit", "-f", "tsv"],
        &["cues", &hello, "--set", "arkit", "-o", "out.vtt"],
    ] {
        let error = refuse(&folder, words);
        assert!(error.contains("--set and --rate are for weights"), "{error}");
    }
}

/// With a text its phones' visemes are what the weights are made of.
#[test]
fn weights_follow_the_text() {
    let folder = common::folder("cues-weights-text");
    std::fs::write(
        folder.join("said.txt"),
        "Hello. I read your sound, and I move this mouth with it, live.",
    )
    .unwrap();
    let words = ["cues", &hello(), "--set", "oculus"];
    let heard = succeed(&folder, &words);
    let told = succeed(&folder, &[&words[..], &["-d", "said.txt"]].concat());
    assert_eq!(heard.lines().count(), told.lines().count());
    // A text says one viseme at a time: of "PP", which nothing measured changes, there is all or nothing before lips part.
    let pp = |csv: &str| -> Vec<f64> {
        csv.lines()
            .skip(1)
            .map(|row| row.split(',').nth(2).unwrap().parse().unwrap())
            .collect()
    };
    assert!(pp(&told).iter().filter(|w| **w > 0.0).count() >= 10);
    assert_ne!(pp(&heard), pp(&told));
}

/// A folder, a pattern and a list, each file as if it had been alone.
#[test]
fn many_sounds_go_into_a_folder() {
    let folder = common::folder("cues-many");
    sounds(&folder);
    let alone = succeed(&folder, &["cues", "in/a.b.wav"]);
    succeed(&folder, &["cues", "in", "-o", "tree", "--threads", "2"]);
    assert_eq!(tree(&folder.join("tree")), ["a.b.tsv", "deep/c.tsv"]);
    for (input, out) in [("in/**/*.wav", "pattern"), ("in/deep", "one")] {
        succeed(&folder, &["cues", input, "-o", out, "-q"]);
        assert!(
            std::fs::read_to_string(folder.join(out).join("c.tsv")).unwrap() == alone,
            "{input}"
        );
    }
    succeed(
        &folder,
        &[
            "convert",
            "in/a.b.wav",
            "in/deep/c.wav",
            "-o",
            "numbers",
            "--format",
            "npy",
        ],
    );
    assert_eq!(tree(&folder.join("numbers")), ["a.b.npy", "c.npy"]);
    succeed(&folder, &["convert", "in/a.b.wav", "-o", "alone.npy"]);
    assert!(
        std::fs::read(folder.join("alone.npy")).unwrap()
            == std::fs::read(folder.join("numbers/c.npy")).unwrap()
    );
    // Outputs inside of the folder that is read are no inputs the next time.
    succeed(&folder, &["cues", "in", "-o", "in/out"]);
    succeed(&folder, &["cues", "in", "-o", "in/out"]);
    assert_eq!(tree(&folder.join("in/out")), ["a.b.tsv", "deep/c.tsv"]);
}

/// What cannot be done at all is refused before anything is written.
#[test]
fn many_sounds_are_kept_apart() {
    let folder = common::folder("cues-apart");
    sounds(&folder);
    std::fs::copy(hello(), folder.join("in/c.flac")).unwrap();
    std::fs::create_dir(folder.join("empty")).unwrap();
    let before = tree(&folder);
    for (words, said) in [
        (
            &["cues", "in/c.flac", "in/deep/c.wav", "-o", "out"][..],
            "would both be written to out/c.tsv",
        ),
        (&["cues", "in"], "name the folder"),
        (&["cues", "in", "-o", "out.tsv"], "out.tsv is a file"),
        (&["cues", "in", "-o", "in/notes.txt"], "in/notes.txt is a file"),
        (&["cues", "*.ogg", "-o", "out"], "no file matches *.ogg"),
        (&["cues", "empty", "-o", "out"], "empty: there is no sound"),
        (&["cues", "-", "in", "-o", "out"], "standard input is one sound"),
        (
            &["cues", "in", "-o", "out", "-d", "in/notes.txt"],
            "the text of one sound",
        ),
        (&["convert", "in", "-o", "out.npy"], "out.npy is a file"),
    ] {
        let error = refuse(&folder, words);
        assert!(error.contains(said), "{words:?}: {error}");
        assert_eq!(tree(&folder), before, "{words:?}");
    }
}

/// One damaged file costs the others nothing, and everybody hears of it: people, programs, and the log.
#[test]
fn a_damaged_sound_among_many_is_named() {
    let folder = common::folder("cues-damaged");
    sounds(&folder);
    let whole = std::fs::read(hello()).unwrap();
    std::fs::write(folder.join("in/cut.wav"), &whole[..9000]).unwrap();
    let words = ["cues", "in", "-o", "out", "--logFile", "log.txt"];
    let people = run(&folder, &words);
    assert_eq!(people.status.code(), Some(1));
    let said = common::program::text(&people.stderr);
    assert!(
        said.contains("in/cut.wav") && said.contains("1 of 3 sounds failed"),
        "{said}"
    );
    assert_eq!(tree(&folder.join("out")), ["a.b.tsv", "deep/c.tsv"]);
    let log = std::fs::read_to_string(folder.join("log.txt")).unwrap();
    assert!(
        log.contains("[Error] cannot read in/cut.wav") && log.contains("[Info] out/a.b.tsv"),
        "{log}"
    );
    assert!(!log.contains("[Trace]"), "{log}");
    let programs = run(&folder, &[&words[..], &["--machineReadable"]].concat());
    let lines = common::program::text(&programs.stderr);
    let lines: Vec<serde_json::Value> = lines
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert!(
        lines
            .iter()
            .any(|l| l["type"] == "log" && l["text"].as_str().unwrap().contains("in/cut.wav"))
    );
    assert_eq!(lines.last().unwrap()["type"], "failure");
    let error = refuse(
        &folder,
        &[
            "cues",
            "in/a.b.wav",
            "--logFile",
            "no/log.txt",
            "--consoleLevel",
            "FATAL",
        ],
    );
    assert!(
        error.starts_with("cannot write the log file no/log.txt"),
        "{error}"
    );
}

/// Whoever presses Ctrl-C finds nothing half-written.
#[cfg(unix)]
#[test]
fn an_interrupt_leaves_nothing() {
    let folder = common::folder("cues-interrupt");
    let whole = std::fs::read(hello()).unwrap();
    // Ten minutes, which nobody converts within the time that is given here.
    let mut long = whole.clone();
    (0..150).for_each(|_| long.extend(&whole[44..]));
    let length = u32::try_from(long.len() - 44).unwrap();
    long[40..44].copy_from_slice(&length.to_le_bytes());
    long[4..8].copy_from_slice(&(length + 36).to_le_bytes());
    std::fs::write(folder.join("long.wav"), long).unwrap();
    std::fs::create_dir(folder.join("out")).unwrap();
    let mut child = Command::new(program())
        .current_dir(&folder)
        .args(["convert", "long.wav", "-o", "out/long.csv"])
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // Until it has begun to write.
    let begun = std::time::Instant::now();
    while tree(&folder.join("out")).is_empty() {
        assert!(begun.elapsed().as_secs() < 60, "nothing is written");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    interrupt(&child);
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert_eq!(tree(&folder.join("out")), [""; 0]);
}

/// A sound without a text is named, and costs the others nothing; a text that is not said is aligned with a warning and its score.
#[test]
fn wrong_texts_are_noticed() {
    let folder = common::folder("cues-texts");
    std::fs::create_dir(folder.join("in")).unwrap();
    for name in ["right", "wrong", "without"] {
        std::fs::copy(hello(), folder.join(format!("in/{name}.wav"))).unwrap();
    }
    let right = "Hello. I read your sound, and I move this mouth with it, live.";
    std::fs::write(folder.join("in/right.txt"), right).unwrap();
    let wrong = "Seven green bottles were standing on the wall and twenty two more unrelated words come here to be aligned with nothing at all";
    std::fs::write(folder.join("in/wrong.txt"), wrong).unwrap();
    let done = run(&folder, &["align", "in", "-o", "out", "--format", "json"]);
    let said = common::program::text(&done.stderr);
    assert_eq!(done.status.code(), Some(1), "{said}");
    assert_eq!(tree(&folder.join("out")), ["right.json", "wrong.json"], "{said}");
    assert!(
        said.contains("skipped: in/without.wav has no text beside it"),
        "{said}"
    );
    assert!(said.contains("1 of 3 clips could not be aligned"), "{said}");
    let warned: Vec<&str> = said
        .lines()
        .filter(|line| line.starts_with("warning: "))
        .collect();
    assert!(
        warned.len() == 1
            && warned[0].contains("in/wrong.wav do not fit what is heard (")
            && warned[0].contains("nats a frame worse"),
        "{said}"
    );
    // Alone it is refused, and whoever says that the text is right is not told otherwise.
    let error = refuse(&folder, &["align", "in/without.wav", "-o", "x.json"]);
    assert!(error.contains("in/without.wav has no text"), "{error}");
    let alone = run(&folder, &["align", "in/right.wav", "-o", "x.json"]);
    assert_eq!(
        common::program::text(&alone.stderr),
        "aligned 1 clips into x.json\n"
    );
}

/// Neither by its own name nor through a link: what was recorded is not written over.
#[test]
fn a_recording_is_not_written_over() {
    let folder = common::folder("cues-onto-itself");
    let sound = folder.join("a.wav");
    std::fs::copy(hello(), &sound).unwrap();
    #[cfg(unix)]
    std::os::unix::fs::symlink("a.wav", folder.join("link.tsv")).unwrap();
    #[cfg(not(unix))]
    std::fs::hard_link(&sound, folder.join("link.tsv")).unwrap();
    let before = std::fs::read(&sound).unwrap();
    for words in [
        &["convert", "a.wav", "-o", "./a.wav", "--format", "csv"][..],
        &["features", "a.wav", "-o", "a.wav", "--format", "npy"],
        #[cfg(unix)]
        &["cues", "a.wav", "-o", "link.tsv"],
    ] {
        let error = refuse(&folder, words);
        assert!(error.contains("writing onto it would lose it"), "{error}");
        assert_eq!(std::fs::read(&sound).unwrap(), before, "{words:?}");
    }
    std::fs::create_dir(folder.join("d.tsv")).unwrap();
    let error = refuse(&folder, &["cues", "a.wav", "-o", "d.tsv"]);
    assert!(error.contains("d.tsv: there is a folder of this name"), "{error}");
}

/// A numbers file says how far the mouth is open in every frame, by the mouth that is drawn.
#[test]
fn conversions_say_how_far_the_mouth_is_open() {
    let folder = common::folder("convert-open");
    let csv = succeed(&folder, &["convert", &hello(), "-o", "-", "--format", "csv"]);
    let last = |line: &str| line.rsplit(',').next().unwrap().to_owned();
    let mut lines = csv.lines();
    assert_eq!(last(lines.next().unwrap()), "open");
    let open: Vec<f64> = lines.map(|line| last(line).parse().unwrap()).collect();
    let json = succeed(&folder, &["convert", &hello(), "-o", "-", "--format", "json"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let of_json: Vec<f64> = json["open"]
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_f64().unwrap())
        .collect();
    assert_eq!(of_json.len(), open.len());
    assert!(of_json.iter().zip(&open).all(|(a, b)| (a - b).abs() < 1e-6));
    assert!(open.iter().any(|o| *o > 0.6) && open.iter().all(|o| (0.0..=1.0).contains(o)));
    // The same as beside the weights of a rig.
    let rig = succeed(&folder, &["cues", &hello(), "--set", "arkit"]);
    let of_rig: Vec<f64> = rig
        .lines()
        .skip(1)
        .map(|line| last(line).parse().unwrap())
        .collect();
    assert!(of_rig.iter().zip(&open).all(|(a, b)| (a - b).abs() < 1e-3) && of_rig.len() == open.len());
}

/// Whoever kills the program leaves no ffmpeg behind: one that decodes finds nobody who reads, one that encodes nobody who writes.
#[cfg(target_os = "linux")]
#[test]
fn a_killed_program_leaves_no_ffmpeg() {
    use std::io::Write as _;
    use std::time::{Duration, Instant};
    let folder = common::folder("cues-killed");
    // The encoder is begun before the first picture, and would wait for the last.
    let mut running = Command::new(program())
        .current_dir(&folder)
        .args(["render", "-", "-o", "film.webm"])
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let children = |pid: u32| {
        let tasks = std::fs::read_dir(format!("/proc/{pid}/task")).unwrap();
        let of_task = |task: std::io::Result<std::fs::DirEntry>| {
            std::fs::read_to_string(task.unwrap().path().join("children")).unwrap_or_default()
        };
        let all: String = tasks.map(of_task).collect();
        all.split_whitespace().map(str::to_owned).collect::<Vec<_>>()
    };
    let mut stdin = running.stdin.take().unwrap();
    stdin.write_all(&std::fs::read(hello()).unwrap()).unwrap();
    drop(stdin);
    let begun = Instant::now();
    let found = loop {
        let found = children(running.id());
        if !found.is_empty() {
            break found;
        }
        let ended = running.try_wait().unwrap();
        assert!(ended.is_none(), "it ended without an ffmpeg: {ended:?}");
        assert!(begun.elapsed() < Duration::from_secs(120), "no ffmpeg was begun");
        std::thread::sleep(Duration::from_millis(5));
    };
    running.kill().unwrap();
    running.wait().unwrap();
    // One that has ended and that nobody has waited for is a zombie: it works no more.
    let works = |pid: &String| {
        let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
        stat.contains("(ffmpeg)") && !stat.contains("(ffmpeg) Z")
    };
    let killed = Instant::now();
    while found.iter().any(works) {
        assert!(killed.elapsed() < Duration::from_secs(30), "{found:?} goes on");
        std::thread::sleep(Duration::from_millis(20));
    }
}
