//! Measures the live half with a page in headless Chromium: delay from sound to picture, processor time, growth. Prints the tables of
//! `docs/live.md`.
//!
//! ```text
//! cargo bench -p lipstream-tests --bench live -- delay [qemu]  from the onset of a vowel to the picture in which the mouth opens
//! cargo bench -p lipstream-tests --bench live -- cpu           processor time of host and page
//! cargo bench -p lipstream-tests --bench live -- soak MINUTES  what grows
//! cargo bench -p lipstream-tests --bench live -- pictures      pictures a second by parameters
//! cargo bench -p lipstream-tests --bench live -- face VIDEO... what a face on a background takes, and how late it is
//! cargo bench -p lipstream-tests --bench live -- film FOLDER   pictures of the page, numbered
//! ```
//!
//! Times of sound are the host's clock, times of pictures the browser's; both are asked at once to compare them, which is right to half
//! of the time that the answer takes.
#[path = "../../tests/browser/chromium.rs"]
#[allow(dead_code, reason = "the tests use more of it")]
mod chromium;
#[path = "../../tests/common/mod.rs"]
#[allow(dead_code, reason = "the tests use more of it")]
mod common;
mod delay;
mod device;
mod face;
mod process;

use std::net::{IpAddr, Ipv4Addr};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use chromium::Browser;
use lipstream::engine::Engine;
use lipstream::mouth::MouthSpace;
use lipstream::shipped;
use lipstream::tensors::Tensors;
use lipstream_core::wire::Profile;
use lipstream_live::address::Address;
use lipstream_live::clock::Clock;
use lipstream_live::desk::{Desk, Equipment, Mouth};
use lipstream_live::driver::{Setup, Source};
use lipstream_live::face::Face;
use lipstream_live::feed::Speech;
use lipstream_live::hub::Hub;
use lipstream_live::serve::{Place, Server};
use process::{Family, Usage};

fn main() {
    // Cargo adds a word of its own.
    let words: Vec<String> = std::env::args()
        .skip(1)
        .filter(|word| word != "--bench")
        .collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    match words[..] {
        ["delay"] => delay::run(&[Device::Inside, Device::Line, Device::Qemu]),
        ["delay", "qemu"] => delay::run(&[Device::Qemu]),
        ["cpu"] => cpu(),
        ["soak", minutes] => soak(minutes.parse().expect("a number of minutes")),
        ["pictures"] => pictures(),
        ["face", ref videos @ ..] if !videos.is_empty() => face::run(videos),
        ["film", folder] => film(Path::new(folder)),
        [] => println!("live: say what to measure: {WAYS}"),
        _ => panic!("live: one of {WAYS}"),
    }
}

const WAYS: &str = "delay, cpu, soak MINUTES, pictures, face VIDEO..., film FOLDER";

/// A desk whose page a browser has open.
struct Bench {
    desk: Arc<Desk>,
    _server: Server,
    browser: Browser,
    folder: tempfile::TempDir,
}

fn shipped_space() -> MouthSpace {
    MouthSpace::load(&Tensors::parse(shipped::MODEL, "the shipped model").unwrap()).unwrap()
}

/// A desk that can draw the shipped mouth and `mouths`.
fn bench_as(mouths: Vec<Mouth>, how: Drawn) -> Bench {
    bench_with(mouths, how, |_| None)
}

/// The same with a face.
fn bench_with(mouths: Vec<Mouth>, how: Drawn, face: impl FnOnce(&Arc<Hub>) -> Option<Face>) -> Bench {
    let folder = tempfile::tempdir().unwrap();
    let engine = Arc::new(Engine::shipped());
    let mut all = vec![Mouth::new(engine.model_id().unwrap(), &shipped_space())];
    all.extend(mouths);
    let hub = Arc::new(Hub::default());
    let equipment = Equipment {
        clock: Clock::start(),
        mouths: all.into(),
        folder: folder.path().to_owned(),
        engine,
        face: face(&hub),
    };
    let desk = Arc::new(Desk::new(hub, equipment));
    let place = Place {
        address: IpAddr::V4(Ipv4Addr::LOCALHOST),
        port: 0,
    };
    let server = Server::start(Arc::clone(&desk), &place).unwrap();
    let browser = match how {
        Drawn::WebGl => Browser::open(&format!("{}?webgl", server.url())),
        Drawn::Canvas => Browser::open_plain(&server.url()),
    };
    Bench {
        desk,
        _server: server,
        browser,
        folder,
    }
}

/// What draws in the browser, which has no graphics card here.
#[derive(Clone, Copy, PartialEq)]
enum Drawn {
    WebGl,
    Canvas,
}

/// Where frames come from.
#[derive(Clone, Copy, PartialEq)]
enum Device {
    /// The model in this process.
    Inside,
    /// The firmware's application in this process, behind a TCP line: a device without an emulator's cost.
    Line,
    /// The firmware in QEMU.
    Qemu,
}

impl Device {
    fn words(self) -> &'static str {
        match self {
            Device::Inside => "the model in this program (`--wav`)",
            Device::Line => "the firmware's application behind a line",
            Device::Qemu => "the firmware in QEMU (`--qemu --wav`)",
        }
    }

    fn source(self, folder: &Path) -> Source {
        match self {
            Device::Inside => Source::Inside(Arc::new(Engine::shipped())),
            Device::Line => Source::Line(device::start()),
            Device::Qemu => Source::Line(Address::Qemu(common::build::build_firmware(
                "mps2-an386",
                folder,
                "firmware",
                None,
            ))),
        }
    }
}

impl Bench {
    fn attach(&self, from: Device, speech: Speech, repeat: bool, profile: Profile) {
        self.desk.attach(Setup {
            source: from.source(self.folder.path()),
            speech: Some(speech),
            repeat,
            profile: Some(profile),
            hub: Arc::clone(self.desk.hub()),
            clock: self.desk.clock(),
            mouths: [Mouth::new(
                Engine::shipped().model_id().unwrap(),
                &shipped_space(),
            )]
            .into(),
        });
    }

    /// Milliseconds that the browser's clock is ahead of the host's, and half of the time that asking took.
    fn clock_difference(&mut self) -> (f64, f64) {
        let mut best = (f64::NAN, f64::INFINITY);
        for _ in 0..50 {
            let before = self.desk.clock().now_ms();
            let there = self.browser.number("performance.now()");
            let after = self.desk.clock().now_ms();
            let half = (after - before) / 2.0;
            if half < best.1 {
                best = (there - (before + after) / 2.0, half);
            }
        }
        best
    }
}

/// Processor time over so long, in steady speech.
const STRETCH: Duration = Duration::from_secs(20);

fn cpu() {
    println!(
        "| source | drawn by | host | QEMU | browser: page | browser: the rest | pictures/s |\n|---|---|---|---|---|---|---|"
    );
    let ways = [
        (Device::Inside, Drawn::WebGl),
        (Device::Inside, Drawn::Canvas),
        (Device::Line, Drawn::Canvas),
        (Device::Qemu, Drawn::Canvas),
    ];
    for (from, how) in ways {
        let mut bench = bench_as(Vec::new(), how);
        bench.attach(from, Speech::Shipped, true, Profile::Standard);
        bench
            .browser
            .wait("window.lipstream.stats().framesReceived > 300");
        let drawn = bench.browser.evaluate("window.lipstream.stats().renderer");
        let browser = bench.browser.process();
        let family = || Family::of(browser);
        let before = (
            family(),
            Instant::now(),
            bench.browser.number("window.lipstream.stats().pictures"),
        );
        std::thread::sleep(STRETCH);
        let (after, seconds) = (family(), before.1.elapsed().as_secs_f64());
        let shown = bench.browser.number("window.lipstream.stats().pictures") - before.2;
        let share = |of: fn(&Family) -> Usage| {
            format!(
                "{:.1} %",
                100.0 * (of(&after).seconds - of(&before.0).seconds) / seconds
            )
        };
        let qemu = match from {
            Device::Qemu => share(|f| f.qemu),
            _ => "–".to_owned(),
        };
        println!(
            "| {} | {} | {} | {qemu} | {} | {} | {:.1} |",
            from.words(),
            drawn.as_str().unwrap(),
            share(|f| f.host),
            share(|f| f.page),
            share(|f| f.rest),
            shown / seconds
        );
    }
}

fn soak(minutes: u32) {
    let mut bench = bench_as(Vec::new(), Drawn::Canvas);
    bench.attach(Device::Line, Speech::Shipped, true, Profile::Standard);
    bench
        .browser
        .wait("window.lipstream.stats().framesReceived > 500");
    println!(
        "| minute | host, KiB | page's heap, KiB | page's process, KiB | browser's other processes, KiB | frames | lost | shown |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let began = Instant::now();
    for minute in 0..=minutes {
        let due = began + Duration::from_secs(60) * minute;
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        let heap = bench.browser.heap() / 1024.0;
        let family = Family::of(bench.browser.process());
        let stats = bench.browser.evaluate("window.lipstream.stats()");
        println!(
            "| {minute} | {} | {heap:.0} | {} | {} | {} | {} | {} |",
            family.host.kib,
            family.page.kib,
            family.rest.kib,
            stats["framesReceived"],
            stats["missing"],
            stats["framesShown"]
        );
    }
    for notice in bench
        .browser
        .evaluate("window.lipstream.stats().notices")
        .as_array()
        .into_iter()
        .flatten()
    {
        println!("notice: {notice}");
    }
    assert!(
        bench.browser.complaints.is_empty(),
        "{:?}",
        bench.browser.complaints
    );
}

fn pictures() {
    println!(
        "| parameters | drawn by | pictures/s | frames/s | drawing a picture, ms |\n|---|---|---|---|---|"
    );
    for (parameters, how) in [30, 64, 90]
        .into_iter()
        .flat_map(|n| [(n, Drawn::WebGl), (n, Drawn::Canvas)])
    {
        let space = device::space(&shipped_space(), parameters);
        let mut bench = bench_as(vec![Mouth::new(device::MODEL, &space)], how);
        bench.desk.attach(Setup {
            source: Source::Line(device::babbling(&space)),
            speech: None,
            repeat: false,
            profile: None,
            hub: Arc::clone(bench.desk.hub()),
            clock: bench.desk.clock(),
            mouths: Arc::default(),
        });
        bench
            .browser
            .wait("window.lipstream.stats().pictures > 60 && window.lipstream.pixels().length > 0");
        let renderer = bench.browser.evaluate("window.lipstream.stats().renderer");
        let ask = "(() => { const s = window.lipstream.stats(); return [performance.now(), s.pictures, s.framesReceived]; })()";
        let before = bench.browser.evaluate(ask);
        std::thread::sleep(Duration::from_secs(10));
        let after = bench.browser.evaluate(ask);
        let step = |k: usize| after[k].as_f64().unwrap() - before[k].as_f64().unwrap();
        let draw = bench.browser.number(
            "(() => { const began = performance.now(); for (let k = 0; k < 200; k++) window.lipstream.draw(); window.lipstream.pixels(); return (performance.now() - began) / 200; })()",
        );
        println!(
            "| {parameters} | {} | {:.1} | {:.1} | {draw:.2} |",
            renderer.as_str().unwrap(),
            1000.0 * step(1) / step(0),
            1000.0 * step(2) / step(0)
        );
    }
}

/// Pictures of the page at ten a second, for the film in the README.
fn film(folder: &Path) {
    std::fs::create_dir_all(folder).unwrap();
    let mut bench = bench_as(Vec::new(), Drawn::WebGl);
    bench.attach(Device::Inside, Speech::Shipped, true, Profile::Standard);
    bench
        .browser
        .wait("window.lipstream.stats().framesReceived > 450");
    let began = Instant::now();
    for number in 0..42 {
        let due = began + Duration::from_millis(100) * number;
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        bench.browser.photograph(&folder.join(format!("{number:03}.png")));
    }
}
