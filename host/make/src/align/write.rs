//! Alignments as label files: HTK, Praat, TIMIT, JSON. What is written here is read again by `corpus::labels`.
use std::fmt::Write as _;
use std::path::Path;

use crate::error::{Error, Result};
use lipstream_core::SAMPLE_RATE_HZ;
use serde::Serialize;

use super::{Alignment, Spoken};
use lipstream::phones::Phone;
use lipstream_media::files;

/// A label format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// HTK: start and end in 100 ns, phone, score, and the word at its first phone
    Lab,
    /// Praat: tiers "words" and "phones"
    Textgrid,
    /// TIMIT: phones in samples, the words in a .wrd file beside it
    Phn,
    /// Times in seconds
    Json,
}

impl Format {
    /// By a file's extension.
    pub fn of_extension(extension: &str) -> Option<Self> {
        match extension.to_lowercase().as_str() {
            "lab" => Some(Format::Lab),
            "textgrid" => Some(Format::Textgrid),
            "phn" => Some(Format::Phn),
            "json" => Some(Format::Json),
            _ => None,
        }
    }

    /// Usual ending of a file of this format, without the dot.
    pub fn extension(self) -> &'static str {
        match self {
            Format::Lab => "lab",
            Format::Textgrid => "TextGrid",
            Format::Phn => "phn",
            Format::Json => "json",
        }
    }

    /// The text of a file of this format; of [`Format::Phn`] the phones alone.
    ///
    /// # Errors
    ///
    /// What the JSON writer says.
    pub fn text(self, alignment: &Alignment) -> Result<Vec<u8>> {
        Ok(match self {
            Format::Lab => lab(alignment).into_bytes(),
            Format::Textgrid => textgrid(alignment).into_bytes(),
            Format::Json => json(alignment)?,
            Format::Phn => phn(alignment).into_bytes(),
        })
    }

    /// Writes `alignment` to `path` (and its words beside it where the format has them apart).
    pub fn write(self, path: &Path, alignment: &Alignment) -> Result<()> {
        let put = |path: &Path, bytes: &[u8]| files::write_bytes(path, bytes).map_err(Error::other);
        put(path, &self.text(alignment)?)?;
        match self {
            Format::Phn => put(&path.with_extension("wrd"), wrd(alignment).as_bytes()),
            _ => Ok(()),
        }
    }
}

fn units(seconds: f64, hz: f64) -> u64 {
    (seconds * hz).round() as u64
}

/// HTK as HVite writes it: `start end phone score [word]`.
pub fn lab(alignment: &Alignment) -> String {
    let mut out = String::new();
    let mut word = None;
    for p in &alignment.phones {
        let (start, end) = (units(p.start, 1e7), units(p.end, 1e7));
        let _ = write!(out, "{start} {end} {} {:.4}", p.phone.name(), p.score);
        if p.word != word || p.word.is_none() {
            let text = p.word.and_then(|w| alignment.text(w)).unwrap_or(p.phone.name());
            let _ = write!(out, " {text}");
        }
        word = p.word;
        out.push('\n');
    }
    out
}

/// TIMIT's `.phn`: `start end phone` in samples, silence as h#, pauses as pau.
pub fn phn(alignment: &Alignment) -> String {
    let mut out = String::new();
    for p in &alignment.phones {
        let name = match p.phone {
            Phone::SIL => "h#",
            Phone::SP => "pau",
            other => other.name(),
        };
        let hz = f64::from(SAMPLE_RATE_HZ);
        let _ = writeln!(out, "{} {} {name}", units(p.start, hz), units(p.end, hz));
    }
    out
}

/// TIMIT's `.wrd`.
pub fn wrd(alignment: &Alignment) -> String {
    let mut out = String::new();
    for w in &alignment.words {
        let hz = f64::from(SAMPLE_RATE_HZ);
        let _ = writeln!(out, "{} {} {}", units(w.start, hz), units(w.end, hz), w.text);
    }
    out
}

/// Praat's long text form.
pub fn textgrid(alignment: &Alignment) -> String {
    let end = alignment.duration;
    // A tier covers everything: between words stand empty intervals.
    let mut words: Vec<(f64, f64, &str)> = Vec::new();
    let mut place = 0.0;
    for w in &alignment.words {
        if w.start > place {
            words.push((place, w.start, ""));
        }
        words.push((w.start, w.end, &w.text));
        place = w.end;
    }
    if place < end {
        words.push((place, end, ""));
    }
    let silent = |p: &Spoken| p.phone == Phone::SIL || p.phone == Phone::SP;
    let phones: Vec<(f64, f64, &str)> = alignment
        .phones
        .iter()
        .map(|p| (p.start, p.end, if silent(p) { "" } else { p.phone.name() }))
        .collect();
    let mut out = format!(
        "File type = \"ooTextFile\"\nObject class = \"TextGrid\"\n\nxmin = 0\nxmax = {end}\ntiers? <exists>\nsize = 2\n\
         item []:\n"
    );
    for (number, (name, intervals)) in [("words", &words), ("phones", &phones)].into_iter().enumerate() {
        let _ = write!(
            out,
            "    item [{}]:\n        class = \"IntervalTier\"\n        name = \"{name}\"\n        xmin = 0\n        \
             xmax = {end}\n        intervals: size = {}\n",
            number + 1,
            intervals.len()
        );
        for (i, (from, to, text)) in intervals.iter().enumerate() {
            let _ = write!(
                out,
                "        intervals [{}]:\n            xmin = {from}\n            xmax = {to}\n            text = \"{}\"\n",
                i + 1,
                text.replace('"', "\"\"")
            );
        }
    }
    out
}

#[derive(Serialize)]
struct JsonPhone<'a> {
    phone: &'a str,
    start: f64,
    end: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    word: Option<usize>,
    score: f64,
}

#[derive(Serialize)]
struct JsonWord<'a> {
    text: &'a str,
    start: f64,
    end: f64,
}

#[derive(Serialize)]
struct JsonAlignment<'a> {
    duration: f64,
    log_likelihood: f64,
    words: Vec<JsonWord<'a>>,
    phones: Vec<JsonPhone<'a>>,
}

/// Seconds throughout; `word` is an index into `words`.
pub fn json(alignment: &Alignment) -> Result<Vec<u8>> {
    let words = alignment.words.iter().map(|w| JsonWord {
        text: &w.text,
        start: w.start,
        end: w.end,
    });
    let phones = alignment.phones.iter().map(|p| JsonPhone {
        phone: p.phone.name(),
        start: p.start,
        end: p.end,
        word: p.word,
        score: p.score,
    });
    let mut out = serde_json::to_vec_pretty(&JsonAlignment {
        duration: alignment.duration,
        log_likelihood: alignment.log_likelihood,
        words: words.collect(),
        phones: phones.collect(),
    })?;
    out.push(b'\n');
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::SpokenWord;
    use crate::corpus::labels;

    fn alignment() -> Alignment {
        let said = [
            ("sil", 0.0, 0.25, None),
            ("s", 0.25, 0.33, Some(0)),
            ("iy", 0.33, 0.4, Some(0)),
            ("sp", 0.4, 0.5, None),
            ("b", 0.5, 0.55, Some(1)),
            ("iy", 0.55, 0.7, Some(1)),
            ("ey", 0.7, 0.8, Some(2)),
            ("sil", 0.8, 1.0, None),
        ];
        let word = |text: &str, start, end| SpokenWord {
            text: text.into(),
            start,
            end,
        };
        Alignment {
            duration: 1.0,
            phones: said
                .iter()
                .map(|&(name, start, end, word)| Spoken {
                    phone: Phone::from_name(name).unwrap(),
                    start,
                    end,
                    word,
                    score: -1.5,
                })
                .collect(),
            words: vec![
                word("see", 0.25, 0.4),
                word("bee", 0.5, 0.7),
                word("eh", 0.7, 0.8),
            ],
            log_likelihood: -50.0,
        }
    }

    #[test]
    fn what_is_written_is_read_again() {
        let alignment = alignment();
        let times: Vec<_> = alignment
            .words
            .iter()
            .map(|w| (w.text.clone(), w.start, w.end))
            .collect();
        for (extension, text) in [("lab", lab(&alignment)), ("textgrid", textgrid(&alignment))] {
            let back = labels::parse(extension, &text, 1.0).unwrap();
            let words: Vec<_> = back
                .words
                .iter()
                .map(|w| (w.text.clone(), w.time.unwrap().0, w.time.unwrap().1))
                .collect();
            assert_eq!(words, times, "{extension}");
            let phones: Vec<_> = back
                .phones
                .iter()
                .filter(|p| p.2 != Phone::SIL && p.2 != Phone::SP)
                .map(|p| (p.0, p.1, p.2))
                .collect();
            let said: Vec<_> = alignment
                .phones
                .iter()
                .filter(|p| p.word.is_some())
                .map(|p| (p.start, p.end, p.phone))
                .collect();
            assert_eq!(phones, said, "{extension}");
        }
        let back = labels::parse("phn", &phn(&alignment), 1.0).unwrap();
        let phones: Vec<_> = back.phones.iter().map(|p| (p.0, p.1, p.2)).collect();
        let said: Vec<_> = alignment
            .phones
            .iter()
            .map(|p| (p.start, p.end, p.phone))
            .collect();
        assert_eq!(phones, said);
        let back = labels::parse("wrd", &wrd(&alignment), 1.0).unwrap();
        assert_eq!(back.words.len(), 3);
        assert_eq!(back.words[2].time, Some((0.7, 0.8)));
        let value: serde_json::Value = serde_json::from_slice(&json(&alignment).unwrap()).unwrap();
        assert_eq!(value["words"][1]["text"], "bee");
        assert_eq!(value["phones"][3]["word"], serde_json::Value::Null);
        assert_eq!(value["phones"][4]["word"], 1);
    }

    #[test]
    fn formats_are_known_by_their_extensions() {
        for format in [Format::Lab, Format::Textgrid, Format::Phn, Format::Json] {
            assert_eq!(Format::of_extension(format.extension()), Some(format));
        }
        assert_eq!(Format::of_extension("doc"), None);
    }
}
