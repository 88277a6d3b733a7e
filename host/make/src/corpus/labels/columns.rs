//! Label files of lines `start end label`: GRID's `.align`, TIMIT's `.phn` and `.wrd`, HTK's `.lab`.

use super::{Interval, Labels, phones_of, transcript, words_of};
use crate::corpus::phoneset;
use crate::error::{Context as _, Error, Result, bail};

/// GRID's time unit.
const GRID_HZ: f64 = 25_000.0;
/// TIMIT counts samples.
const SAMPLE_HZ: f64 = 16_000.0;
/// HTK counts 100 ns.
const HTK_HZ: f64 = 1e7;

/// A line's two times as written and the rest of its fields.
struct Line<'a> {
    start: f64,
    end: f64,
    fields: Vec<&'a str>,
}

/// Lines of two times and at least one field; empty lines are passed over.
fn lines(text: &str) -> Result<Vec<Line<'_>>> {
    let mut out = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let mut fields = line.split_whitespace();
        let Some(first) = fields.next() else { continue };
        let what = || format!("line {}: expected `start end label`, found {line:?}", number + 1);
        let start: f64 = first.parse().with_context(what)?;
        let end: f64 = fields
            .next()
            .ok_or_else(|| Error::Data(what()))?
            .parse()
            .with_context(what)?;
        let fields: Vec<_> = fields.collect();
        if fields.is_empty() {
            bail!(Data, "{}", what());
        }
        if !(start.is_finite() && end.is_finite() && 0.0 <= start && start <= end) {
            bail!(
                Data,
                "line {}: from {start} to {end} is no stretch of time",
                number + 1
            );
        }
        out.push(Line { start, end, fields });
    }
    Ok(out)
}

fn intervals(lines: &[Line], unit_hz: f64) -> Vec<Interval> {
    lines
        .iter()
        .map(|l| Interval {
            start: l.start / unit_hz,
            end: l.end / unit_hz,
            label: l.fields[0].to_owned(),
        })
        .collect()
}

/// GRID: words in 1/25000 s; single letters are letter names.
pub(super) fn grid(text: &str) -> Result<Labels> {
    Ok(Labels {
        words: words_of(&intervals(&lines(text)?, GRID_HZ), true),
        phones: Vec::new(),
    })
}

/// True for text in GRID's format: several lines of two integers and one word, starting at 0 with `sil`.
pub(super) fn is_grid(text: &str) -> bool {
    match lines(text) {
        Ok(lines) => {
            lines.len() > 1
                && lines[0].start == 0.0
                && lines[0].fields == ["sil"]
                && lines.iter().all(|l| l.fields.len() == 1)
        }
        Err(_) => false,
    }
}

/// TIMIT `.wrd`.
pub(super) fn timit_words(text: &str) -> Result<Labels> {
    Ok(Labels {
        words: words_of(&intervals(&lines(text)?, SAMPLE_HZ), false),
        phones: Vec::new(),
    })
}

/// TIMIT `.phn`.
pub(super) fn timit_phones(text: &str) -> Result<Labels> {
    Ok(Labels {
        words: Vec::new(),
        phones: phones_of(&intervals(&lines(text)?, SAMPLE_HZ))?,
    })
}

/// HTK `.lab`: phones if every label is a phone, else words; with HVite's fifth column, phones and words.
///
/// Times with a decimal point are seconds; whole numbers are 100 ns or samples at 16 kHz, whichever agrees
/// better with the sound's length. A file without times is a plain transcript.
pub(super) fn htk(text: &str, duration_s: f64) -> Result<Labels> {
    if text.trim_start().starts_with("#!MLF!#") {
        bail!(
            Data,
            "a master label file: write one .lab file for each clip (HTK: `HLEd -l DIR /dev/null FILE`)"
        );
    }
    if let Some(body) = festival_body(text) {
        return festival(body);
    }
    let timed = text
        .split_whitespace()
        .take(2)
        .filter(|t| t.parse::<f64>().is_ok());
    if timed.count() < 2 {
        return Ok(Labels {
            words: transcript::words(text),
            phones: Vec::new(),
        });
    }
    let lines = lines(text)?;
    let in_seconds = text.lines().any(|l| {
        l.split_whitespace()
            .take(2)
            .any(|field| field.contains(['.', 'e', 'E']))
    });
    let last = lines.iter().map(|l| l.end).fold(0.0, f64::max);
    let unit_hz = if in_seconds {
        1.0
    } else {
        let distance = |hz: f64| (last.max(1.0) / hz / duration_s.max(1e-3)).ln().abs();
        if distance(SAMPLE_HZ) < distance(HTK_HZ) {
            SAMPLE_HZ
        } else {
            HTK_HZ
        }
    };
    let mut spans = intervals(&lines, unit_hz);
    for span in &mut spans {
        span.label = base(&span.label);
    }
    if !spans.iter().all(|s| phoneset::is_phone_label(&s.label)) {
        return Ok(Labels {
            words: words_of(&spans, false),
            phones: Vec::new(),
        });
    }
    let mut words: Vec<Interval> = Vec::new();
    for (line, span) in lines.iter().zip(&spans) {
        match (line.fields.get(2), words.last_mut()) {
            (Some(word), _) => words.push(Interval {
                label: (*word).to_owned(),
                ..span.clone()
            }),
            (None, Some(last)) => last.end = span.end,
            (None, None) => {}
        }
    }
    Ok(Labels {
        words: words_of(&words, false),
        phones: phones_of(&spans)?,
    })
}

/// What follows the header of a label file of Festival and xwaves, which ends with a line `#`; None of another text. The line number of its first line is
/// given with it.
fn festival_body(text: &str) -> Option<(usize, &str)> {
    let mut start = 0;
    for (number, line) in text.split_inclusive('\n').enumerate() {
        start += line.len();
        if line.trim() == "#" {
            let body = &text[start..];
            let first = body.lines().find(|line| !line.trim().is_empty())?;
            return timed(first).map(|_| (number + 2, body));
        }
    }
    None
}

/// A line `end colour label`; the label may be missing or hold spaces.
fn timed(line: &str) -> Option<(f64, String)> {
    let mut fields = line.split_whitespace();
    let end = fields.next()?.parse().ok().filter(|end: &f64| end.is_finite())?;
    fields.next()?.parse::<u32>().ok()?;
    let label = fields.collect::<Vec<_>>().join(" ");
    // Further fields of a label stand behind a semicolon.
    let label = label.split(';').next().unwrap_or_default().trim();
    Some((end, label.to_owned()))
}

/// Festival's labels: each begins where the one before it ends.
fn festival((first, body): (usize, &str)) -> Result<Labels> {
    let (mut spans, mut last) = (Vec::new(), 0.0);
    for (number, line) in (first..).zip(body.lines()) {
        if line.trim().is_empty() {
            continue;
        }
        let Some((end, label)) = timed(line) else {
            bail!(Data, "line {number}: expected `end colour label`, found {line:?}");
        };
        if end < last {
            bail!(
                Data,
                "line {number}: it ends at {end} s, before the line above it"
            );
        }
        spans.push(Interval {
            start: last,
            end,
            label,
        });
        last = end;
    }
    let phones = spans.iter().all(|s| phoneset::is_phone_label(&s.label));
    Ok(Labels {
        words: if phones {
            Vec::new()
        } else {
            words_of(&spans, false)
        },
        phones: if phones { phones_of(&spans)? } else { Vec::new() },
    })
}

/// The phone inside an HTK context name `left-phone+right`, without quotes; other labels as they are.
fn base(label: &str) -> String {
    let label = label.trim_matches(['"', '\'']);
    if phoneset::is_phone_label(label) {
        return label.to_owned();
    }
    let inner = label.split_once('-').map_or(label, |(_, rest)| rest);
    let inner = inner.split_once('+').map_or(inner, |(phone, _)| phone);
    if inner != label && phoneset::is_phone_label(inner) {
        inner.to_owned()
    } else {
        label.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use crate::corpus::labels::parse;
    use crate::error::chain;

    #[test]
    fn grid_words_and_letters() {
        let text = "0 9250 sil\r\n9250 21500 lay\r\n21500 25000 a\r\n25000 26000 sp\r\n26000 74500 sil\r\n";
        for extension in ["align", "txt"] {
            let labels = parse(extension, text, 3.0).unwrap();
            assert_eq!(labels.words.len(), 2, "{extension}");
            assert_eq!(labels.words[0].text, "lay");
            assert_eq!(labels.words[0].time, Some((0.37, 0.86)));
            assert!(!labels.words[0].letter_name);
            assert!(labels.words[1].letter_name);
            assert!(labels.phones.is_empty());
        }
    }

    #[test]
    fn bad_lines_are_named() {
        for (text, line) in [
            ("0 1 sil\n0 x lay\n", "line 2"),
            ("0 1\n", "line 1"),
            ("0 1 a\n5 2 b\n", "line 2"),
            ("0 1 a\n-5 2 b\n", "line 2"),
            ("0 nan a\n", "line 1"),
        ] {
            let error = chain(&parse("align", text, 3.0).unwrap_err());
            assert!(error.contains(line), "{error}");
            assert!(!error.contains('\n'), "{error}");
        }
        let error = chain(&parse("phn", "0 100 zz\n", 3.0).unwrap_err());
        assert!(error.contains("\"zz\""), "{error}");
    }

    #[test]
    fn htk_units_follow_the_length_of_the_sound() {
        let in_100ns = parse("lab", "0 5000000 sil\n5000000 10000000 aa\n", 1.0).unwrap();
        let in_samples = parse("lab", "0 8000 sil\n8000 16000 aa\n", 1.0).unwrap();
        let in_seconds = parse("lab", "0.0 0.5 sil\n0.5 1.0 aa\n", 1.0).unwrap();
        assert_eq!(in_100ns, in_samples);
        assert_eq!(in_100ns, in_seconds);
        assert_eq!(in_100ns.phones[1].0, 0.5);
        assert!(in_100ns.words.is_empty());
    }

    #[test]
    fn festivals_labels_are_ends_behind_a_header() {
        let phones =
            "separator ;\nnfields 1\n#\n0.25 125 pau\n0.4 125 p\n0.6 125 iy ; stress 1\n1.0 125 h#\n";
        for text in [phones.to_owned(), phones.replace('\n', "\r\n")] {
            let labels = parse("lab", &text, 1.0).unwrap();
            let names: Vec<_> = labels.phones.iter().map(|p| p.2.name()).collect();
            assert_eq!(names, ["sil", "p", "iy", "sil"]);
            assert_eq!((labels.phones[1].0, labels.phones[1].1), (0.25, 0.4));
            assert!(labels.words.is_empty());
        }
        let words = parse("lab", "#\n0.3 26 \n0.6 26 hello\n0.9 26 you\n", 1.0).unwrap();
        let spoken: Vec<_> = words.words.iter().map(|w| (w.text.as_str(), w.time)).collect();
        assert_eq!(spoken, [("hello", Some((0.3, 0.6))), ("you", Some((0.6, 0.9)))]);
        for (text, line) in [
            ("#\n0.3 26 p\n0.2 26 iy\n", "line 3"),
            ("a\n#\n0.3 26 p\nx 26 iy\n", "line 4"),
        ] {
            let error = chain(&parse("lab", text, 1.0).unwrap_err());
            assert!(error.contains(line), "{error}");
        }
        // A number sign in a transcript is no header.
        assert_eq!(parse("lab", "number\n#\none\n", 1.0).unwrap().words.len(), 2);
    }

    /// A file in samples of 8 kHz, and one in seconds, where samples of 16 kHz are meant.
    #[test]
    fn times_in_another_unit_are_refused() {
        for (extension, text) in [
            ("phn", "0 8000 h#\n8000 12000 iy\n12000 16000 h#\n"),
            ("phn", "0 1 h#\n1 2 iy\n"),
            ("wrd", "0.2 0.8 hello\n0.8 1.9 you\n"),
        ] {
            let error = chain(&parse(extension, text, 2.0).unwrap_err());
            assert!(error.contains("but the sound at 2.00 s"), "{error}");
        }
        // Silence after the last word is no other unit.
        parse("wrd", "3000 8000 hello\n", 2.0).unwrap();
    }

    #[test]
    fn htk_words_phones_and_both() {
        let words = parse("lab", "0 5000000 sil\n5000000 10000000 lay\n", 1.0).unwrap();
        assert_eq!(words.words[0].text, "lay");
        assert!(words.phones.is_empty());

        let text = "0 2000000 sil -10.5 sil\n2000000 4000000 sil-l+ey -3 LAY\n4000000 6000000 l-ey+sp -3\n\
                    6000000 9000000 b -3 BE\n9000000 10000000 iy -3\n";
        let both = parse("lab", text, 1.0).unwrap();
        let spoken: Vec<_> = both.words.iter().map(|w| (w.text.as_str(), w.time)).collect();
        assert_eq!(spoken, [("lay", Some((0.2, 0.6))), ("be", Some((0.6, 1.0)))]);
        let names: Vec<_> = both.phones.iter().map(|p| p.2.name()).collect();
        assert_eq!(names, ["sil", "l", "ey", "b", "iy"]);

        let transcript = parse("lab", "Hello there, you!\n", 1.0).unwrap();
        assert_eq!(transcript.words.len(), 3);
        assert!(parse("lab", "#!MLF!#\n\"*/a.lab\"\n", 1.0).is_err());
    }
}
