//! The page of `lipstream landmarks --page` in a real browser: a point lies in the table where it was dropped.
use std::ffi::OsString;
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

use lipstream_make::hierarchical::Landmarks;

use crate::chromium::Browser;
use crate::heads;

/// A port that nobody listens on.
fn free_port() -> u16 {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    listener.local_addr().unwrap().port()
}

/// Where a place of the picture lies on the screen.
fn on_screen(browser: &mut Browser, [x, y]: [f64; 2]) -> [f64; 2] {
    let place = browser.evaluate(&format!(
        "(at => [at.x, at.y])(new DOMPoint({x}, {y}).matrixTransform(document.getElementById('view').getScreenCTM()))"
    ));
    [0, 1].map(|axis| place[axis].as_f64().unwrap())
}

/// Where a point is, in pixels of the video.
fn point(browser: &mut Browser, number: usize) -> [f64; 2] {
    let point = browser.evaluate(&format!("window.lipstream.points()[{number}]"));
    [0, 1].map(|axis| point[axis].as_f64().unwrap())
}

fn near(have: [f64; 2], want: [f64; 2]) -> bool {
    (have[0] - want[0]).hypot(have[1] - want[1]) < 0.1
}

#[test]
fn in_a_browser_a_point_is_kept_where_it_was_dropped() {
    let _alone = crate::alone();
    let folder = tempfile::tempdir().unwrap();
    heads::talker(folder.path());
    let port = free_port();
    let file = |name: &str| folder.path().join(name).into_os_string();
    let port_word = OsString::from(port.to_string());
    let words: Vec<OsString> = vec![
        "lipstream".into(),
        "landmarks".into(),
        file("talker.mp4"),
        "--labelled".into(),
        file("some.csv"),
        "--output".into(),
        file("all.npz"),
        "--page".into(),
        file("labels.csv"),
        "--port".into(),
        port_word,
    ];
    let program = std::thread::spawn(move || lipstream_cli::run(words));
    let began = Instant::now();
    while TcpStream::connect((Ipv4Addr::LOCALHOST, port)).is_err() {
        assert!(!program.is_finished(), "{:?}", program.join());
        assert!(began.elapsed() < Duration::from_secs(60), "no page is served");
        std::thread::sleep(Duration::from_millis(50));
    }
    let mut browser = Browser::open_plain(&format!("http://127.0.0.1:{port}/"));
    browser.wait("!window.lipstream.busy() && window.lipstream.state()");
    let first = browser.evaluate("window.lipstream.state().proposal");
    let picture = first["picture"].as_u64().unwrap() as usize;
    browser.wait("fetch(document.querySelector('#view image').getAttribute('href')).then(a => a.blob()).then(createImageBitmap).then(p => p.width === 96)");

    // The bottom of the outer lip, by the mouse.
    let dropped = [50.25, 80.5];
    let from = point(&mut browser, 3);
    let [from, to] = [from, dropped].map(|place| on_screen(&mut browser, place));
    browser.mouse("mousePressed", from);
    for step in 1..=4 {
        let part = f64::from(step) / 4.0;
        browser.mouse("mouseMoved", [0, 1].map(|k| from[k] + part * (to[k] - from[k])));
    }
    browser.mouse("mouseReleased", to);
    let there = point(&mut browser, 3);
    assert!(near(there, dropped), "dropped at {dropped:?}, it is at {there:?}");
    // Who moves the mouse afterwards moves no point.
    browser.mouse("mouseMoved", from);
    assert!(near(point(&mut browser, 3), there));

    // By the keys: this one a pixel to the right, the next one up.
    let above = point(&mut browser, 4);
    for key in ["ArrowRight", "Tab", "ArrowUp"] {
        browser.press(key);
    }
    let moved = [[there[0] + 1.0, there[1]], [above[0], above[1] - 1.0]];
    assert!(near(point(&mut browser, 3), moved[0]) && near(point(&mut browser, 4), moved[1]));
    // By a finger, which does not scroll the page with it: the corner of the mouth.
    let corner = [20.5, 70.25];
    let from = point(&mut browser, 0);
    let [from, to] = [from, corner].map(|place| on_screen(&mut browser, place));
    browser.touch("touchStart", Some(from));
    let middle = [0, 1].map(|axis| (from[axis] + to[axis]) / 2.0);
    browser.touch("touchMove", Some(middle));
    browser.touch("touchMove", Some(to));
    browser.touch("touchEnd", None);
    // Chromium tells of fingers by the pictures that it draws.
    let [x, y] = corner;
    browser.wait(&format!(
        "(([x, y]) => Math.hypot(x - {x}, y - {y}) < 0.1)(window.lipstream.points()[0])"
    ));
    browser.photograph(&crate::artefacts().join("landmarks.png"));

    browser.press("Enter");
    browser.wait("window.lipstream.state().labelled === 7 && !window.lipstream.busy()");
    let kept = Landmarks::read(&folder.path().join("labels.csv")).unwrap();
    let kept = kept.picture("talker", picture).unwrap();
    for (number, want) in [(0, corner), (3, moved[0]), (4, moved[1])] {
        let have = [0, 1].map(|axis| f64::from(kept[2 * number + axis]));
        assert!(
            near(have, want),
            "point {number} is kept at {have:?}, not {want:?}"
        );
    }
    let second = browser.evaluate("window.lipstream.state().proposal.picture");
    assert_ne!(second, picture);
    browser.press("s");
    browser.wait(&format!(
        "!window.lipstream.busy() && window.lipstream.state().proposal.picture !== {second}"
    ));
    assert!(!folder.path().join("all.npz").exists());
    browser.evaluate("document.getElementById('done').click()");
    browser.wait("window.lipstream.state().done && !document.getElementById('banner').hidden");
    program.join().unwrap().unwrap();
    let all = Landmarks::read(&folder.path().join("all.npz")).unwrap();
    assert_eq!(all.of("talker").unwrap().dim(), (24, 13, 2));
    assert!(browser.complaints.is_empty(), "{:#?}", browser.complaints);
}
