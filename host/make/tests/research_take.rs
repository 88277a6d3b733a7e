//! A long take with a text without times: GRID clips one after the other, whose words and phones are known. Needs LIPSTREAM_RESEARCH and `ffmpeg`.
//!
//!     cargo test -p lipstream-make --test research_take -- --ignored --nocapture
use std::path::Path;

use lipstream_make::align::judge::{Judgement, table};
use lipstream_make::align::{Alignment, Spoken};
use lipstream_make::corpus::{self, PrepareSettings, Summary, labels};
use lipstream_make::features::{Clip, FeatureFolder, PhoneLabel, PhonesFrom};
use lipstream_media::{sound, video};

use lipstream::phones::Phone;

mod common;

/// The take: its samples, its words with the middle of each in seconds, its phones.
struct Take {
    samples: Vec<i16>,
    words: Vec<(String, f64)>,
    phones: Vec<PhoneLabel>,
}

fn take(grid: &Path, clips: usize) -> Take {
    let table = labels::read_table(&grid.join("phones-auto.tsv")).unwrap();
    let mut take = Take {
        samples: Vec::new(),
        words: Vec::new(),
        phones: Vec::new(),
    };
    for path in common::videos(&grid.join("test")).iter().take(clips) {
        let begins = take.samples.len() as f64 / 16_000.0;
        let heard = sound::decode(&video::decode_sound(path).unwrap()).unwrap();
        let said = labels::read(&[path.with_extension("align")], heard.seconds()).unwrap();
        take.words.extend(said.words.into_iter().map(|word| {
            let (start, end) = word.time.unwrap();
            (word.text, begins + 0.5 * (start + end))
        }));
        let id = path.file_stem().unwrap().to_str().unwrap();
        take.phones.extend(table[id].iter().map(|label| PhoneLabel {
            start: label.start + begins as f32,
            end: label.end + begins as f32,
            ..label.clone()
        }));
        take.samples.extend(heard.samples);
    }
    take
}

fn prepared(root: &Path, take: &Take, text: Option<&str>) -> (Summary, FeatureFolder) {
    std::fs::create_dir_all(root).unwrap();
    let wav = root.join("take.wav");
    sound::write(&wav, &take.samples).unwrap();
    if let Some(text) = text {
        std::fs::write(root.join("take.txt"), text).unwrap();
    }
    let settings = PrepareSettings {
        corpus: wav,
        out: root.join("features"),
        ..Default::default()
    };
    let summary = corpus::prepare(&settings, &|line: &str| println!("{line}")).unwrap();
    (summary, FeatureFolder::open(&settings.out).unwrap())
}

/// Where a piece begins in the take, in seconds.
fn place(take: &Take, folder: &FeatureFolder, clip: &Clip) -> (f64, f64) {
    let piece = sound::read(&folder.wav_path(&clip.id)).unwrap().samples;
    let mut windows = take.samples.windows(piece.len());
    let from = windows.position(|window| window == piece).unwrap() as f64 / 16_000.0;
    (from, from + piece.len() as f64 / 16_000.0)
}

/// Words that are in the piece that they are said in, and all words of the pieces that were kept; and the phones against the labels.
fn judged(take: &Take, folder: &FeatureFolder) -> (usize, usize, Judgement) {
    let (mut right, mut all, mut phones) = (0, 0, Judgement::default());
    for clip in &folder.manifest.clips {
        let (from, to) = place(take, folder, clip);
        let said: Vec<&str> = take
            .words
            .iter()
            .filter(|(_, middle)| (from..to).contains(middle))
            .map(|(text, _)| text.as_str())
            .collect();
        let mut rest = said.as_slice();
        for word in &clip.words {
            if let Some(at) = rest.iter().position(|text| *text == word.text) {
                rest = &rest[at + 1..];
                right += 1;
            }
        }
        // A piece of which the text says nothing is recognised; it has no wrong words.
        if !clip.words.is_empty() {
            all += said.len().max(clip.words.len());
        }
        let labels: Vec<PhoneLabel> = take
            .phones
            .iter()
            .map(|l| PhoneLabel {
                start: (l.start - from as f32).max(0.0),
                end: l.end.min(to as f32) - from as f32,
                ..l.clone()
            })
            .filter(|l| l.end > l.start)
            .collect();
        let found = Alignment {
            duration: to - from,
            phones: clip.phones.iter().map(spoken).collect(),
            ..Alignment::default()
        };
        phones.add(&labels, &found);
    }
    (right, all, phones)
}

fn spoken(label: &PhoneLabel) -> Spoken {
    Spoken {
        phone: Phone::from_name(&label.phone).unwrap(),
        start: label.start.into(),
        end: label.end.into(),
        word: None,
        score: 0.0,
    }
}

#[test]
#[ignore = "needs the research data: tests/run --research"]
fn words_of_a_take_find_their_pieces() {
    let grid = common::data().join("grid-s1");
    let take = take(&grid, 24);
    let folder = tempfile::tempdir().unwrap();
    let words: Vec<&str> = take.words.iter().map(|(text, _)| text.as_str()).collect();

    let (summary, features) = prepared(&folder.path().join("right"), &take, Some(&words.join(" ")));
    let (right, all, phones) = judged(&take, &features);
    let pieces = features.manifest.clips.len();
    println!(
        "right text: {pieces} pieces, {} left out, {right} of {all} words in their piece",
        summary.skipped.len()
    );
    assert!(right as f64 > 0.97 * all as f64 && pieces > 10 * summary.skipped.len());
    assert!(
        features
            .manifest
            .clips
            .iter()
            .all(|c| c.phones_from == PhonesFrom::Aligned)
    );
    println!("{}", table(&[("from the text", phones.summary().unwrap())]));
    assert!(phones.summary().unwrap().error_rate < 0.1);

    // Every twentieth word is another one, every thirtieth is missing, and two sentences of the take are not in the text.
    let mut damaged = Vec::new();
    for (n, word) in words.iter().enumerate() {
        match (n / 6 == 8 || n / 6 == 15, n % 30 == 7, n % 20 == 3) {
            (true, _, _) | (_, true, _) => {}
            (_, _, true) => damaged.push("umbrella"),
            _ => damaged.push(word),
        }
    }
    let (summary, features) = prepared(&folder.path().join("damaged"), &take, Some(&damaged.join(" ")));
    let (right, all, phones) = judged(&take, &features);
    println!(
        "damaged text: {} pieces, {} left out, {right} of {all} words right in their piece",
        features.manifest.clips.len(),
        summary.skipped.len()
    );
    println!(
        "{}",
        table(&[("from the damaged text", phones.summary().unwrap())])
    );
    assert!(
        summary
            .skipped
            .iter()
            .all(|s| s.reason.contains("do not fit what is heard"))
    );
    assert!(right as f64 > 0.9 * all as f64, "{right} of {all}");

    // Without a text nothing is left out.
    let (summary, features) = prepared(&folder.path().join("none"), &take, None);
    assert!(summary.skipped.is_empty());
    assert!(
        features
            .manifest
            .clips
            .iter()
            .all(|c| c.phones_from == PhonesFrom::Recognised)
    );
    let (_, _, phones) = judged(&take, &features);
    println!("{}", table(&[("recognised", phones.summary().unwrap())]));
    assert!(phones.summary().unwrap().error_rate < 0.3);
}
