//! From the onset of a vowel to the picture in which the mouth opens.
use lipstream_core::wire::Profile;
use lipstream_live::event::Event;
use lipstream_live::feed::Speech;
use lipstream_live::hub::Missed;

use crate::{Device, Drawn, bench_as, common};

/// Vowels in the sound.
const VOWELS: usize = 12;
/// Samples of a vowel, and of the silence before it.
const VOWEL: usize = 4_800;
const SILENCE: usize = 24_000;
/// A mouth opens when one of 16 × 12 pixels is so many levels from where it was in silence.
const LEVELS: f64 = 12.0;
/// What moves later than this does not belong to the onset.
const WITHIN_MS: f64 = 700.0;

/// Vowels between silences, and the sample at which each begins.
fn sound() -> (Vec<i16>, Vec<usize>) {
    let speech = common::hello();
    let loudness = |at: usize| {
        speech[at..at + VOWEL]
            .iter()
            .map(|s| f64::from(*s).powi(2))
            .sum::<f64>()
    };
    let best = (0..speech.len() - VOWEL)
        .step_by(160)
        .max_by(|a, b| loudness(*a).total_cmp(&loudness(*b)))
        .unwrap();
    let vowel = &speech[best..best + VOWEL];
    let (mut samples, mut onsets) = (vec![0; SILENCE], Vec::new());
    for _ in 0..VOWELS {
        samples.resize(samples.len() + SILENCE, 0);
        onsets.push(samples.len());
        samples.extend(vowel);
    }
    samples.resize(samples.len() + SILENCE, 0);
    (samples, onsets)
}

/// Notes of every picture when it was made and how far the mouth is from where it rested.
const OBSERVER: &str = "
    window.seen = [];
    const small = Object.assign(document.createElement('canvas'), { width: 16, height: 12 }).getContext('2d', { willReadFrequently: true });
    let rest = null, steady = 0, before = null;
    const look = () => {
        requestAnimationFrame(look);
        // The canvas itself, made small: what a camera before the screen would see, at little cost.
        const canvas = document.querySelector('#mouth canvas');
        if (!canvas?.width) return;
        small.drawImage(canvas, 0, 0, 16, 12);
        const pixels = small.getImageData(0, 0, 16, 12).data;
        // A mouth that stands still for a while rests.
        steady = before && pixels.every((v, k) => Math.abs(v - before[k]) <= 1) ? steady + 1 : 0;
        before = pixels;
        if (steady > 8 || !rest) rest = pixels;
        let most = 0;
        for (let k = 0; k < pixels.length; k++) most = Math.max(most, Math.abs(pixels[k] - rest[k]));
        window.seen.push([performance.now(), most]);
    };
    look();
";

pub(crate) fn run(sources: &[Device]) {
    println!(
        "| source | profile | look-ahead | median | least | most | heard of | pictures/s |\n|---|---|---|---|---|---|---|---|"
    );
    for from in sources.iter().copied() {
        for (profile, word) in [
            (Profile::Live, "live"),
            (Profile::Standard, "standard"),
            (Profile::Studio, "studio"),
        ] {
            one(from, profile, word);
        }
    }
}

fn one(from: Device, profile: Profile, word: &str) {
    let (samples, onsets) = sound();
    let mut bench = bench_as(Vec::new(), Drawn::Canvas);
    let path = bench.folder.path().join("vowels.wav");
    lipstream_media::sound::write(&path, &samples).unwrap();
    let (_, mut events) = bench.desk.hub().watch();
    bench.browser.evaluate(OBSERVER);
    bench.attach(from, Speech::File(path), false, profile);
    let (mut heard, mut lag): (Vec<(u64, f64)>, _) = (Vec::new(), 0.0);
    loop {
        match events.wait() {
            Ok(Event::Sound(piece)) => heard.push((piece.sample, piece.heard_ms)),
            Ok(Event::Hello(said)) => lag = f64::from(said.hello.lag_samples) / 16.0,
            Ok(Event::End(_)) => break,
            Ok(_) | Err(Missed::Slow(_)) => {}
            Err(Missed::Over) => panic!("the hub is gone"),
        }
    }
    std::thread::sleep(std::time::Duration::from_millis(500));
    let (ahead, _) = bench.clock_difference();
    let seen = bench.browser.evaluate("window.seen");
    let seen: Vec<(f64, f64)> = seen
        .as_array()
        .unwrap()
        .iter()
        .map(|pair| (pair[0].as_f64().unwrap() - ahead, pair[1].as_f64().unwrap()))
        .collect();
    let left_out = samples.len() as u64
        - heard
            .last()
            .map_or(0, |(sample, _)| sample + 160)
            .min(samples.len() as u64);
    let mut delays: Vec<f64> = onsets
        .iter()
        .filter_map(|onset| {
            // The sound is spoken evenly, whatever a device has no time for.
            let onset_ms = heard.first()?.1 + *onset as f64 / 16.0;
            let opened = seen
                .iter()
                .find(|(at, levels)| *at > onset_ms && *at < onset_ms + WITHIN_MS && *levels > LEVELS)?;
            Some(opened.0 - onset_ms)
        })
        .collect();
    delays.sort_by(f64::total_cmp);
    let seconds = (seen.last().unwrap().0 - seen[0].0) / 1000.0;
    let median = delays.get(delays.len() / 2).copied().unwrap_or(f64::NAN);
    println!(
        "| {} | `{word}` | {lag:.1} ms | {median:.0} ms | {:.0} ms | {:.0} ms | {} of {VOWELS}{} | {:.0} |",
        from.words(),
        delays.first().unwrap_or(&f64::NAN),
        delays.last().unwrap_or(&f64::NAN),
        delays.len(),
        match left_out {
            0 => String::new(),
            samples => format!(", {:.1} s of the sound left out", samples as f64 / 16_000.0),
        },
        seen.len() as f64 / seconds
    );
}
