//! The page of `cargo xtask site` in a real browser, opened as a file: a chosen sound gives the host's numbers, a microphone moves the mouth, and what
//! cannot be heard is said in words.
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use lipstream::engine::{Engine, RunSettings};
use lipstream::shipped;
use lipstream_core::wire::Profile;

use crate::chromium::Browser;

/// The page's address; it is built once.
fn site() -> &'static str {
    static SITE: OnceLock<String> = OnceLock::new();
    SITE.get_or_init(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("site");
        let written = lipstream_web::site::write(&folder, None).unwrap();
        println!("{written:?}");
        format!("file://{}", written.file.display())
    })
}

fn open(browser: &mut Browser) {
    browser.wait("window.lipstream.stats().ready");
}

/// Three seconds of the shipped speech at another rate, twice as loud on the left as on the right.
fn in_stereo(folder: &Path) -> PathBuf {
    let path = folder.join("stereo.wav");
    let about = hound::WavSpec {
        channels: 2,
        sample_rate: 44_100,
        bits_per_sample: 16,
        sample_format: hound::SampleFormat::Int,
    };
    let speech = lipstream_media::sound::decode(shipped::SOUND).unwrap().samples;
    let speech = &speech[..48_000];
    let mut file = hound::WavWriter::create(&path, about).unwrap();
    for k in 0..speech.len() * 441 / 160 {
        // Straight lines between samples are good enough for speech that nobody listens to.
        let (at, part) = (k * 160 / 441, (k * 160 % 441) as i32);
        let (a, b) = (
            i32::from(speech[at]),
            i32::from(*speech.get(at + 1).unwrap_or(&0)),
        );
        let sample = (a + (b - a) * part / 441) as i16;
        file.write_sample(sample).unwrap();
        file.write_sample(sample / 2).unwrap();
    }
    file.finalize().unwrap();
    path
}

/// Parameters and viseme weights of every frame that the page has converted.
fn said(browser: &mut Browser) -> (Vec<f32>, Vec<u8>) {
    let said = browser.evaluate("window.lipstream.frames()");
    let numbers = |name: &str| {
        let list = said[name].as_array().unwrap();
        list.iter().map(|v| v.as_f64().unwrap()).collect::<Vec<f64>>()
    };
    (
        numbers("parameters").iter().map(|v| *v as f32).collect(),
        numbers("visemes").iter().map(|v| *v as u8).collect(),
    )
}

#[test]
fn in_a_browser_without_a_server_a_chosen_file_gives_the_hosts_numbers() {
    let _alone = crate::alone();
    let folder = tempfile::tempdir().unwrap();
    let mut browser = Browser::open_plain(site());
    open(&mut browser);
    let hello = folder.path().join("hello.wav");
    std::fs::write(&hello, shipped::SOUND).unwrap();
    for file in [hello, in_stereo(folder.path())] {
        let samples = lipstream_media::sound::read(&file).unwrap().samples;
        let settings = RunSettings {
            profile: Some(Profile::Standard),
            ..RunSettings::default()
        };
        let want = Engine::shipped().convert(&samples, &settings).unwrap();
        browser.choose("file", &file);
        browser.wait(&format!(
            "window.lipstream.stats().frames === {}",
            want.parameters.nrows()
        ));
        let (parameters, visemes) = said(&mut browser);
        assert!(
            parameters == want.parameters.iter().copied().collect::<Vec<f32>>(),
            "{}",
            file.display()
        );
        let want: Vec<u8> = want.visemes.iter().map(|w| (w * 255.0).round() as u8).collect();
        assert!(visemes == want, "{}", file.display());
        // It is drawn while it is heard.
        browser.wait("window.lipstream.stats().base > 20");
        browser.photograph(&crate::artefacts().join("site.png"));
    }

    // What is no sound is said, and the page goes on.
    let notes = folder.path().join("notes.txt");
    std::fs::write(&notes, "not a sound").unwrap();
    browser.choose("file", &notes);
    browser.wait("!document.getElementById('banner').hidden");
    let words = browser.evaluate("document.getElementById('banner').textContent");
    assert!(
        words
            .as_str()
            .unwrap()
            .starts_with("notes.txt cannot be read: not a sound file"),
        "{words}"
    );
    browser.evaluate("document.getElementById('example').click()");
    browser.wait("window.lipstream.stats().base > 20 && document.getElementById('banner').hidden");
    crate::no_complaints(&browser);
}

#[test]
fn in_a_browser_without_a_server_a_microphone_moves_the_mouth() {
    let _alone = crate::alone();
    let folder = tempfile::tempdir().unwrap();
    let hello = folder.path().join("hello.wav");
    std::fs::write(&hello, shipped::SOUND).unwrap();
    let mut browser = Browser::open_hearing(site(), &hello);
    open(&mut browser);
    browser.evaluate("document.getElementById('microphone').click()");
    browser.wait("window.lipstream.stats().frames > 500");
    browser.photograph(&crate::artefacts().join("site-microphone.png"));
    let rate = browser.number("window.lipstream.stats().rate");
    assert!(rate > 16_000.0, "nothing is resampled at {rate} Hz");
    // The sound is the same speech over and over: most of it is no rest, and its closures are there.
    let (parameters, visemes) = said(&mut browser);
    let frames: Vec<&[u8]> = visemes.chunks(13).collect();
    let share = |v: usize| frames.iter().filter(|frame| frame[v] > 127).count() as f64 / frames.len() as f64;
    let (rest, closed) = (share(0), share(9));
    println!(
        "{} frames from {rate} Hz, at rest {rest:.2}, lips closed {closed:.2}",
        frames.len()
    );
    assert!(
        rest < 0.6 && (0.02..0.3).contains(&closed),
        "rest {rest}, closed {closed}"
    );
    let size = parameters.len() / frames.len();
    let first: Vec<f32> = parameters.chunks(size).map(|frame| frame[1]).collect();
    let range = first.iter().fold(f32::MIN, |a, b| a.max(*b)) - first.iter().fold(f32::MAX, |a, b| a.min(*b));
    let deviation = crate::space().deviation[1];
    assert!(
        range > 2.0 * deviation,
        "the mouth moves by {range}, of deviation {deviation}"
    );

    browser.evaluate("document.getElementById('stop').click()");
    browser.wait("document.getElementById('stop').disabled");
    let frames = browser.number("window.lipstream.stats().frames");
    std::thread::sleep(std::time::Duration::from_millis(300));
    assert_eq!(
        browser.number("window.lipstream.stats().frames"),
        frames,
        "it still listens"
    );
    crate::no_complaints(&browser);
}

#[test]
fn in_a_browser_without_a_server_a_refused_microphone_is_said() {
    let _alone = crate::alone();
    // There is one, and the browser does not give it.
    let mut browser = Browser::open_deaf(site());
    open(&mut browser);
    browser.evaluate("document.getElementById('microphone').click()");
    browser.wait("!document.getElementById('banner').hidden");
    let words = browser.evaluate("document.getElementById('banner').textContent");
    assert!(
        words.as_str().unwrap().starts_with("The microphone was refused."),
        "{words}"
    );
    assert_eq!(browser.evaluate("document.getElementById('stop').disabled"), true);
    crate::no_complaints(&browser);
}
