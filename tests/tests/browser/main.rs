//! The page of `lipstream view` in a real browser, against the firmware in QEMU, a recording and the model in this process; and those of `lipstream mos` and `lipstream landmarks`.
#[path = "../common/mod.rs"]
#[allow(dead_code, reason = "the tests of the firmware use more of it")]
mod common;

#[allow(dead_code, reason = "the benchmark uses more of it")]
mod chromium;
mod film;
#[path = "../../../host/cli/tests/common/heads.rs"]
#[allow(dead_code, reason = "the tests of the program use more of it")]
mod heads;
mod landmarks;
mod mos;
mod site;

use std::net::{IpAddr, Ipv4Addr};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use chromium::Browser;
use lipstream::engine::Engine;
use lipstream::mouth::MouthSpace;
use lipstream::render::face::{FaceSettings, LiveFace, Whose, person};
use lipstream::shipped;
use lipstream::tensors::Tensors;
use lipstream_core::wire::Profile;
use lipstream_live::address::Address;
use lipstream_live::clock::Clock;
use lipstream_live::desk::{Desk, Equipment, Mouth, Tape};
use lipstream_live::driver::{Driver, Setup, Source};
use lipstream_live::face::Face;
use lipstream_live::feed::Speech;
use lipstream_live::hub::Hub;
use lipstream_live::recording::Recorder;
use lipstream_live::serve::{Place, Server};

/// Only one browser at a time: each draws with the processor.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Where pictures of the page are kept.
fn artefacts() -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join("browser")
}

fn space() -> MouthSpace {
    MouthSpace::load(&Tensors::parse(shipped::MODEL, "the shipped model").unwrap()).unwrap()
}

/// A desk with or without the shipped mouth, and its page.
fn desk(folder: &Path, with_mouth: bool) -> (Arc<Desk>, Server) {
    desk_with(folder, with_mouth, |_| None)
}

/// A desk with or without the shipped mouth and with a face, and its page.
fn desk_with(
    folder: &Path,
    with_mouth: bool,
    face: impl FnOnce(&Arc<Hub>) -> Option<Face>,
) -> (Arc<Desk>, Server) {
    let engine = Arc::new(Engine::shipped());
    let id = engine.model_id().unwrap();
    let mouths = match with_mouth {
        true => vec![Mouth::new(id, &space())],
        false => Vec::new(),
    };
    let hub = Arc::new(Hub::default());
    let equipment = Equipment {
        clock: Clock::start(),
        mouths: mouths.into(),
        folder: folder.to_owned(),
        engine,
        face: face(&hub),
    };
    let desk = Arc::new(Desk::new(hub, equipment));
    let place = Place {
        address: IpAddr::V4(Ipv4Addr::LOCALHOST),
        port: 0,
    };
    let server = Server::start(Arc::clone(&desk), &place).unwrap();
    (desk, server)
}

fn setup(desk: &Desk, source: Source, speech: Option<PathBuf>) -> Setup {
    Setup {
        source,
        speech: speech.map(Speech::File),
        repeat: false,
        profile: Some(Profile::Standard),
        hub: Arc::clone(desk.hub()),
        clock: desk.clock(),
        mouths: [Mouth::new(Engine::shipped().model_id().unwrap(), &space())].into(),
    }
}

/// Silence, the shipped speech, silence; the silences are long enough for a machine that draws a picture a second.
fn between_silences(folder: &Path) -> PathBuf {
    let speech = lipstream_media::sound::decode(shipped::SOUND).unwrap().samples;
    let samples = [&[0; SILENCE][..], &speech, &[0; SILENCE]].concat();
    let path = folder.join("speech.wav");
    lipstream_media::sound::write(&path, &samples).unwrap();
    path
}

/// Samples of silence before and after the speech, which has 67,520.
const SILENCE: usize = 80_000;

/// Greatest difference of two pictures in levels.
fn difference(a: &[u8], b: &[u8]) -> u8 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max().unwrap()
}

/// Notes in the page, at every picture, how far each pixel moves while the samples of each part are shown: in silence, in speech, and in
/// silence again. The page does it because a test that asks from outside is late on a busy machine. The first look in a part does not count: what is on the screen
/// may be the picture before, and that may lie half a second back.
const OBSERVER: &str = "
    window.parts = [[20000, 78000], [84000, 144000], [165000, 220000]].map(([from, to]) => ({ from, to, low: null, high: null, looks: 0 }));
    const look = () => {
        requestAnimationFrame(look);
        const at = window.lipstream.frameAtShown();
        const part = at && window.parts.find(part => at.position >= part.from && at.position < part.to);
        const same = part === window.lastPart;
        window.lastPart = part;
        if (!part || !same) return;
        const pixels = PIXELS;
        part.low = part.low ? part.low.map((v, k) => Math.min(v, pixels[k])) : Array.from(pixels);
        part.high = part.high ? part.high.map((v, k) => Math.max(v, pixels[k])) : Array.from(pixels);
        part.looks++;
    };
    look();
";

/// What is watched: an expression for its pixels, and by how many levels one of them may move in silence before speech and after it.
struct Watched(&'static str, [f64; 2]);

const MOUTH: Watched = Watched("window.lipstream.pixels()", [6.0, 16.0]);
/// The inner of the mouth's rectangle, whose place in the pictures is known. JPEG gives and takes some levels.
const FACE: Watched = Watched("window.lipstream.facePixels(42, 44, 40, 28)", [16.0, 24.0]);

/// Watches the page while speech is between two silences: still, moving, still. Gives the median delay in milliseconds.
fn still_moving_still(browser: &mut Browser, name: &str, Watched(pixels, still): Watched) -> f64 {
    browser.evaluate(&OBSERVER.replace("PIXELS", pixels));
    let position = "(window.lipstream.frameAtShown()?.position ?? 0)";
    browser.wait(&format!("{position} > 110000"));
    browser.photograph(&artefacts().join(format!("{name}.png")));
    browser.wait(&format!("{position} > 220000"));
    let stats = browser.evaluate("window.lipstream.stats()");
    println!("{name}: {stats}");
    let part = |browser: &mut Browser, k: usize| {
        let looks = browser.number(&format!("window.parts[{k}].looks"));
        let moved = format!(
            "Math.max(...(window.parts[{k}].high ?? [0]).map((v, i) => v - window.parts[{k}].low[i]))"
        );
        (looks, browser.number(&moved))
    };
    let parts = [0, 1, 2].map(|k| part(browser, k));
    println!("{name}: pictures, and levels that a pixel moves, in silence, speech and silence: {parts:?}");
    assert!(
        parts.iter().all(|(looks, _)| *looks >= 2.0),
        "too few pictures: {parts:?}"
    );
    assert!(
        parts[0].1 <= still[0] && parts[2].1 <= still[1],
        "the mouth moves in silence: {parts:?}"
    );
    assert!(parts[1].1 >= 40.0, "the mouth hardly moves in speech: {parts:?}");
    stats["delayMs"]["median"].as_f64().unwrap_or(f64::NAN)
}

fn no_complaints(browser: &Browser) {
    assert!(browser.complaints.is_empty(), "{:#?}", browser.complaints);
}

#[test]
fn in_a_browser_speech_moves_the_mouth_and_silence_does_not() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    let (desk, server) = desk(folder.path(), true);
    let mut browser = Browser::open(&format!("{}?webgl", server.url()));
    desk.attach(setup(
        &desk,
        Source::Inside(Arc::new(Engine::shipped())),
        Some(between_silences(folder.path())),
    ));
    let delay = still_moving_still(&mut browser, "inside", MOUTH);
    // Look-ahead and window of the profile, the jitter buffer, and a picture.
    assert!((72.0..400.0).contains(&delay), "{delay} ms from sample to screen");
    // What is on the screen is the mean and the weighted eigenmouths of the frame.
    let drawn = browser.pixels();
    let shown = browser.evaluate("window.lipstream.frameAtShown()");
    let parameters: Vec<f32> = shown["parameters"]
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_f64().unwrap() as f32)
        .collect();
    let space = space();
    let want = space.expand(ndarray::Array1::from(parameters).view());
    let worst = drawn
        .chunks_exact(4)
        .flat_map(|pixel| &pixel[..3])
        .zip(&want)
        .map(|(have, want)| (f32::from(*have) - want.clamp(0.0, 255.0)).abs())
        .fold(0.0, f32::max);
    assert!(
        worst <= 3.0,
        "{worst} levels from the picture that the numbers describe"
    );
    no_complaints(&browser);
}

/// A drawn person whose head is still, so that what moves is the mouth, with the shipped model's mouth.
fn face(hub: &Arc<Hub>) -> Option<Face> {
    let settings = FaceSettings {
        whose: Some(Whose::Models),
        jaw: None,
        noise: Some(0.0),
        ..FaceSettings::default()
    };
    let face = LiveFace::new(person::recording(120, 0.0, 0.0), space(), &settings).unwrap();
    Some(Face::start(hub, Engine::shipped().model_id().unwrap(), face))
}

#[test]
fn in_a_browser_a_face_moves_its_mouth_in_speech_and_not_in_silence() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    let (desk, server) = desk_with(folder.path(), true, face);
    let mut browser = Browser::open_plain(&server.url());
    desk.attach(setup(
        &desk,
        Source::Inside(Arc::new(Engine::shipped())),
        Some(between_silences(folder.path())),
    ));
    browser.wait("window.lipstream.stats().face?.drawn > 5");
    let delay = still_moving_still(&mut browser, "face", FACE);
    assert!((50.0..400.0).contains(&delay), "{delay} ms from sample to screen");
    let visible = browser.evaluate(
        "[document.querySelector('#face figcaption').innerText, document.getElementById('picture').ariaLabel, document.getElementById('mouth').hidden]",
    );
    assert!(visible[0].as_str().unwrap().starts_with("Synthetic"), "{visible}");
    assert!(
        visible[1].as_str().unwrap().contains("synthetic") && visible[2] == true,
        "{visible}"
    );
    // The mouth alone can still be seen, and then no picture of the face is drawn.
    browser.evaluate("document.getElementById('can-face').click()");
    browser.wait("document.getElementById('face').hidden && window.lipstream.pixels().length > 0");
    let watched = || {
        desk.face(Engine::shipped().model_id().unwrap())
            .unwrap()
            .is_watched()
    };
    let began = Instant::now();
    while watched() {
        assert!(
            began.elapsed() < Duration::from_secs(20),
            "the face is still asked for"
        );
        std::thread::sleep(Duration::from_millis(20));
    }
    no_complaints(&browser);
}

#[test]
fn in_a_browser_the_firmware_in_qemu_speaks() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    let program = common::build::build_firmware("mps2-an386", &common::folder("browser"), "firmware", None);
    let (desk, server) = desk(folder.path(), true);
    let mut browser = Browser::open_plain(&server.url());
    desk.attach(setup(
        &desk,
        Source::Line(Address::Qemu(program)),
        Some(between_silences(folder.path())),
    ));
    // Beside a browser QEMU may not be as fast as life: sound is left out then, and only what comes early has its place in the samples.
    let parts = "[[2000, 12000], [12000, 400000]]";
    browser.evaluate(
        &OBSERVER
            .replace("PIXELS", MOUTH.0)
            .replace("[[20000, 78000], [84000, 144000], [165000, 220000]]", parts),
    );
    browser.wait("document.body.innerText.includes('the sound has ended')");
    browser.photograph(&artefacts().join("qemu.png"));
    let moved = |browser: &mut Browser, k: usize| {
        browser.wait(&format!("window.parts[{k}].looks >= 2"));
        browser.number(&format!(
            "Math.max(...window.parts[{k}].high.map((v, i) => v - window.parts[{k}].low[i]))"
        ))
    };
    let (still, moving) = (moved(&mut browser, 0), moved(&mut browser, 1));
    println!("qemu: levels that a pixel moves, in silence and afterwards: {still} {moving}");
    // It still settles at the start; and a slow machine draws fewer pictures of the speech, so that some of its widest ones are missed.
    assert!(
        still <= 20.0 && moving >= 40.0 && moving >= 2.0 * still,
        "{still} {moving}"
    );
    let stats = browser.evaluate("window.lipstream.stats()");
    assert!(stats["framesReceived"].as_f64().unwrap() > 500.0);
    assert_eq!(
        stats["model"],
        format!("{:08x}", Engine::shipped().model_id().unwrap())
    );
    no_complaints(&browser);
}

#[test]
fn in_a_browser_a_recording_plays_again() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    let stream = folder.path().join("a.stream");
    // Recorded from the model in this process.
    let hub = Arc::new(Hub::default());
    let tape = Tape::begin(&hub, "a".to_owned(), Recorder::create(&stream).unwrap());
    let driver = Driver::start(Setup {
        source: Source::Inside(Arc::new(Engine::shipped())),
        speech: Some(Speech::File(between_silences(folder.path()))),
        repeat: false,
        profile: Some(Profile::Standard),
        hub: Arc::clone(&hub),
        clock: Clock::start(),
        mouths: Arc::default(),
    });
    let frames = tape.wait().unwrap();
    drop(driver);
    assert_eq!(frames, 1420);
    let (desk, server) = desk(folder.path(), true);
    let mut browser = Browser::open_plain(&server.url());
    desk.attach(setup(&desk, Source::Line(Address::Recording(stream)), None));
    still_moving_still(&mut browser, "recording", MOUTH);
    browser.wait("window.lipstream.stats().notices.some(n => String(n).includes('has ended') || JSON.stringify(n).includes('has ended'))");
    no_complaints(&browser);
}

#[test]
fn in_a_browser_the_canvas_draws_where_webgl_is_missing() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    let (desk, server) = desk(folder.path(), true);
    desk.demo();
    let mut browser = Browser::open(&server.url());
    browser.wait("window.lipstream.stats().pictures > 20");
    assert_eq!(browser.evaluate("window.lipstream.stats().renderer"), "canvas");
    let first = browser.pixels();
    let began = Instant::now();
    while difference(&first, &browser.pixels()) < 30 {
        assert!(
            began.elapsed() < Duration::from_secs(20),
            "the canvas does not change"
        );
    }
    browser.photograph(&artefacts().join("canvas.png"));
    no_complaints(&browser);
}

#[test]
fn in_a_browser_nothing_attached_offers_the_demo_and_a_model_may_be_missing() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    // Without a mouth for the demo's model the page shows visemes and numbers.
    let (_desk, server) = desk(folder.path(), false);
    let mut browser = Browser::open_plain(&server.url());
    browser.wait("document.getElementById('can-demo')?.hidden === false");
    browser.evaluate("document.getElementById('can-demo').click()");
    browser.wait("window.lipstream.stats().framesReceived > 100");
    browser.photograph(&artefacts().join("without-model.png"));
    let text = browser.evaluate("document.body.innerText");
    let text = text.as_str().unwrap().to_lowercase();
    assert!(text.contains("model"), "{text}");
    // That there is no mouth is no error of the page; the browser notes the answer 404.
    assert!(
        browser.complaints.iter().all(|c| c.contains("404")),
        "{:#?}",
        browser.complaints
    );
}

/// Half a minute of frames leaves nothing behind.
#[test]
fn in_a_browser_the_heap_does_not_grow() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    let (desk, server) = desk(folder.path(), true);
    desk.demo();
    let mut browser = Browser::open_plain(&server.url());
    browser.wait("window.lipstream.stats().framesReceived > 500");
    let before = browser.heap();
    std::thread::sleep(Duration::from_secs(30));
    let after = browser.heap();
    println!("{before} bytes, then {after}");
    assert!(after < 1.15 * before + 200_000.0, "{before} bytes became {after}");
    no_complaints(&browser);
}
