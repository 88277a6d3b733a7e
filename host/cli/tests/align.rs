//! Forced alignment end to end on made-up speech: a corpus with labels is prepared, an audio HMM trained, and sounds whose
//! words are known are aligned; borders are known exactly because the sounds were made here.
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use lipstream_cli as cli;
use lipstream_make::align::{Aligner, AudioHmm, train};
use lipstream_make::corpus::{self, labels};
use lipstream_make::features::FeatureFolder;
use lipstream_media::sound;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const WORDS: [(&str, [&str; 2]); 3] = [("see", ["s", "iy"]), ("moo", ["m", "uw"]), ("me", ["m", "iy"])];

/// Samples of one phone: noise, or a buzz whose partials stand around the phone's formants.
fn sound(phone: &str, samples: usize, rng: &mut Pcg64) -> Vec<i16> {
    let (formants, noise): (&[f32], f32) = match phone {
        "s" => (&[], 1500.0),
        "iy" => (&[300.0, 2300.0, 3000.0], 30.0),
        "uw" => (&[350.0, 800.0], 30.0),
        "m" => (&[250.0], 30.0),
        _ => (&[], 12.0),
    };
    (0..samples)
        .map(|n| {
            let t = n as f32 / 16_000.0;
            let tone: f32 = (1..30)
                .map(|h| 120.0 * h as f32)
                .map(|hz| {
                    let gain: f32 = formants.iter().map(|f| (-((hz - f) / 150.0).powi(2)).exp()).sum();
                    gain * (std::f32::consts::TAU * hz * t).sin()
                })
                .sum();
            (2000.0 * tone + noise * rng.random_range(-1.0f32..1.0)) as i16
        })
        .collect()
}

/// A sentence: its words, its samples, and where (in samples) each phone begins; silence at both ends.
fn sentence(rng: &mut Pcg64) -> (Vec<&'static str>, Vec<i16>, Vec<(usize, &'static str)>) {
    let said: Vec<usize> = (0..5).map(|_| rng.random_range(0..WORDS.len())).collect();
    let mut samples = Vec::new();
    let mut begins = Vec::new();
    let mut say = |phone: &'static str, ms: usize, rng: &mut Pcg64| {
        begins.push((samples.len(), phone));
        samples.extend(sound(phone, 16 * ms, rng));
    };
    say("sil", 300, rng);
    for &word in &said {
        for phone in WORDS[word].1 {
            let ms = rng.random_range(80..200);
            say(phone, ms, rng);
        }
    }
    say("sil", 300, rng);
    (said.iter().map(|&w| WORDS[w].0).collect(), samples, begins)
}

fn phn(begins: &[(usize, &str)], end: usize) -> String {
    let mut out = String::new();
    for (i, (from, phone)) in begins.iter().enumerate() {
        let to = begins.get(i + 1).map_or(end, |next| next.0);
        let phone = if *phone == "sil" { "h#" } else { phone };
        out += &format!("{from} {to} {phone}\n");
    }
    out
}

/// A corpus of 16 labelled sentences, prepared.
fn features(root: &Path) -> FeatureFolder {
    let mut rng = Pcg64::seed_from_u64(4);
    let corpus = root.join("corpus/talker");
    std::fs::create_dir_all(&corpus).unwrap();
    for n in 0..16 {
        let (words, samples, begins) = sentence(&mut rng);
        let path = |e: &str| corpus.join(format!("u{n:02}.{e}"));
        sound::write(&path("wav"), &samples).unwrap();
        std::fs::write(path("txt"), words.join(" ")).unwrap();
        std::fs::write(path("phn"), phn(&begins, samples.len())).unwrap();
    }
    let settings = corpus::PrepareSettings {
        corpus: root.join("corpus"),
        out: root.join("features"),
        clips: corpus::discover::Options {
            all_train: true,
            ..Default::default()
        },
        ..Default::default()
    };
    corpus::prepare(&settings, &()).unwrap();
    FeatureFolder::open(&settings.out).unwrap()
}

fn run(args: &[&str]) -> anyhow::Result<()> {
    cli::run(["lipstream"].iter().chain(args).map(OsString::from))
}

fn text(path: &Path) -> String {
    path.display().to_string()
}

/// The sound on standard input and the alignment on standard output, by the program itself.
fn piped_as_well_as_from_a_file(root: &Path, model: &Path) {
    let (words, samples, _) = sentence(&mut Pcg64::seed_from_u64(6));
    let (wav, transcript) = (root.join("piped.wav"), root.join("piped.txt"));
    sound::write(&wav, &samples).unwrap();
    std::fs::write(&transcript, words.join(" ")).unwrap();
    let align = |sound: &str, out: &str| {
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_lipstream"))
            .args(["align", sound, "-m"])
            .arg(model)
            .arg("--transcript")
            .arg(&transcript)
            .args(["--format", "json", "-o", out])
            .stdin(std::fs::File::open(&wav).unwrap())
            .output()
            .unwrap();
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        output.stdout
    };
    let file = root.join("piped.json");
    align(&text(&wav), &text(&file));
    let piped = align("-", "-");
    assert!(!piped.is_empty() && piped == std::fs::read(file).unwrap());
}

#[test]
fn borders_are_found_where_they_were_made() {
    let scratch = tempfile::tempdir().unwrap();
    let root = scratch.path();
    let folder = features(root);
    let settings = train::AudioHmmSettings {
        mixtures: 2,
        ..Default::default()
    };
    let hmm = train::train(&folder, &settings, None, &()).unwrap();
    let model = root.join("audio.safetensors");
    hmm.write(&model).unwrap();
    assert_eq!(AudioHmm::read(&model).unwrap(), hmm);
    // Twice the same, on one thread too.
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let again = one_thread.install(|| train::train(&folder, &settings, Some(&folder.root), &()).unwrap());
    assert_eq!(again, hmm);

    piped_as_well_as_from_a_file(root, &model);

    // Sentences that were not trained on, through the program, in every format.
    let mut rng = Pcg64::seed_from_u64(5);
    let mut worst: Vec<f64> = Vec::new();
    for (n, extension) in ["lab", "TextGrid", "phn", "TextGrid"].into_iter().enumerate() {
        let (words, samples, begins) = sentence(&mut rng);
        let wav = root.join(format!("test{n}.wav"));
        sound::write(&wav, &samples).unwrap();
        let transcript = root.join("text.txt");
        std::fs::write(&transcript, words.join(" ")).unwrap();
        let out = root.join(format!("out{n}.{extension}"));
        run(&[
            "align",
            &text(&wav),
            "-m",
            &text(&model),
            "--transcript",
            &text(&transcript),
            "-o",
            &text(&out),
        ])
        .unwrap();
        let seconds = samples.len() as f64 / 16_000.0;
        let mut files: Vec<PathBuf> = vec![out.clone()];
        if extension == "phn" {
            files.push(out.with_extension("wrd"));
        }
        let found = labels::read(&files, seconds).unwrap();
        let found_words: Vec<&str> = found.words.iter().map(|w| w.text.as_str()).collect();
        assert_eq!(found_words, words);
        let said = |p: &&(usize, &str)| p.1 != "sil";
        let want: Vec<_> = begins.iter().filter(said).collect();
        let got: Vec<_> = found
            .phones
            .iter()
            .filter(|p| !["sil", "sp"].contains(&p.2.name()))
            .collect();
        assert_eq!(got.len(), want.len());
        for (got, want) in got.iter().zip(&want) {
            assert_eq!(got.2.name(), want.1);
            worst.push((got.0 - want.0 as f64 / 16_000.0).abs());
        }
        for (word, pair) in found.words.iter().zip(want.chunks(2)) {
            let (start, _) = word.time.unwrap();
            worst.push((start - pair[0].0 as f64 / 16_000.0).abs());
        }
    }
    worst.sort_by(f64::total_cmp);
    let (median, worst) = (worst[worst.len() / 2], worst[worst.len() - 1]);
    assert!(median < 0.01 && worst < 0.04, "median {median}, worst {worst}");
}

#[test]
fn what_cannot_be_aligned_is_said() {
    let scratch = tempfile::tempdir().unwrap();
    let root = scratch.path();
    let folder = features(root);
    let settings = train::AudioHmmSettings {
        mixtures: 1,
        iterations: 1,
        ..Default::default()
    };
    let hmm = train::train(&folder, &settings, None, &()).unwrap();
    let model = root.join("audio.safetensors");
    hmm.write(&model).unwrap();
    let (words, samples, _) = sentence(&mut Pcg64::seed_from_u64(6));
    let wav = root.join("a.wav");
    sound::write(&wav, &samples).unwrap();
    let (wav, model, out) = (text(&wav), text(&model), text(&root.join("out.lab")));
    let aligned = |transcript: &str| {
        std::fs::write(root.join("t.txt"), transcript).unwrap();
        let t = text(&root.join("t.txt"));
        run(&["align", &wav, "-m", &model, "-t", &t, "-o", &out])
    };
    let says = |error: anyhow::Error, part: &str| {
        let line = format!("{error:#}");
        assert!(line.contains(part) && !line.contains('\n'), "{line}");
    };
    says(
        run(&["align", &wav, "-m", &model, "-o", &out]).unwrap_err(),
        "--transcript",
    );
    says(aligned("").unwrap_err(), "no words");
    says(aligned("dog").unwrap_err(), "\"dog\"");
    says(
        aligned(&words.join(" ").repeat(9)).unwrap_err(),
        "too short for this text",
    );
    says(aligned("?!").unwrap_err(), "no words");
    let missing = text(&root.join("missing.wav"));
    says(
        run(&["align", &missing, "-m", &model, "-t", &wav, "-o", &out]).unwrap_err(),
        "missing.wav",
    );
    says(
        run(&["align", &wav, "-m", &wav, "-o", &out]).unwrap_err(),
        "a.wav",
    );
    assert!(!Path::new(&out).exists());

    // A whole corpus: clips that fail are counted, the others are written.
    let corpus = root.join("corpus");
    std::fs::write(corpus.join("talker/u03.txt"), "see ".repeat(99)).unwrap();
    let many = root.join("many");
    let (corpus, folder) = (text(&corpus), text(&many));
    let error = run(&["align", &corpus, "-m", &model, "-o", &folder, "--format", "json"]).unwrap_err();
    says(error, "1 of 16 clips");
    assert_eq!(std::fs::read_dir(&many).unwrap().count(), 15);
    says(
        run(&["align", &corpus, "-m", &model, "-o", &out]).unwrap_err(),
        "give a folder",
    );

    let mut damaged = std::fs::read(&model).unwrap();
    damaged.truncate(damaged.len() / 2);
    let broken = root.join("broken.safetensors");
    std::fs::write(&broken, damaged).unwrap();
    assert!(AudioHmm::read(&broken).is_err());
    let silence = vec![0i16; 16_000];
    let aligner = Aligner::new(hmm);
    let spoken = folder_words(&words);
    let quiet = aligner.words(&silence, &spoken).unwrap();
    assert!(quiet.phones.windows(2).all(|p| p[0].end <= p[1].start + 1e-9));
}

/// Phones without a text: a model of the language's five phones hears most of what was made, and the score says how much.
#[test]
fn phones_are_recognised_without_a_text() {
    let scratch = tempfile::tempdir().unwrap();
    let root = scratch.path();
    let folder = features(root);
    let settings = train::AudioHmmSettings {
        mixtures: 1,
        ..Default::default()
    };
    let model = root.join("audio.safetensors");
    train::train(&folder, &settings, None, &())
        .unwrap()
        .write(&model)
        .unwrap();
    let (_, samples, begins) = sentence(&mut Pcg64::seed_from_u64(5));
    let wav = root.join("new.wav");
    sound::write(&wav, &samples).unwrap();
    let mut table = String::from("clip start end phone\n");
    for (n, (from, phone)) in begins.iter().enumerate() {
        let to = begins.get(n + 1).map_or(samples.len(), |next| next.0);
        table += &format!("new {from} {to} {phone}\n");
    }
    let labels = root.join("labels.tsv");
    std::fs::write(&labels, table).unwrap();
    let lipstream = |args: &[&str]| {
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_lipstream"))
            .args(["align", &text(&wav), "--recognise"])
            .args(args)
            .output()
            .unwrap();
        (
            output.status.success(),
            output.stdout,
            String::from_utf8_lossy(&output.stderr).into_owned(),
        )
    };
    let (model, out) = (text(&model), text(&root.join("new.phn")));
    let (ok, stdout, said) = lipstream(&[
        "-m",
        &model,
        "-o",
        &out,
        "--score",
        "--against",
        &text(&labels),
        "--json",
    ]);
    assert!(ok && said.contains("recognised 1 clips"), "{said}");
    let scores: serde_json::Value = serde_json::from_slice(&stdout).unwrap();
    let recognised = &scores["recognised"];
    assert_eq!(recognised["phones"], 10);
    assert!(recognised["error_rate"].as_f64().unwrap() <= 0.2, "{recognised}");
    assert!(recognised["all"]["phone"].as_f64().unwrap() > 0.8, "{recognised}");
    assert!(scores["aligned"].is_null() && scores["words"].is_null());
    let found = labels::read(&[&out], samples.len() as f64 / 16_000.0).unwrap();
    assert!(found.words.is_empty() && found.phones.len() >= 8);
    // The shipped model is there for who has none; and labels must be those of the clip.
    assert!(lipstream(&["-o", &out]).0);
    std::fs::write(&labels, "other 0 1600 sil\n").unwrap();
    let (ok, _, said) = lipstream(&["-m", &model, "--score", "--against", &text(&labels)]);
    assert!(!ok && said.contains("nothing to compare with"), "{said}");
}

fn folder_words(words: &[&str]) -> Vec<lipstream_make::features::Word> {
    words
        .iter()
        .map(|text| {
            let (_, phones) = WORDS.iter().find(|w| w.0 == *text).unwrap();
            lipstream_make::features::Word {
                text: (*text).to_owned(),
                pronunciations: vec![phones.iter().map(|p| (*p).to_owned()).collect()],
                time: None,
            }
        })
        .collect()
}
