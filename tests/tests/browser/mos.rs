//! The page of `lipstream mos make` in a real browser: what a viewer clicks is what the tables say.
use std::path::Path;

use lipstream::render::{self, drawn};
use lipstream_make::mos::{self, Key, Results, Settings};

use crate::chromium::Browser;

/// A folder of clips that last a moment: two systems, two sentences.
fn clips(folder: &Path) {
    let space = drawn::space(6);
    let settings = render::Settings {
        scale: Some(1),
        ..render::Settings::default()
    };
    for (system, shift) in [("best-system", 0), ("recording", 7)] {
        for (clip, frames) in [("one", 20), ("two", 24)] {
            let tracks = drawn::babble(&space, shift + frames);
            let tracks = tracks.slice(ndarray::s![shift.., ..]);
            let sound: Vec<i16> = (0..160 * frames).map(|i| (i * 97 % 2000) as i16).collect();
            let film = render::to_mp4(&space, tracks, Some(&sound), &settings, &()).unwrap();
            let path = folder.join(system).join(format!("{clip}.mp4"));
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, film.mp4).unwrap();
        }
    }
}

/// What the viewer answers at the place that the page has come to.
fn answer(browser: &mut Browser, key: &Key) -> [u8; 5] {
    let trial = browser.evaluate("window.lipstream.trials[window.lipstream.place()]");
    if let Some(asked) = trial["check"].as_u64() {
        let notice = browser.evaluate("document.getElementById('notice').textContent");
        assert!(
            notice
                .as_str()
                .unwrap()
                .contains(&format!("choose {asked} for every question"))
        );
        return [asked as u8; 5];
    }
    assert_eq!(
        browser.evaluate("document.getElementById('notice').textContent"),
        ""
    );
    let code = browser.evaluate("data.clips[window.lipstream.trials[window.lipstream.place()].clip].code");
    match key.clips[code.as_str().unwrap()].system.as_str() {
        "recording" => [5, 5, 4, 5, 5],
        _ => [3, 2, 3, 1, 2],
    }
}

#[test]
fn in_a_browser_what_is_clicked_is_what_the_tables_say() {
    let _alone = crate::alone();
    let folder = tempfile::tempdir().unwrap();
    clips(&folder.path().join("clips"));
    let mos::Made { html, key } = mos::make(&folder.path().join("clips"), "Two mouths").unwrap();
    let page = folder.path().join("page.html");
    std::fs::write(&page, html).unwrap();
    let url = format!("file://{}#seed=5", page.display());
    let mut browser = Browser::open_plain(&url);

    let next_is = |browser: &mut Browser, what: &str| {
        browser.evaluate(&format!("document.getElementById('next').{what}"))
    };
    let told = browser.evaluate("document.body.innerText");
    assert!(!told.as_str().unwrap().contains("best-system"));
    browser.evaluate("document.getElementById('begin').click()");
    // One for practice, four clips, two checks.
    assert_eq!(browser.evaluate("window.lipstream.trials.length"), 7);
    for place in 0..7 {
        assert_eq!(browser.evaluate("window.lipstream.place()"), place);
        // Nobody answers about a clip that has not been seen.
        browser.wait("document.getElementById('film').readyState >= 3");
        assert_eq!(
            browser.evaluate("document.querySelectorAll('fieldset:disabled').length"),
            5
        );
        let scores = answer(&mut browser, &key);
        if place == 3 {
            // By the keys alone.
            let press = |browser: &mut Browser, key: &str| {
                browser.evaluate(&format!(
                    "document.dispatchEvent(new KeyboardEvent('keydown', {{ key: '{key}' }}))"
                ));
            };
            press(&mut browser, "3");
            press(&mut browser, "p");
            browser.wait("document.querySelectorAll('fieldset:disabled').length === 0");
            for score in scores {
                press(&mut browser, &score.to_string());
            }
            browser.evaluate("document.getElementById('heading').dispatchEvent(new KeyboardEvent('keydown', { key: 'Enter', bubbles: true }))");
        } else {
            browser.evaluate("document.getElementById('play').click()");
            browser.wait("document.querySelectorAll('fieldset:disabled').length === 0");
            for (question, score) in scores.iter().enumerate() {
                assert_eq!(
                    next_is(&mut browser, "disabled"),
                    true,
                    "question {question} is open"
                );
                browser.evaluate(&format!(
                    "document.querySelector('[name=q{question}][value=\"{score}\"]').click()"
                ));
            }
            browser.evaluate("document.getElementById('next').click()");
        }
        if place == 4 {
            // Whoever closes the page goes on where he was.
            // What one page has kept reaches the next by way of the browser's other processes, which are late on a busy machine.
            let goes_on = (0..5).any(|_| {
                std::thread::sleep(std::time::Duration::from_millis(300));
                browser.load(&url);
                browser.evaluate("document.getElementById('begin').textContent") == "Go on"
            });
            assert!(goes_on, "the page begins anew");
            browser.evaluate("document.getElementById('begin').click()");
        }
    }
    browser.wait("!document.getElementById('end').hidden");
    assert_eq!(browser.evaluate("document.getElementById('trial').hidden"), true);
    browser.photograph(&crate::artefacts().join("mos.png"));

    // The link, the text and the page itself hold the same file.
    let text = browser.evaluate("fetch(document.getElementById('save').href).then(r => r.text())");
    let text = text.as_str().unwrap();
    assert_eq!(browser.evaluate("document.getElementById('text').value"), text);
    let name = browser.evaluate("document.getElementById('save').download");
    assert!(
        name.as_str().unwrap().starts_with(&format!("mos-{}-", key.test)),
        "{name}"
    );
    let path = folder.path().join("answers.json");
    std::fs::write(&path, text).unwrap();
    let results = Results::read(&path).unwrap();
    assert!(results.attentive());
    assert_eq!((results.seed, results.answers.len()), (5, 6));
    assert!(results.answers.iter().all(|a| a.plays == 1 && a.seconds > 0.0));
    assert!(!results.started.is_empty() && results.finished > results.started);

    let report = mos::tables(&[key], &[("answers.json".into(), results)], &Settings::default()).unwrap();
    for want in [
        "| best-system | 3.00 [3.00, 3.00] | 2.00 [2.00, 2.00] | 3.00 [3.00, 3.00] | 1.00 [1.00, 1.00] | 2.00 [2.00, 2.00] | — |",
        "| recording | 5.00 [5.00, 5.00] | 5.00 [5.00, 5.00] | 4.00 [4.00, 4.00] | 5.00 [5.00, 5.00] | 5.00 [5.00, 5.00] | 150.00 [150.00, 150.00] |",
    ] {
        assert!(report.contains(want), "{report}");
    }
    assert!(browser.complaints.is_empty(), "{:?}", browser.complaints);
}

/// Every seed shows every clip once and the checks apart from each other, never first.
#[test]
fn in_a_browser_orders_are_fair() {
    let _alone = crate::alone();
    let folder = tempfile::tempdir().unwrap();
    clips(&folder.path().join("clips"));
    let page = folder.path().join("page.html");
    std::fs::write(
        &page,
        mos::make(&folder.path().join("clips"), "Two mouths")
            .unwrap()
            .html,
    )
    .unwrap();
    let mut browser = Browser::open_plain(&format!("file://{}", page.display()));
    let found = browser.evaluate(
        "(() => {
            const first = [0, 0, 0, 0];
            for (let seed = 0; seed < 4000; seed++) {
                const trials = plan(seed);
                const clips = trials.filter(t => !t.practice && t.check === null).map(t => t.clip);
                const checks = trials.flatMap((t, k) => t.check === null ? [] : [k]);
                if (clips.slice().sort().join() !== '0,1,2,3') return 'clips ' + clips;
                if (!trials[0].practice || checks.length !== 2 || checks[0] < 2) return 'checks ' + checks;
                first[clips[0]] += 1;
            }
            return first.every(n => n > 850 && n < 1150) ? 'fair' : 'first ' + first;
        })()",
    );
    assert_eq!(found, "fair");
}
