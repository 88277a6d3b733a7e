use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use lipstream::random::normal_f64;
use rand::SeedableRng as _;
use rand_pcg::Pcg64;

use super::statistics::{Opinions, holm};
use super::*;

/// A folder of clips: what a clip's file holds besides its kind does not matter here.
fn folder(systems: &[&str], clips: &[&str]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for system in systems {
        for clip in clips {
            let path = folder.path().join(system).join(format!("{clip}.mp4"));
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, format!("\0\0\0\x10ftypisom {system} {clip}")).unwrap();
        }
    }
    folder
}

fn refused(folder: &Path) -> String {
    make(folder, "A test").err().expect("refused").to_string()
}

/// Answers to every clip of a key and to its checks.
fn answers(key: &Key, score: impl Fn(&Shown) -> [u8; CRITERIA]) -> Vec<Answer> {
    let answer = |code: &String, check: Option<u8>, scores| Answer {
        code: code.clone(),
        check,
        scores,
        plays: 1,
        seconds: 20.0,
    };
    let first = key.clips.keys().next().unwrap();
    let checks = [2, 4].map(|asked| answer(first, Some(asked), [asked; CRITERIA]));
    let judged = key
        .clips
        .iter()
        .map(|(code, shown)| answer(code, None, score(shown)));
    judged.chain(checks).collect()
}

#[test]
fn a_page_names_no_system_and_its_key_names_all() {
    let systems = ["ph-hmm", "ph-vi-chmm", "recording"];
    let folder = folder(&systems, &["one", "two"]);
    let Made { html, key } = make(folder.path(), "Mouths & <tests>").unwrap();
    assert!(html.contains("<h1 id=\"heading\" tabindex=\"-1\">Mouths &amp; &lt;tests&gt;</h1>"));
    for system in ["ph-hmm", "ph-vi-chmm", "\"one\"", "\"two\""] {
        assert!(!html.contains(system), "{system} is on the page");
    }
    assert!(!html.contains("{{"));
    assert_eq!(key.systems, systems);
    let shown: BTreeSet<_> = key.clips.values().cloned().collect();
    assert_eq!((shown.len(), key.clips.len()), (6, 6));
    // Every clip is there under its code, whole.
    let data = html
        .split_once("application/json\">")
        .unwrap()
        .1
        .split_once("</script>")
        .unwrap()
        .0;
    let data: serde_json::Value = serde_json::from_str(data).unwrap();
    let clips = data["clips"].as_array().unwrap();
    assert_eq!(clips.len(), 6);
    for clip in clips {
        use base64::Engine as _;
        let film = base64::engine::general_purpose::STANDARD
            .decode(clip["film"].as_str().unwrap())
            .unwrap();
        let Shown { system, clip } = &key.clips[clip["code"].as_str().unwrap()];
        assert!(
            String::from_utf8(film)
                .unwrap()
                .ends_with(&format!("{system} {clip}"))
        );
    }
    // The same folder makes the same page, another one another test.
    let again = make(folder.path(), "Mouths & <tests>").unwrap();
    assert!(again.html == html && again.key == key);
    std::fs::write(
        folder.path().join("recording/one.mp4"),
        b"\0\0\0\x10ftypisom other",
    )
    .unwrap();
    assert_ne!(make(folder.path(), "").unwrap().key.test, key.test);
}

#[test]
fn folders_that_make_no_test_are_refused_in_words() {
    let clips = ["one", "two"];
    let one = folder(&["recording"], &clips);
    assert!(refused(one.path()).contains("two systems at least"));
    let good = folder(&["a", "recording"], &clips);
    let a = good.path().join("a");
    std::fs::remove_file(a.join("two.mp4")).unwrap();
    assert!(refused(good.path()).contains("a has no two.mp4"));
    std::fs::write(a.join("two.mp4"), b"RIFF....WAVE").unwrap();
    assert!(refused(good.path()).contains("two.mp4 is no MP4 file"));
    std::fs::write(a.join("notes.txt"), b"").unwrap();
    assert!(refused(good.path()).contains("notes.txt is no .mp4 file"));
    std::fs::remove_file(a.join("notes.txt")).unwrap();
    // A file with a hole takes no room on the disk.
    std::fs::File::create(a.join("two.mp4"))
        .unwrap()
        .set_len(MAX_BYTES + 1)
        .unwrap();
    assert!(refused(good.path()).contains("more than the 64 MiB"));
    std::fs::write(good.path().join("readme"), b"").unwrap();
    assert!(refused(good.path()).contains("readme is no folder"));
    assert!(refused(&good.path().join("missing")).contains("cannot read"));
}

/// A key with so many clips, as read back from its file.
fn key(systems: &[&str], clips: usize) -> Key {
    let names: Vec<String> = (0..clips).map(|c| format!("clip{c:02}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let folder = folder(systems, &names);
    let made = make(folder.path(), "Speaker dependent").unwrap().key;
    let path = folder.path().join("page.key.json");
    std::fs::write(&path, serde_json::to_string(&made).unwrap()).unwrap();
    let read = Key::read(&path).unwrap();
    assert_eq!(read, made);
    read
}

/// The lines of a table in cells, the heads left out.
fn rows(report: &str, head: &str) -> Vec<Vec<String>> {
    let table = report.lines().skip_while(|line| !line.starts_with(head)).skip(2);
    table
        .take_while(|line| line.starts_with('|'))
        .map(|line| {
            line.trim_matches('|')
                .split('|')
                .map(|cell| cell.trim().to_owned())
                .collect()
        })
        .collect()
}

#[test]
fn tables_are_those_of_the_paper() {
    let key = key(&["ph-chmm", "ph-hmm", "recording"], 3);
    // Every viewer and clip alike: no doubt about any number.
    let scores = |shown: &Shown| match shown.system.as_str() {
        "ph-hmm" => [3, 2, 3, 3, 3],
        "ph-chmm" => [4, 3, 3, 4, 4],
        _ => [5, 5, 4, 5, 5],
    };
    let viewer = |name: &str| Results::new(&key.test, name, 1, answers(&key, scores));
    let results = [
        ("a.json".to_owned(), viewer("a")),
        ("b.json".to_owned(), viewer("b")),
    ];
    let settings = Settings {
        against: Some("ph-hmm".into()),
        ..Settings::default()
    };
    let report = tables(std::slice::from_ref(&key), &results, &settings).unwrap();
    assert!(
        report.contains("## Speaker dependent\n\n2 viewers of 3 clips"),
        "{report}"
    );
    let table = rows(&report, "| system |");
    let want = [
        [
            "ph-hmm",
            "3.00 [3.00, 3.00]",
            "2.00 [2.00, 2.00]",
            "3.00 [3.00, 3.00]",
            "3.00 [3.00, 3.00]",
            "3.00 [3.00, 3.00]",
            "—",
        ],
        [
            "ph-chmm",
            "4.00 [4.00, 4.00]",
            "3.00 [3.00, 3.00]",
            "3.00 [3.00, 3.00]",
            "4.00 [4.00, 4.00]",
            "4.00 [4.00, 4.00]",
            "33.33 [33.33, 33.33]",
        ],
        [
            "recording",
            "5.00 [5.00, 5.00]",
            "5.00 [5.00, 5.00]",
            "4.00 [4.00, 4.00]",
            "5.00 [5.00, 5.00]",
            "5.00 [5.00, 5.00]",
            "66.67 [66.67, 66.67]",
        ],
    ];
    assert_eq!(table, want);
    let ranked: Vec<_> = rows(&report, "| place |")
        .into_iter()
        .map(|row| row[1].clone())
        .collect();
    assert_eq!(ranked, ["recording", "ph-chmm", "ph-hmm"]);
    assert_eq!(rows(&report, "| better |").len(), 3);
    // Without a word of ours, the first by name is measured against.
    let plain = tables(&[key], &results, &Settings::default()).unwrap();
    assert_eq!(rows(&plain, "| system |")[0][0], "ph-chmm");
}

#[test]
fn who_did_not_read_is_left_out_by_name() {
    let key = key(&["a", "recording"], 2);
    let good = Results::new(&key.test, "0a", 1, answers(&key, |_| [4; CRITERIA]));
    let mut careless = Results::new(&key.test, "0b", 1, answers(&key, |_| [1; CRITERIA]));
    careless.answers.last_mut().unwrap().scores[3] = 5;
    assert!(good.attentive() && !careless.attentive());
    let results = [("x.json".to_owned(), good), ("y.json".to_owned(), careless)];
    let report = tables(std::slice::from_ref(&key), &results, &Settings::default()).unwrap();
    assert!(
        report.contains("Left out, because a check of attention failed: y.json (viewer 0b)."),
        "{report}"
    );
    assert!(report.contains("1 viewer of 2 clips"), "{report}");
    assert_eq!(rows(&report, "| system |")[0][1], "4.00 [4.00, 4.00]");
    let error = tables(&[key], &results[1..], &Settings::default()).unwrap_err();
    assert!(error.to_string().contains("no viewer who passed"), "{error}");
}

#[test]
fn damaged_foreign_and_doubled_answers_are_refused() {
    let key = key(&["a", "recording"], 2);
    let good = || Results::new(&key.test, "0a", 1, answers(&key, |_| [4; CRITERIA]));
    let said = |results: &[Results]| {
        let named: Vec<_> = (0..)
            .zip(results)
            .map(|(k, r): (u32, _)| (format!("{k}.json"), r.clone()))
            .collect();
        let done = tables(std::slice::from_ref(&key), &named, &Settings::default());
        done.expect_err("refused").to_string()
    };
    assert!(said(&[good(), good()]).contains("1.json is of the same viewer as 0.json"));
    let mut other = good();
    other.test = "feed".into();
    assert!(said(&[other]).contains("0.json is of test feed, of which no key is given"));
    let mut unknown = good();
    unknown.answers[0].code = "nobody".into();
    assert!(said(&[unknown]).contains("\"nobody\""));
    let mut short = good();
    short.answers.remove(0);
    assert!(said(&[short]).contains("3 of 4 clips"));
    let mut twice = good();
    twice.answers.push(twice.answers[0].clone());
    assert!(said(&[twice]).contains("twice"));
    let mut six = good();
    six.answers[1].scores[0] = 6;
    assert!(said(&[six]).contains("score of 6"));
    let mut unchecked = good();
    unchecked.answers.pop();
    assert!(said(&[unchecked]).contains("1 checks of attention"));
    let error = tables(&[key.clone(), key.clone()], &[], &Settings::default()).unwrap_err();
    assert!(error.to_string().contains("same test"));
    let against = Settings {
        against: Some("nobody".into()),
        ..Settings::default()
    };
    let error = tables(std::slice::from_ref(&key), &[("0.json".into(), good())], &against).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("has no system nobody: it has a, recording"),
        "{error}"
    );
}

#[test]
fn files_that_are_none_of_ours_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = |text: &str| -> PathBuf {
        let path = folder.path().join("file.json");
        std::fs::write(&path, text).unwrap();
        path
    };
    let key = serde_json::to_string(&key(&["a", "b"], 1)).unwrap();
    assert!(Results::read(&file(&key)).is_err());
    assert!(
        Key::read(&file(&key.replace("\"version\":1", "\"version\":9")))
            .unwrap_err()
            .to_string()
            .contains("version 9")
    );
    assert!(
        Key::read(&file(&key.replace("\"system\":\"b\"", "\"system\":\"c\"")))
            .unwrap_err()
            .to_string()
            .contains("damaged")
    );
    for text in ["", "{}", "[1, 2]", &key[..key.len() / 2]] {
        let error = Key::read(&file(text)).unwrap_err().to_string();
        assert!(
            error.contains("file.json is no key of a page, or damaged"),
            "{error}"
        );
        assert!(Results::read(&file(text)).is_err());
    }
}

/// Viewers who are strict or kind, clips that are easy or hard, and chance, cut to whole scores.
struct Crowd {
    rng: Pcg64,
    /// What a system is worth overall.
    truths: Vec<f64>,
}

impl Crowd {
    /// What viewers think of clips of all systems.
    fn scores(
        &mut self,
        viewers: usize,
        clips: usize,
    ) -> impl Fn(usize, usize, usize) -> [u8; CRITERIA] + use<> {
        let mut deviates = |n: usize, deviation: f64| -> Vec<f64> {
            (0..n).map(|_| deviation * normal_f64(&mut self.rng)).collect()
        };
        let (kind, easy) = (deviates(viewers, 0.5), deviates(clips, 0.4));
        let chance = deviates(viewers * clips * self.truths.len(), 0.7);
        let truths = self.truths.clone();
        move |v, c, s| {
            let chance = chance[(v * clips + c) * truths.len() + s];
            let score = truths[s] + kind[v] + easy[c] + chance;
            [score.round().clamp(1.0, 5.0) as u8; CRITERIA]
        }
    }

    fn opinions(&mut self, viewers: usize, clips: usize) -> Opinions {
        let scores = self.scores(viewers, clips);
        Opinions::new((viewers, clips, self.truths.len()), scores)
    }

    /// What all people would think of all clips, whole scores and all.
    fn truth(&mut self) -> Vec<f64> {
        let all = self.opinions(600, 600).resampled(0, 0);
        (0..self.truths.len()).map(|s| all.mean(s, 0).value).collect()
    }
}

#[test]
fn intervals_hold_the_truth_and_equal_systems_are_found_equal() {
    let mut crowd = Crowd {
        rng: Pcg64::seed_from_u64(11),
        truths: vec![2.6, 3.1, 3.1],
    };
    let truth = crowd.truth();
    let (mut held, mut wrong, mut found, trials) = (0, 0, 0, 100);
    for trial in 0..trials {
        let resampled = crowd.opinions(12, 10).resampled(300, trial);
        for (s, truth) in truth.iter().enumerate() {
            let mean = resampled.mean(s, 0);
            held += usize::from(mean.low <= *truth && *truth <= mean.high);
        }
        wrong += usize::from(resampled.difference(2, 1, 0).p <= 0.05);
        found += usize::from(resampled.difference(1, 0, 0).p <= 0.05);
    }
    println!(
        "held {held} of {}, false alarms {wrong}, found {found} of {trials}",
        3 * trials
    );
    assert!(held >= 270, "{held} of {}", 3 * trials);
    assert!(wrong <= 8, "{wrong} of {trials}");
    assert!(found >= 85, "{found} of {trials}");
}

/// From viewers' files to the numbers in the report.
#[test]
fn the_tables_of_a_crowd_hold_the_truth() {
    let systems = ["a", "b", "recording"];
    let key = key(&systems, 10);
    let mut crowd = Crowd {
        rng: Pcg64::seed_from_u64(5),
        truths: vec![2.2, 3.2, 4.2],
    };
    let truth = crowd.truth();
    let scores = crowd.scores(12, 10);
    let results: Vec<_> = (0..12)
        .map(|viewer| {
            let answers = answers(&key, |shown| {
                let clip = shown.clip.trim_start_matches("clip").parse().unwrap();
                let system = systems.iter().position(|name| *name == shown.system).unwrap();
                scores(viewer, clip, system)
            });
            let name = format!("{viewer}.json");
            let results = Results::new(&key.test, &name, viewer as u32, answers);
            (name, results)
        })
        .collect();
    let report = tables(&[key], &results, &Settings::default()).unwrap();
    for (row, truth) in rows(&report, "| system |").iter().zip(&truth) {
        for cell in &row[1..=CRITERIA] {
            let numbers = cell.replace(['[', ']', ','], "");
            let numbers: Vec<f64> = numbers.split(' ').map(|n| n.parse().unwrap()).collect();
            assert!(numbers[1] <= *truth && *truth <= numbers[2], "{cell}: {truth}");
            assert!(numbers[2] - numbers[1] < 1.2, "{cell}");
        }
    }
    // A point apart: nobody doubts it.
    let ranking = rows(&report, "| place |");
    let ranked: Vec<_> = ranking
        .iter()
        .map(|row| (row[1].as_str(), row[3].as_str()))
        .collect();
    assert_eq!(ranked, [("recording", "—"), ("b", "—"), ("a", "—")]);
}

#[test]
fn corrected_for_their_number() {
    let corrected = holm(&[0.01, 0.04, 0.03, 0.5]);
    for (have, want) in corrected.iter().zip([0.04, 0.09, 0.09, 0.5]) {
        assert!((have - want).abs() < 1e-12, "{corrected:?}");
    }
    assert!(holm(&[]).is_empty());
}
