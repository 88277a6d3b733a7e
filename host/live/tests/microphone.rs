//! A microphone that is heard through the system's sound. ALSA plays it: its file plugin reads what this test writes into a pipe, at the
//! pace of life. The test runs itself a second time, because ALSA asks the environment where its settings are.
#![cfg(all(feature = "mic", target_os = "linux"))]

use std::io::Write as _;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

use lipstream::engine::Engine;
use lipstream::shipped;
use lipstream_live::clock::Clock;
use lipstream_live::driver::{Driver, Setup, Source};
use lipstream_live::event::Event;
use lipstream_live::feed::{Speech, SpeechError};
use lipstream_live::hub::Hub;
use nix::sys::stat::Mode;

fn speech() -> Vec<i16> {
    lipstream_media::sound::decode(shipped::SOUND).unwrap().samples
}

/// Runs one of the tests below with these settings of ALSA.
fn run(test: &str, settings: &Path) {
    let own = std::env::current_exe().unwrap();
    let done = Command::new(own)
        .args(["--exact", "--ignored", test])
        .env("ALSA_CONFIG_PATH", settings)
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&done.stdout);
    assert!(done.status.success() && text.contains("1 passed"), "{text}");
}

#[test]
fn a_microphone_is_heard() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe");
    nix::unistd::mkfifo(&pipe, Mode::S_IRWXU).unwrap();
    let settings = folder.path().join("asound.conf");
    let text = format!(
        r#"
        pcm.!default {{ type plug slave.pcm "speech" hint.description "a talking pipe" }}
        pcm.speech {{ type file slave.pcm {{ type null }} file "/dev/null" infile "{}" format "raw" }}
        ctl.!default {{ type null }}
        "#,
        pipe.display()
    );
    std::fs::write(&settings, text).unwrap();
    // Speech, then silence for as long as somebody listens.
    let feeder = std::thread::spawn(move || {
        let mut samples = speech();
        samples.resize(samples.len() + 320_000, 0);
        let mut to = std::fs::File::options().write(true).open(pipe).unwrap();
        let began = Instant::now();
        for (hop, samples) in (0..).zip(samples.chunks(160)) {
            let bytes: Vec<u8> = samples.iter().flat_map(|s| s.to_le_bytes()).collect();
            if to.write_all(&bytes).is_err() {
                return;
            }
            let due = began + Duration::from_millis(10) * hop;
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
        }
    });
    run("what_comes_from_the_microphone_is_what_was_said", &settings);
    feeder.join().unwrap();
}

#[test]
#[ignore = "run by a_microphone_is_heard, with its settings"]
fn what_comes_from_the_microphone_is_what_was_said() {
    let hub = Arc::new(Hub::default());
    let (_, mut watch) = hub.watch();
    let clock = Clock::start();
    let driver = Driver::start(Setup {
        source: Source::Inside(Arc::new(Engine::shipped())),
        speech: Some(Speech::Microphone(None)),
        repeat: false,
        profile: None,
        hub: Arc::clone(&hub),
        clock,
        mouths: Arc::default(),
    });
    let (mut heard, mut delays): (Vec<i16>, Vec<f64>) = Default::default();
    while heard.len() < 48_000 {
        match watch.wait().unwrap() {
            Event::Sound(piece) => {
                assert_eq!(piece.sample, heard.len() as u64);
                heard.extend(&piece.samples);
            }
            Event::Frame(frame) => delays.push(frame.arrived_ms - frame.heard_ms.unwrap()),
            Event::Notice(notice) => panic!("{}", notice.text),
            _ => {}
        }
    }
    drop(driver);
    assert_eq!(heard, speech()[..48_000], "bit for bit");
    assert!(delays.len() > 250);
    // The look-ahead of the profile, 72.5 ms, and the hop that it waits in.
    delays.sort_by(f64::total_cmp);
    let median = delays[delays.len() / 2];
    println!("{median:.1} ms from the microphone to the frame");
    assert!(median > 60.0 && median < 500.0, "{median}");
}

#[test]
fn a_computer_without_microphones_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let settings = folder.path().join("asound.conf");
    std::fs::write(&settings, "").unwrap();
    run("there_is_no_microphone", &settings);
}

#[test]
#[ignore = "run by a_computer_without_microphones_says_so, with its settings"]
fn there_is_no_microphone() {
    for name in [None, Some("any".to_owned())] {
        let error = Speech::Microphone(name).open().err().unwrap();
        let in_words = matches!(
            error,
            SpeechError::NoMicrophone | SpeechError::OtherMicrophones { .. } | SpeechError::Microphone { .. }
        );
        assert!(in_words, "{error}");
        assert!(error.to_string().contains("microphone"), "{error}");
    }
}
