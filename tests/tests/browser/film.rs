//! The page of `lipstream render -o x.html` in a real browser: a long sound is zoomed and scrolled, and the slider stands where the axis says.
use lipstream::cues::{Cue, Shape};
use lipstream::render::{self, drawn, page};
use ndarray::Array2;

use crate::chromium::Browser;

const SECONDS: usize = 40;

/// A page of 40 s.
fn film() -> String {
    let space = drawn::space(6);
    let tracks = drawn::babble(&space, 100 * SECONDS);
    let sound: Vec<i16> = (0..16_000 * SECONDS).map(|i| (i * 97 % 2000) as i16).collect();
    let settings = render::Settings {
        scale: Some(1),
        ..render::Settings::default()
    };
    let film = render::to_mp4(&space, tracks.view(), Some(&sound), &settings, &()).unwrap();
    let weights = Array2::from_shape_fn((tracks.nrows(), 13), |(t, v)| {
        f32::from(u8::from(t / 10 % 13 == v))
    });
    let cues: Vec<Cue> = (0..2 * SECONDS)
        .map(|i| Cue {
            start_s: i as f64 / 2.0,
            end_s: (i + 1) as f64 / 2.0,
            shape: if i % 2 == 0 { Shape::A } else { Shape::D },
        })
        .collect();
    page::write(&page::Page {
        title: "forty.wav",
        mp4: &film.mp4,
        sound: &sound,
        viseme_weights: weights.view(),
        parameters: tracks.view(),
        deviation: space.deviation.view(),
        cues: &cues,
    })
    .unwrap()
}

fn click(browser: &mut Browser, id: &str) {
    browser.evaluate(&format!("document.getElementById('{id}').click()"));
}

#[test]
fn in_a_browser_a_long_film_is_zoomed_scrolled_and_slowed() {
    let _alone = crate::alone();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("forty.html");
    std::fs::write(&file, film()).unwrap();
    let mut browser = Browser::open_plain(&format!("file://{}", file.display()));
    browser.wait("video.readyState >= 2");

    // A thumb of 16 pixels stands over the axis, whose left and right ends are 64 and 8 pixels inside the drawing.
    for id in ["seek", "window"] {
        let edge = |side: &str| format!("document.getElementById('{id}').getBoundingClientRect().{side}");
        let canvas = |side: &str| format!("time.getBoundingClientRect().{side}");
        let left = browser.number(&format!("{} + 8 - {} - 64", edge("left"), canvas("left")));
        let right = browser.number(&format!("{} - 8 - {} + 8", edge("right"), canvas("right")));
        assert!(left.abs() < 1.0 && right.abs() < 1.0, "{id}: {left} {right}");
    }

    assert_eq!((browser.number("from"), browser.number("span")), (0.0, 10.0));
    let first = browser.evaluate("time.toDataURL()");
    click(&mut browser, "in");
    assert_eq!(browser.number("span"), 5.0);
    assert_ne!(
        browser.evaluate("time.toDataURL()"),
        first,
        "the drawing is zoomed"
    );
    browser.evaluate("time.dispatchEvent(new WheelEvent('wheel', { deltaX: 1000, cancelable: true }))");
    assert_eq!(browser.number("from"), 5.0);
    assert_eq!(browser.number("Number(seek.min)"), 5.0);
    assert_eq!(browser.number("Number(seek.max)"), 10.0);

    // What is clicked in the middle of the axis is in the middle of what is shown.
    browser.evaluate(
        "{ const r = time.getBoundingClientRect(), x = r.left + 64 + (r.width - 72) / 2;
           time.dispatchEvent(new MouseEvent('click', { clientX: x, clientY: r.top + 20 })); }",
    );
    browser.wait("!video.seeking && Math.abs(video.currentTime - 7.5) < 0.1");
    browser.wait("Math.abs(Number(seek.value) - 7.5) < 0.1");
    browser.photograph(&crate::artefacts().join("film.png"));

    // All of it: nothing is left to scroll.
    for _ in 0..4 {
        click(&mut browser, "out");
    }
    assert_eq!((browser.number("from"), browser.number("span")), (0.0, 40.0));
    assert_eq!(browser.evaluate("document.getElementById('window').hidden"), true);

    click(&mut browser, "again");
    assert_eq!(browser.evaluate("video.loop"), true);
    browser.evaluate("{ const s = document.getElementById('speed'); s.value = '0.25'; s.dispatchEvent(new Event('change')); }");
    assert_eq!(browser.number("video.playbackRate"), 0.25);
    let link = "document.getElementById('save')";
    assert_eq!(
        browser.evaluate(&format!(
            "{link}.href === video.src && {link}.download === 'forty.mp4'"
        )),
        true
    );

    // The film that runs out of what is shown takes the view along.
    browser.evaluate("look(0, 5); video.currentTime = 12; video.playbackRate = 1; video.play(); 0");
    browser.wait("from > 5");
    browser.evaluate("video.pause()");
    crate::no_complaints(&browser);
}
