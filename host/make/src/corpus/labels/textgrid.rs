//! Praat TextGrids in text form. As Praat does, only free-standing numbers, quoted strings and `<flags>` are
//! read and everything else is commentary: so the long and the short form are one format.

use super::{Interval, Labels, phones_of, words_of};
use crate::corpus::phoneset;
use crate::error::{Context as _, Error, Result, bail};

#[derive(Debug, PartialEq)]
enum Token {
    Number(f64),
    Text(String),
    Flag(String),
}

/// A tier of intervals; tiers of points have none.
#[derive(Debug, PartialEq)]
pub(super) struct Tier {
    pub(super) name: String,
    pub(super) intervals: Vec<Interval>,
}

/// Free-standing tokens of `text`, with the lines they are on.
fn tokens(text: &str) -> Result<Vec<(usize, Token)>> {
    let mut out = Vec::new();
    let mut rest = text.trim_start();
    // Lines are counted as the text is passed over.
    let (mut line, mut counted) = (1, 0);
    while let Some(first) = rest.chars().next() {
        let place = text.len() - rest.len();
        line += text[counted..place].matches('\n').count();
        counted = place;
        if first == '"' {
            let mut value = String::new();
            rest = &rest[1..];
            loop {
                let quote = rest
                    .find('"')
                    .ok_or_else(|| Error::Data(format!("line {line}: a text without its closing quote")))?;
                value.push_str(&rest[..quote]);
                rest = &rest[quote + 1..];
                if !rest.starts_with('"') {
                    break;
                }
                value.push('"');
                rest = &rest[1..];
            }
            out.push((line, Token::Text(value)));
        } else if first == '!' {
            rest = rest.find('\n').map_or("", |end| &rest[end..]);
        } else {
            let end = rest.find(char::is_whitespace).unwrap_or(rest.len());
            let word = &rest[..end];
            if word.starts_with('<') && word.ends_with('>') {
                out.push((line, Token::Flag(word.to_owned())));
            } else if let Ok(number) = word.parse::<f64>() {
                out.push((line, Token::Number(number)));
            } else if let Some((whole, behind)) = word.split_once(',')
                && [whole, behind]
                    .iter()
                    .all(|part| !part.is_empty() && part.bytes().all(|b| b.is_ascii_digit()))
            {
                // Passed over as commentary, it would leave all that follows one number short.
                bail!(
                    Data,
                    "line {line}: {word} has a decimal comma: Praat writes a point ({whole}.{behind})"
                );
            }
            rest = &rest[end..];
        }
        rest = rest.trim_start();
    }
    Ok(out)
}

impl std::fmt::Display for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Token::Number(number) => write!(f, "{number}"),
            Token::Text(text) => write!(f, "{text:?}"),
            Token::Flag(flag) => write!(f, "{flag}"),
        }
    }
}

struct Reader {
    tokens: std::vec::IntoIter<(usize, Token)>,
    /// Line of the token that was read last.
    line: usize,
}

impl Reader {
    fn next(&mut self) -> Option<Token> {
        let (line, token) = self.tokens.next()?;
        self.line = line;
        Some(token)
    }

    fn ends<T>(&self, what: &str) -> Result<T> {
        bail!(
            Data,
            "the TextGrid ends after line {} where {what} should come: it is cut short, save it in Praat again",
            self.line
        )
    }

    fn text(&mut self, what: &str) -> Result<String> {
        match self.next() {
            Some(Token::Text(text)) => Ok(text),
            Some(other) => bail!(
                Data,
                "line {}: expected {what} in quotes, found {other}",
                self.line
            ),
            None => self.ends(what),
        }
    }

    fn number(&mut self, what: &str) -> Result<f64> {
        match self.next() {
            Some(Token::Number(number)) if number.is_finite() => Ok(number),
            Some(other) => bail!(Data, "line {}: expected {what}, found {other}", self.line),
            None => self.ends(what),
        }
    }

    /// A count; it reserves nothing, so an absurd one ends as a file that is too short.
    fn count(&mut self, what: &str) -> Result<u64> {
        let number = self.number(what)?;
        if number < 0.0 || number.fract() != 0.0 || number > 1e9 {
            bail!(Data, "line {}: {what} is {number}", self.line);
        }
        Ok(number as u64)
    }
}

/// All tiers of a TextGrid.
pub(super) fn tiers(text: &str) -> Result<Vec<Tier>> {
    if text.starts_with("ooBinaryFile") {
        bail!(Data, "a binary TextGrid: save it in Praat as a text file");
    }
    let mut reader = Reader {
        tokens: tokens(text)?.into_iter(),
        line: 1,
    };
    let kind = reader.text("the file type")?;
    // Praat's short files say so in many corpora, and go on in the same way.
    let class = if kind == "ooTextFile" || kind == "ooTextFile short" {
        reader.text("the object class")?
    } else {
        kind
    };
    if class != "TextGrid" {
        bail!(Data, "a Praat file of class {class:?}, not a TextGrid");
    }
    reader.number("the start time")?;
    reader.number("the end time")?;
    match reader.next() {
        Some(Token::Flag(flag)) if flag == "<exists>" => {}
        Some(Token::Flag(_)) => return Ok(Vec::new()),
        Some(other) => bail!(Data, "line {}: expected <exists>, found {other}", reader.line),
        None => return reader.ends("<exists>"),
    }
    let mut tiers = Vec::new();
    for _ in 0..reader.count("the number of tiers")? {
        let class = reader.text("the class of a tier")?;
        let name = reader.text("the name of a tier")?;
        reader.number("the start time of a tier")?;
        reader.number("the end time of a tier")?;
        let size = reader.count("the size of a tier")?;
        let mut intervals = Vec::new();
        match class.as_str() {
            "IntervalTier" => {
                for _ in 0..size {
                    let start = reader.number("the start of an interval")?;
                    let end = reader.number("the end of an interval")?;
                    let label = reader.text("the text of an interval")?;
                    if end < start {
                        bail!(
                            Data,
                            "line {}: tier {name:?} has an interval from {start} to {end}",
                            reader.line
                        );
                    }
                    intervals.push(Interval { start, end, label });
                }
            }
            "TextTier" => {
                for _ in 0..size {
                    reader.number("the time of a point")?;
                    reader.text("the mark of a point")?;
                }
            }
            other => bail!(
                Data,
                "line {}: a tier of class {other:?}; IntervalTier and TextTier are known",
                reader.line
            ),
        }
        tiers.push(Tier { name, intervals });
    }
    Ok(tiers)
}

/// Words and phones of a TextGrid: from the tiers that are named so, else from what the labels look like.
pub(super) fn labels(text: &str) -> Result<Labels> {
    let tiers = tiers(text)?;
    let used: Vec<&Tier> = tiers
        .iter()
        .filter(|t| t.intervals.iter().any(|i| !phoneset::is_silence(&i.label)))
        .collect();
    // Whole words of a name count: a "microphone" has no phones, and a "report" is no orthography.
    let has = |tier: &Tier, keys: &[&str]| {
        let name = tier.name.to_lowercase();
        name.split(|c: char| !c.is_alphanumeric())
            .any(|part| keys.contains(&part))
    };
    let named = |keys: &[&str]| used.iter().position(|t| has(t, keys));
    let all_phones = |t: &Tier| t.intervals.iter().all(|i| phoneset::is_phone_label(&i.label));
    let phones = named(&["phone", "phones", "phon", "phn", "segment", "segments"])
        // MAUS calls its tiers ORT-MAU, KAN-MAU and MAU.
        .or_else(|| {
            used.iter()
                .position(|t| has(t, &["mau"]) && !has(t, &["ort", "kan", "mas", "trn"]))
        })
        .or_else(|| used.iter().position(|t| all_phones(t)));
    let said = |i: usize| words_of(&used[i].intervals, false).len();
    let words = named(&["word", "words", "wrd", "ort", "orthography"])
        .or_else(|| {
            named(&[
                "transcription",
                "transcript",
                "text",
                "sentence",
                "sentences",
                "utterance",
                "utterances",
            ])
        })
        .or_else(|| {
            // A lone remark beside phones is no transcript.
            let least = if phones.is_some() { 2 } else { 1 };
            let labelled = |i: usize| {
                used[i]
                    .intervals
                    .iter()
                    .filter(|l| !phoneset::is_silence(&l.label))
                    .count()
            };
            (0..used.len())
                .filter(|i| Some(*i) != phones && !all_phones(used[*i]) && labelled(*i) >= least)
                .rev()
                .max_by_key(|i| said(*i))
        });
    Ok(Labels {
        words: words.map_or(Vec::new(), |i| words_of(&used[i].intervals, false)),
        phones: match phones {
            Some(i) => phones_of(&used[i].intervals).with_context(|| format!("tier {:?}", used[i].name))?,
            None => Vec::new(),
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::chain;

    const LONG: &str = r#"File type = "ooTextFile"
Object class = "TextGrid"

xmin = 0
xmax = 1.5
tiers? <exists>
size = 3
item []:
    item [1]:
        class = "IntervalTier"
        name = "words"
        xmin = 0
        xmax = 1.5
        intervals: size = 3
        intervals [1]:
            xmin = 0
            xmax = 0.5
            text = ""
        intervals [2]:
            xmin = 0.5
            xmax = 1.0
            text = "say ""he"""
        intervals [3]:
            xmin = 1.0
            xmax = 1.5
            text = "bee"
    item [2]:
        class = "TextTier"
        name = "clicks"
        xmin = 0
        xmax = 1.5
        points: size = 1
        points [1]:
            number = 0.7
            mark = "!"
    item [3]:
        class = "IntervalTier"
        name = "phones"
        xmin = 0
        xmax = 1.5
        intervals: size = 3
        intervals [1]:
            xmin = 0
            xmax = 1.0
            text = ""
        intervals [2]:
            xmin = 1.0
            xmax = 1.2
            text = "B"
        intervals [3]:
            xmin = 1.2
            xmax = 1.5
            text = "IY1"
"#;

    const SHORT: &str = "File type = \"ooTextFile\"\nObject class = \"TextGrid\"\n\n0\n1.5\n<exists>\n3\n\
        \"IntervalTier\"\n\"words\"\n0\n1.5\n3\n0\n0.5\n\"\"\n0.5\n1.0\n\"say \"\"he\"\"\"\n1.0\n1.5\n\"bee\"\n\
        \"TextTier\"\n\"clicks\"\n0\n1.5\n1\n0.7\n\"!\"\n\
        \"IntervalTier\"\n\"phones\"\n0\n1.5\n3\n0\n1.0\n\"\"\n1.0\n1.2\n\"B\"\n1.2\n1.5\n\"IY1\"\n";

    #[test]
    fn long_and_short_forms_are_the_same() {
        let long = tiers(LONG).unwrap();
        assert_eq!(long, tiers(SHORT).unwrap());
        assert_eq!(long.len(), 3);
        assert_eq!(long[0].intervals[1].label, "say \"he\"");
        let labels = labels(LONG).unwrap();
        let words: Vec<_> = labels.words.iter().map(|w| (w.text.as_str(), w.time)).collect();
        assert_eq!(words, [("say", None), ("he", None), ("bee", Some((1.0, 1.5)))]);
        let phones: Vec<_> = labels.phones.iter().map(|p| p.2.name()).collect();
        assert_eq!(phones, ["sil", "b", "iy"]);
    }

    /// A TextGrid in the short form with these tiers of one label each over a second, words apart by the sign |.
    fn grid(header: &str, tiers: &[(&str, &str)]) -> String {
        let mut text = format!(
            "File type = \"{header}\"\n\"TextGrid\"\n\n0\n1\n<exists>\n{}\n",
            tiers.len()
        );
        for (name, labels) in tiers {
            let labels: Vec<&str> = labels.split('|').collect();
            let each = 1.0 / labels.len() as f64;
            text += &format!("\"IntervalTier\"\n\"{name}\"\n0\n1\n{}\n", labels.len());
            for (n, label) in labels.iter().enumerate() {
                text += &format!("{}\n{}\n\"{label}\"\n", n as f64 * each, (n + 1) as f64 * each);
            }
        }
        text
    }

    #[test]
    fn whole_words_of_tier_names_count() {
        let read = |tiers: &[(&str, &str)]| {
            let read = labels(&grid("ooTextFile short", tiers)).unwrap();
            let words: Vec<_> = read.words.iter().map(|w| w.text.clone()).collect();
            let phones: Vec<_> = read.phones.iter().map(|p| p.2.name()).collect();
            (words.join(" "), phones.join(" "))
        };
        let want = ("please me".to_owned(), "p l iy z m iy".to_owned());
        let phones = "p|l|iy|z|m|iy";
        for tiers in [
            [
                ("report", "good"),
                ("transcription", "please me"),
                ("phones", phones),
            ],
            [
                ("microphone", "close talk"),
                ("segments", phones),
                ("words", "please|me"),
            ],
            [
                ("microphone", "close"),
                ("anne - phones", phones),
                ("anne", "please|me"),
            ],
            [
                ("ORT-MAU", "please|me"),
                ("KAN-MAU", "pli:z|mi:"),
                ("MAU", phones),
            ],
        ] {
            assert_eq!(read(&tiers), want, "{tiers:?}");
        }
        // A remark is no transcript.
        assert_eq!(read(&[("microphone", "close talk"), ("phones", phones)]).0, "");
    }

    #[test]
    fn what_an_aligner_writes_is_read() {
        // Montreal Forced Aligner: noise and unknown words, and its own phonetic alphabet.
        for (said, want) in [
            ("spn|P|L|IY1|Z|spn", "sil p l iy z sil"),
            ("pʰ|l|iː|z|ð|ɪ|dʒ|aj|ɾ|ə|ɫ̩|tʃ", "p l iy z dh ih jh ay d ax el ch"),
        ] {
            let read = labels(&grid("ooTextFile", &[("phones", said)])).unwrap();
            let names: Vec<_> = read.phones.iter().map(|p| p.2.name()).collect();
            assert_eq!(names.join(" "), want);
        }
    }

    #[test]
    fn tiers_without_telling_names_are_told_by_their_labels() {
        let text = SHORT.replace("\"words\"", "\"A\"").replace("\"phones\"", "\"B\"");
        assert_eq!(labels(&text).unwrap(), labels(SHORT).unwrap());
    }

    #[test]
    fn damaged_files_are_refused_in_one_line() {
        for text in [
            "",
            "File type = \"ooTextFile\"\nObject class = \"Pitch 1\"\n0 1 <exists> 0",
            &SHORT[..SHORT.len() - 10],
            &SHORT.replace("<exists>\n3\n", "<exists>\n4000000\n"),
            &SHORT.replace("<exists>\n3\n", "<exists>\n-1\n"),
            &SHORT.replace("0.5\n1.0\n", "1.0\n0.5\n"),
            &SHORT.replace("IntervalTier", "PitchTier"),
            "ooBinaryFile\u{8}TextGrid",
        ] {
            let error = chain(&labels(text).unwrap_err());
            assert!(!error.contains('\n'), "{error}");
        }
        let comma = chain(&labels(&SHORT.replace("0\n0.5\n", "0\n0,5\n")).unwrap_err());
        assert!(
            comma.contains("0,5 has a decimal comma") && comma.contains("line 14"),
            "{comma}"
        );
        let unknown = chain(&labels(&SHORT.replace("IY1", "Q9")).unwrap_err());
        assert!(unknown.contains("q9"), "{unknown}");
    }
}
