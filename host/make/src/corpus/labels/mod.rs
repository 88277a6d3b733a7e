//! Labels of a clip: words and phones with their times, from the formats that speech corpora come in.
//!
//! | file | format | times |
//! |---|---|---|
//! | `.align` | GRID: `start end word` | 1/25000 s |
//! | `.phn`, `.wrd` | TIMIT: `start end label` | samples at 16 kHz |
//! | `.lab` | HTK: `start end label [score [word]]`, or a plain transcript | 100 ns, samples or seconds |
//! | `.lab` | Festival, xwaves: a header up to a line `#`, then `end colour label` | seconds |
//! | `.TextGrid` | Praat, long or short text, UTF-8 or UTF-16 | seconds |
//! | `.txt` | a plain transcript, TIMIT's `0 n text`, or a GRID `.align` under another name | none |
use std::collections::HashMap;
use std::path::Path;

use lipstream_core::SAMPLE_RATE_HZ;

use super::phoneset;
use crate::error::{Context as _, Error, Result, bail};
use crate::features::PhoneLabel;
use lipstream::phones::Phone;
use lipstream_media::files;

mod columns;
pub mod subtitles;
mod textgrid;
pub mod transcript;

/// Label files by extension (lower case), the best source of words first.
pub const EXTENSIONS: [&str; 6] = ["wrd", "textgrid", "align", "lab", "phn", "txt"];

/// Larger files are no labels.
const MAX_BYTES: u64 = 16 << 20;

/// How far (s) labels may reach past the end of the sound before they are taken for another clip's.
const OVERHANG_S: f64 = 0.5;

/// Share of a sound that its phones, silences counted, reach at least; samples of 8 kHz taken for 16 kHz reach half of it.
const PHONES_COVER: f64 = 0.75;
/// Share of a sound in which its last word has been said at least; silence may follow.
const WORDS_COVER: f64 = 0.1;

/// How far (s) a phone may begin before the one before it has ended: a frame and its neighbour, which is what rounding makes.
const PHONES_OVERLAP_S: f64 = 0.02;

/// One stretch of time with its label, in seconds.
#[derive(Clone, Debug, PartialEq)]
pub struct Interval {
    /// Where it begins, in seconds.
    pub start: f64,
    /// Where it ends, in seconds.
    pub end: f64,
    /// What the file says there.
    pub label: String,
}

/// A word as labelled.
#[derive(Clone, Debug, PartialEq)]
pub struct SpokenWord {
    /// Lower case, no punctuation but apostrophes.
    pub text: String,
    /// Start and end in seconds; `None` where the file has no times.
    pub time: Option<(f64, f64)>,
    /// A single letter that is spoken as its name ("a" as in the alphabet), as in GRID.
    pub letter_name: bool,
}

/// What the label files of one clip say. Silences are no words; they are phones.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Labels {
    /// The words in the order in which they are said.
    pub words: Vec<SpokenWord>,
    /// Start and end in seconds.
    pub phones: Vec<(f64, f64, Phone)>,
}

impl Labels {
    /// Moves all times by so many seconds, within a sound that lasts `duration_s`; phones of which nothing is left go.
    pub(super) fn move_by(&mut self, seconds: f64, duration_s: f64) {
        let moved = |time: f64| (time + seconds).clamp(0.0, duration_s);
        if seconds == 0.0 {
            return;
        }
        for (from, to) in self.words.iter_mut().filter_map(|word| word.time.as_mut()) {
            (*from, *to) = (moved(*from), moved(*to));
        }
        for (from, to, _) in &mut self.phones {
            (*from, *to) = (moved(*from), moved(*to));
        }
        self.phones.retain(|(from, to, _)| to > from);
    }
}

/// Reads the label files of one clip whose sound lasts `duration_s`.
///
/// Words come from the first file in the order of [`EXTENSIONS`] that has any, so do phones.
pub fn read<P: AsRef<Path>>(paths: &[P], duration_s: f64) -> Result<Labels> {
    let mut labels = Labels::default();
    let mut sorted: Vec<(usize, &Path)> = Vec::new();
    for path in paths {
        let path = path.as_ref();
        let rank = extension(path).and_then(|e| EXTENSIONS.iter().position(|x| *x == e));
        match rank {
            Some(rank) => sorted.push((rank, path)),
            None => bail!(Choice, "{}: no label format has this extension", path.display()),
        }
    }
    sorted.sort();
    for (_, path) in sorted {
        let read = read_one(path, duration_s).with_context(|| format!("labels {}", path.display()))?;
        if labels.words.is_empty() {
            labels.words = read.words;
        }
        if labels.phones.is_empty() {
            labels.phones = read.phones;
        }
    }
    Ok(labels)
}

fn extension(path: &Path) -> Option<String> {
    Some(path.extension()?.to_str()?.to_lowercase())
}

fn read_one(path: &Path, duration_s: f64) -> Result<Labels> {
    let size = std::fs::metadata(path)?.len();
    if size > MAX_BYTES {
        bail!(Data, "{size} bytes are too many for a label file");
    }
    let text = decode(&std::fs::read(path)?)?;
    parse(&extension(path).unwrap_or_default(), &text, duration_s)
}

/// Parses the text of a label file with that (lower-case) extension.
pub fn parse(extension: &str, text: &str, duration_s: f64) -> Result<Labels> {
    let mut labels = match extension {
        "align" => columns::grid(text)?,
        "phn" => columns::timit_phones(text)?,
        "wrd" => columns::timit_words(text)?,
        "lab" => columns::htk(text, duration_s)?,
        "textgrid" => textgrid::labels(text)?,
        // GRID's own archives name some of their word times .txt.
        "txt" if columns::is_grid(text) => columns::grid(text)?,
        "txt" => Labels {
            words: transcript::words(transcript::without_timit_head(text)),
            phones: Vec::new(),
        },
        other => bail!(Choice, "`.{other}` is no label format"),
    };
    fit(&mut labels, duration_s)?;
    if matches!(extension, "phn" | "lab" | "wrd" | "align") {
        check_units(&labels, duration_s)?;
    }
    Ok(labels)
}

/// Refuses times whose unit seems to be another: phones that end long before the sound does, words that are all in its first moments. Formats that
/// count samples do not say at which rate.
fn check_units(labels: &Labels, duration_s: f64) -> Result<()> {
    let latest = |ends: &mut dyn Iterator<Item = f64>| ends.reduce(f64::max);
    let phones = latest(&mut labels.phones.iter().map(|p| p.1));
    let words = latest(&mut labels.words.iter().filter_map(|w| Some(w.time?.1)));
    for (end, share) in [(phones, PHONES_COVER), (words, WORDS_COVER)] {
        if let Some(end) = end.filter(|end| *end < share * duration_s && duration_s - end > OVERHANG_S) {
            bail!(
                Data,
                "labels end at {end:.2} s, but the sound at {duration_s:.2} s: are they this clip's, and are their times in the format's unit?"
            );
        }
    }
    Ok(())
}

/// Phones of many clips from one table: a line `clip start end phone` for each, times in samples at 16 kHz, columns parted by tabs or spaces.
/// A first line whose times are no numbers is a heading. The phones are in the names of any of the phone sets.
///
/// # Errors
///
/// That the file cannot be read, and which line is none of these.
pub fn read_table(path: &Path) -> Result<HashMap<String, Vec<PhoneLabel>>> {
    let bytes = files::read_text(path).map_err(Error::other)?;
    let text = decode(&bytes)?;
    table(&text).with_context(|| format!("labels {}", path.display()))
}

fn table(text: &str) -> Result<HashMap<String, Vec<PhoneLabel>>> {
    let mut clips: HashMap<String, Vec<PhoneLabel>> = HashMap::new();
    for (number, line) in (1..).zip(text.lines()) {
        let columns: Vec<&str> = line.split_whitespace().collect();
        let row = match columns[..] {
            [] => continue,
            [clip, start, end, label] => start
                .parse::<u32>()
                .ok()
                .zip(end.parse().ok())
                .map(|t| (clip, t, label)),
            _ => None,
        };
        let Some((clip, (start, end), label)) = row else {
            if number == 1 {
                continue;
            }
            bail!(Data, "line {number}: {line:?} is no clip, start, end and phone");
        };
        let Some(phone) = phoneset::phone(label) else {
            bail!(
                Data,
                "line {number}: {label:?} is no phone of the TIMIT, CMU or X&L sets"
            );
        };
        if end <= start {
            bail!(Data, "line {number}: the phone ends before it begins");
        }
        let seconds = |samples: u32| samples as f32 / SAMPLE_RATE_HZ as f32;
        clips.entry(clip.to_owned()).or_default().push(PhoneLabel {
            phone: phone.name().to_owned(),
            start: seconds(start),
            end: seconds(end),
        });
    }
    if clips.is_empty() {
        bail!(Data, "there is no label in it");
    }
    Ok(clips)
}

/// Bytes of a text file to a string: UTF-8, UTF-16 with a byte order mark, or (old label files) Latin-1.
pub fn decode(bytes: &[u8]) -> Result<String> {
    let wide = |unit: fn([u8; 2]) -> u16| -> Result<String> {
        if !bytes.len().is_multiple_of(2) {
            bail!(Data, "UTF-16 text with half a character at its end");
        }
        let units = bytes[2..].chunks_exact(2).map(|b| unit([b[0], b[1]]));
        char::decode_utf16(units)
            .collect::<Result<String, _>>()
            .context("damaged UTF-16 text")
    };
    match bytes {
        [0xFF, 0xFE, ..] => wide(u16::from_le_bytes),
        [0xFE, 0xFF, ..] => wide(u16::from_be_bytes),
        _ => {
            let bytes = bytes.strip_prefix(&[0xEF, 0xBB, 0xBF]).unwrap_or(bytes);
            if bytes.contains(&0) {
                bail!(Data, "not a text file");
            }
            Ok(match std::str::from_utf8(bytes) {
                Ok(text) => text.to_owned(),
                Err(_) => bytes.iter().map(|b| char::from(*b)).collect(),
            })
        }
    }
}

/// Words from intervals: silences are left out; an interval of several words gives words without times.
pub(super) fn words_of(intervals: &[Interval], letter_names: bool) -> Vec<SpokenWord> {
    let mut words = Vec::new();
    for interval in intervals {
        if phoneset::is_silence(&interval.label) {
            continue;
        }
        let mut tokens = transcript::words(&interval.label);
        if let [one] = tokens.as_mut_slice() {
            one.time = Some((interval.start, interval.end));
            one.letter_name = letter_names && one.text.chars().count() == 1;
        }
        words.append(&mut tokens);
    }
    words
}

/// Phones from intervals in any of the phone sets; the error names the label that none of them has.
pub(super) fn phones_of(intervals: &[Interval]) -> Result<Vec<(f64, f64, Phone)>> {
    // One sign of the phonetic alphabet tells how the plain letters beside it are meant.
    let in_ipa = intervals.iter().any(|i| phoneset::is_ipa(&i.label));
    let labels: Vec<_> = intervals
        .iter()
        .map(|i| {
            let ipa = phoneset::ipa(&i.label).filter(|_| in_ipa);
            (i.start, i.end, ipa.unwrap_or(&i.label).to_owned())
        })
        .collect();
    phoneset::timit(&labels)
        .map_err(|label| Error::Data(format!("{label:?} is no phone of the TIMIT, CMU or X&L sets")))
}

/// Refuses times out of order and labels that do not belong to a sound of this length; cuts a small overhang.
fn fit(labels: &mut Labels, duration_s: f64) -> Result<()> {
    let spans = labels
        .words
        .iter_mut()
        .filter_map(|w| w.time.as_mut().map(|t| (&mut t.0, &mut t.1)));
    cut(spans, duration_s)?;
    cut(labels.phones.iter_mut().map(|p| (&mut p.0, &mut p.1)), duration_s)?;
    for pair in labels.phones.windows(2) {
        let ((_, end, before), (start, _, phone)) = (pair[0], pair[1]);
        if end - start > PHONES_OVERLAP_S {
            bail!(
                Data,
                "{} begins at {start:.2} s, but {} before it ends at {end:.2} s: one phone follows the other",
                phone.name(),
                before.name()
            );
        }
    }
    labels.words.retain(|w| w.time.is_none_or(|(s, e)| e > s));
    labels.phones.retain(|(s, e, _)| e > s);
    Ok(())
}

fn cut<'a>(spans: impl Iterator<Item = (&'a mut f64, &'a mut f64)>, duration_s: f64) -> Result<()> {
    let mut last = 0.0f64;
    for (start, end) in spans {
        if !start.is_finite() || !end.is_finite() || *start < 0.0 || *end < *start {
            bail!(Data, "a label reaches from {start} s to {end} s");
        }
        if *start < last {
            bail!(
                Data,
                "the label that starts at {start} s comes after one that starts at {last} s"
            );
        }
        last = *start;
        if *end > duration_s + OVERHANG_S {
            bail!(
                Data,
                "labels reach to {end:.2} s, but the sound ends at {duration_s:.2} s: are they this clip's?"
            );
        }
        *end = end.min(duration_s);
        *start = start.min(duration_s);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::chain;

    fn texts(labels: &Labels) -> Vec<&str> {
        labels.words.iter().map(|w| w.text.as_str()).collect()
    }

    #[test]
    fn text_encodings() {
        let plain = "aé";
        let le: Vec<u8> = [0xFF, 0xFE]
            .into_iter()
            .chain(plain.encode_utf16().flat_map(u16::to_le_bytes))
            .collect();
        let be: Vec<u8> = [0xFE, 0xFF]
            .into_iter()
            .chain(plain.encode_utf16().flat_map(u16::to_be_bytes))
            .collect();
        assert_eq!(decode(&le).unwrap(), plain);
        assert_eq!(decode(&be).unwrap(), plain);
        assert_eq!(decode(plain.as_bytes()).unwrap(), plain);
        assert_eq!(decode(b"\xEF\xBB\xBFab").unwrap(), "ab");
        assert_eq!(decode(b"a\xE9").unwrap(), plain);
        assert!(decode(&le[..le.len() - 1]).is_err());
        assert!(decode(&[0xFF, 0xFE, 0x00, 0xD8]).is_err());
        assert!(decode(b"a\0b").is_err());
    }

    #[test]
    fn words_come_from_the_best_file_and_phones_from_another() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            path
        };
        let paths = [
            write("a.txt", "Other words here."),
            write(
                "a.phn",
                "0 8000 h#\n8000 12000 hh\n12000 16000 iy\n16000 24000 h#\n",
            ),
            write("a.wrd", "8000 16000 he\n"),
        ];
        let labels = read(&paths, 1.5).unwrap();
        assert_eq!(texts(&labels), ["he"]);
        assert_eq!(labels.words[0].time, Some((0.5, 1.0)));
        let names: Vec<_> = labels.phones.iter().map(|p| p.2.name()).collect();
        assert_eq!(names, ["sil", "hh", "iy", "sil"]);
        assert!(read(&[folder.path().join("a.doc")], 1.0).is_err());
    }

    #[test]
    fn phones_that_overlap_are_refused_with_their_names() {
        let two = |start: u32| parse("lab", &format!("0 20000000 ah\n{start} 42000000 l\n"), 4.2);
        let error = chain(&two(10_000_000).unwrap_err());
        assert!(
            error.contains("l begins at 1.00 s, but ah before it ends at 2.00 s"),
            "{error}"
        );
        assert_eq!(two(19_900_000).unwrap().phones.len(), 2);
        assert_eq!(two(20_000_000).unwrap().phones.len(), 2);
    }

    #[test]
    fn labels_of_another_clip_are_refused() {
        assert!(parse("wrd", "0 16000 one\n16000 160000 two\n", 1.2).is_err());
        let labels = parse("wrd", "0 16000 one\n16000 20000 two\n", 1.2).unwrap();
        assert_eq!(labels.words[1].time, Some((1.0, 1.2)));
        assert!(parse("wrd", "16000 20000 two\n0 16000 one\n", 2.0).is_err());
    }

    #[test]
    fn bad_files_are_named_with_place_and_reason() {
        let grid = "File type = \"ooTextFile\"\nObject class = \"TextGrid\"\n\n0\n1\n<exists>\n1\n\"IntervalTier\"\n\
                    \"words\"\n0\n1\n1\n0\n1\n\"hey\"\n";
        let wide: Vec<u8> = [0xFF, 0xFE]
            .into_iter()
            .chain(
                grid.replace("<exists>", "yes")
                    .encode_utf16()
                    .flat_map(u16::to_le_bytes),
            )
            .collect();
        let bytes = |text: &str| text.as_bytes().to_vec();
        let cases = [
            (
                "a.align",
                bytes("0 9250 sil\n9250 lay\n"),
                "line 2: expected `start end label`",
            ),
            ("b.phn", bytes("0 8000 h#\n8000 9000 qq\n"), "\"qq\" is no phone"),
            (
                "c.wrd",
                bytes("0 8000 she\n9000 8500 had\n"),
                "line 2: from 9000 to 8500",
            ),
            (
                "d.wrd",
                bytes("0 8000 she\n8000 99999 had\n"),
                "are they this clip's?",
            ),
            (
                "e.lab",
                bytes("0 5000000 sil\n5000000 x aa\n"),
                "line 2: expected `start end label`",
            ),
            ("f.lab", bytes("#!MLF!#\n"), "write one .lab file for each clip"),
            (
                "g.TextGrid",
                bytes(&grid.replace("\n\"hey\"\n", "\n")),
                "ends after line 14 where the text",
            ),
            (
                "h.TextGrid",
                bytes(&grid.replace("<exists>", "7")),
                "line 6: expected <exists>, found 7",
            ),
            ("i.TextGrid", wide, "expected <exists>, found 1"),
            (
                "j.TextGrid",
                bytes("ooBinaryFile"),
                "save it in Praat as a text file",
            ),
            (
                "k.TextGrid",
                bytes(&grid.replace("\"hey\"", "\"hey")),
                "line 15: a text without its closing quote",
            ),
            ("l.txt", vec![b'a', 0, b'b'], "not a text file"),
            ("m.txt", vec![0xFF, 0xFE, 0x61], "half a character"),
        ];
        let folder = tempfile::tempdir().unwrap();
        for (name, content, says) in cases {
            let path = folder.path().join(name);
            std::fs::write(&path, content).unwrap();
            let error = chain(&read(&[&path], 1.0).unwrap_err());
            assert!(error.contains(name) && error.contains(says), "{name}: {error}");
            assert!(!error.contains('\n'), "{error}");
        }
    }

    #[test]
    fn a_table_has_the_phones_of_many_clips() {
        let text = "clip\tstart\tend\tphone\na\t0\t1600\tsil\na\t1600\t3200\tAH0\nb\t0\t800\th#\n\n";
        let clips = table(text).unwrap();
        let told = |clip: &str| -> Vec<(String, f32, f32)> {
            let labels = clips[clip].iter();
            labels.map(|l| (l.phone.clone(), l.start, l.end)).collect()
        };
        assert_eq!(told("a"), [("sil".into(), 0.0, 0.1), ("ax".into(), 0.1, 0.2)]);
        assert_eq!(told("b"), [("sil".into(), 0.0, 0.05)]);
        for (text, says) in [
            ("a 0 1 b\na 1 2", "line 2"),
            ("a 0 1 b\na 1 2 qq", "\"qq\" is no phone"),
            ("a 5 5 b", "ends before it begins"),
            ("clip start end phone", "no label"),
        ] {
            let error = table(text).unwrap_err().to_string();
            assert!(error.contains(says), "{text:?}: {error}");
        }
    }

    #[test]
    fn nothing_that_is_cut_or_mixed_up_makes_a_parser_panic() {
        let samples = [
            ("align", "0 9250 sil\r\n9250 21500 lay\r\n"),
            ("phn", "0 8000 h#\n8000 12000 hh\n"),
            ("lab", "0 1000000 sil -3.5 sil\n1000000 3000000 l -1 LAY\n"),
            ("txt", "0 38504 Would a tomboy often play outdoors?"),
            (
                "textgrid",
                "File type = \"ooTextFile\"\nObject class = \"TextGrid\"\n\n0\n1\n<exists>\n1\n\"IntervalTier\"\n\
                 \"words\"\n0\n1\n1\n0\n1\n\"hé\"\n",
            ),
        ];
        for (extension, text) in samples {
            for (i, _) in text.char_indices() {
                let _ = parse(extension, &text[..i], 2.0);
                let _ = parse(extension, &text[i..], 2.0);
                let noisy = format!("{}-9e99 {}", &text[..i], &text[i..]);
                let _ = parse(extension, &noisy, 2.0);
            }
        }
    }
}
