//! What a face costs and how late it is, for backgrounds of any size.
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use lipstream::engine::{Engine, RunSettings};
use lipstream::render::SYNTHETIC;
use lipstream::render::face::{FaceSettings, LiveFace};
use lipstream::{render, shipped};
use lipstream_core::wire::Profile;
use lipstream_live::face::{Face, QUALITY};
use lipstream_live::feed::Speech;
use lipstream_make::vision;
use lipstream_media::encode::jpeg;

use super::process::{Family, Usage};
use super::{Device, Drawn, STRETCH, bench_with, shipped_space};

pub(crate) fn run(videos: &[&str]) {
    println!(
        "| background | drawing a picture: median, 95 %, ms | as JPEG, ms | KB | host | browser: page | browser: the rest | pictures/s | late | sound to picture: median, worst, ms |\n|---|---|---|---|---|---|---|---|---|---|"
    );
    for video in videos {
        let footage = vision::footage(Path::new(video), vision::LONGEST_S, &()).expect("a face");
        let settings = FaceSettings {
            fps: LiveFace::rate(&footage),
            ..FaceSettings::default()
        };
        let mut face = LiveFace::new(footage, shipped_space(), &settings).expect("a background");
        let alone = Alone::of(&mut face);
        println!("| {}", watched(face, &alone));
    }
}

/// What pictures take by themselves.
struct Alone {
    draw_ms: Vec<f64>,
    jpeg_ms: Vec<f64>,
    bytes: usize,
}

impl Alone {
    /// The shipped speech, a few times over: so that the background comes to its join.
    fn of(face: &mut LiveFace) -> Self {
        let samples = lipstream_media::sound::decode(shipped::SOUND).unwrap().samples;
        let said = Engine::shipped()
            .convert(&samples, &RunSettings::default())
            .unwrap();
        let tracks = render::at_pictures(said.parameters.view(), face.fps(), None).unwrap();
        let mut alone = Self {
            draw_ms: Vec::new(),
            jpeg_ms: Vec::new(),
            bytes: 0,
        };
        for n in 0..8 * tracks.nrows() {
            let began = Instant::now();
            let seconds = (n as f64 + 0.5) / f64::from(face.fps());
            let rgb = face.draw(seconds, tracks.row(n % tracks.nrows())).unwrap();
            let drawn = Instant::now();
            alone.bytes += jpeg(&rgb, face.size(), QUALITY, SYNTHETIC).unwrap().len();
            alone.draw_ms.push((drawn - began).as_secs_f64() * 1000.0);
            alone.jpeg_ms.push(drawn.elapsed().as_secs_f64() * 1000.0);
        }
        alone.bytes /= alone.draw_ms.len();
        alone.draw_ms.sort_by(f64::total_cmp);
        alone.jpeg_ms.sort_by(f64::total_cmp);
        alone
    }
}

/// A row of the table: the face in a page, in steady speech.
fn watched(face: LiveFace, alone: &Alone) -> String {
    let (width, height) = face.size();
    let model = Engine::shipped().model_id().unwrap();
    let mut bench = bench_with(Vec::new(), Drawn::Canvas, |hub| {
        Some(Face::start(&Arc::clone(hub), model, face))
    });
    bench.attach(Device::Inside, Speech::Shipped, true, Profile::Standard);
    bench.browser.wait("window.lipstream.stats().face?.drawn > 100");
    let browser = bench.browser.process();
    let (before, began) = (Family::of(browser), Instant::now());
    let ask = "(() => { const { face, delayMs } = window.lipstream.stats(); return [face.drawn, face.late, delayMs.median, delayMs.worst]; })()";
    let first = bench.browser.evaluate(ask);
    std::thread::sleep(STRETCH);
    let (after, seconds) = (Family::of(browser), began.elapsed().as_secs_f64());
    let last = bench.browser.evaluate(ask);
    let number = |of: &serde_json::Value, k: usize| of[k].as_f64().unwrap_or(f64::NAN);
    let step = |k: usize| number(&last, k) - number(&first, k);
    let share = |of: fn(&Family) -> Usage| 100.0 * (of(&after).seconds - of(&before).seconds) / seconds;
    let notices = bench.browser.evaluate("window.lipstream.stats().notices");
    for notice in notices.as_array().into_iter().flatten() {
        eprintln!("notice: {notice}");
    }
    let at = |of: &[f64], share: f64| of[(share * (of.len() - 1) as f64) as usize];
    format!(
        "{width}×{height} | {:.1}, {:.1} | {:.1} | {:.0} | {:.1} % | {:.1} % | {:.1} % | {:.1} | {:.0} of {:.0} | {:.0}, {:.0} |",
        at(&alone.draw_ms, 0.5),
        at(&alone.draw_ms, 0.95),
        at(&alone.jpeg_ms, 0.5),
        alone.bytes as f64 / 1000.0,
        share(|f| f.host),
        share(|f| f.page),
        share(|f| f.rest),
        step(0) / seconds,
        step(1),
        step(0),
        number(&last, 2),
        number(&last, 3)
    )
}
