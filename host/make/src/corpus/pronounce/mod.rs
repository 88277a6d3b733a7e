//! Pronunciations of words in the 47 phones of X&L table 1.
//!
//! A word is looked up in the user's own dictionary, then in CMUdict (embedded, through the crate `phonetik`),
//! then as an inflected form of a word that is there, and at last spelled to sound by rule (`letters`).
use std::collections::HashMap;
use std::path::Path;
use std::sync::OnceLock;

use phonetik::dict::CmuDict;

use super::labels::SpokenWord;
use super::phoneset;
use crate::error::{Context as _, Error, Result, bail};
use crate::features::Word;
use lipstream::phones::Phone;
use lipstream_media::files;

pub mod letters;

/// At most so many alternatives of one word are kept.
pub const MOST_ALTERNATIVES: usize = 8;

/// Where a pronunciation came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Origin {
    /// The user's dictionary.
    User,
    /// CMUdict, or the table of letter names.
    Dictionary,
    /// An inflected form of a word in a dictionary.
    Inflected,
    /// Rules from letters to sounds.
    Letters,
}

/// The embedded CMUdict, unpacked once.
static CMU: OnceLock<CmuDict> = OnceLock::new();
/// The rules learnt from it, when the first unknown word comes.
static RULES: OnceLock<letters::Rules> = OnceLock::new();

/// The dictionaries.
pub struct Pronouncer {
    cmu: &'static CmuDict,
    user: HashMap<String, Vec<Vec<Phone>>>,
}

/// GRID's talkers are British: "z" is zed there, zee comes second.
const LETTER_Z: &str = "z eh d";

impl Pronouncer {
    /// CMUdict, and the user's dictionary (CMUdict's text format) where there is one.
    pub fn new(user: Option<&Path>) -> Result<Self> {
        let user = match user {
            Some(path) => {
                let text = super::labels::decode(&files::read_text(path).map_err(Error::other)?)
                    .with_context(|| format!("dictionary {}", path.display()))?;
                read_dictionary(&text).with_context(|| format!("dictionary {}", path.display()))?
            }
            None => HashMap::new(),
        };
        let cmu = CMU.get_or_init(CmuDict::load);
        if cmu.lookup("the").is_none() {
            bail!(
                File,
                "the embedded CMUdict is empty: this program was not built properly"
            );
        }
        Ok(Self { cmu, user })
    }

    /// Pronunciations of a word as labelled, the most usual first; neither the list nor one in it is empty.
    ///
    /// The error is a word that has no letter a-z, even without its accents, and is in no dictionary.
    pub fn word(&self, word: &SpokenWord) -> Result<(Vec<Vec<Phone>>, Origin)> {
        let text = word.text.as_str();
        if let Some(own) = self.user.get(text) {
            return Ok((own.clone(), Origin::User));
        }
        if word.letter_name
            && let Some(named) = self.letter_name(text)
        {
            return Ok((named, Origin::Dictionary));
        }
        if let Some(found) = self.in_cmu(text) {
            return Ok((finish(found), Origin::Dictionary));
        }
        if let Some(found) = self.inflected(text) {
            return Ok((finish(found), Origin::Inflected));
        }
        match self.spelled(text) {
            phones if phones.is_empty() => Err(Error::Unspoken {
                word: text.to_owned(),
            }),
            phones => Ok((finish(vec![phones]), Origin::Letters)),
        }
    }

    /// A word as the manifest holds it, and where its pronunciations came from.
    pub fn spoken(&self, word: &SpokenWord) -> Result<(Word, Origin)> {
        let (pronunciations, source) = self.word(word)?;
        let names = |phones: &Vec<Phone>| phones.iter().map(|p| p.name().to_owned()).collect();
        let spoken = Word {
            text: word.text.clone(),
            pronunciations: pronunciations.iter().map(names).collect(),
            time: word
                .time
                .map(|(start, end)| (start as f32, end as f32))
                .filter(|(start, end)| start < end),
        };
        Ok((spoken, source))
    }

    /// By rule; letter by letter where there is no vowel to speak.
    pub fn spelled(&self, text: &str) -> Vec<Phone> {
        let plain = letters::plain(text);
        if !plain.contains(['a', 'e', 'i', 'o', 'u', 'y']) {
            let names = plain
                .chars()
                .filter_map(|c| self.letter_name(c.encode_utf8(&mut [0; 4])));
            return names.filter_map(|n| n.into_iter().next()).flatten().collect();
        }
        let rules = RULES.get_or_init(|| letters::Rules::learn(&self.lessons()));
        match rules.pronounce(&plain) {
            phones if phones.is_empty() => Phone::from_name("ax").into_iter().collect(),
            phones => phones,
        }
    }

    /// Words of CMUdict to learn from: letters only, their first pronunciation.
    fn lessons(&self) -> Vec<(String, Vec<Phone>)> {
        let mut keys: Vec<String> = self.cmu.get_keys().iter().map(|k| k.to_lowercase()).collect();
        keys.sort();
        keys.retain(|k| k.bytes().all(|b| b.is_ascii_lowercase()) && !letters::held_out(k));
        keys.into_iter()
            .filter_map(|k| {
                let first = self.in_cmu(&k)?.swap_remove(0);
                Some((k, first))
            })
            .collect()
    }

    /// CMUdict's entries as they stand there.
    fn in_cmu(&self, text: &str) -> Option<Vec<Vec<Phone>>> {
        // The crate drops what is neither letter, apostrophe nor hyphen: only ask for what it would find.
        if !text
            .chars()
            .all(|c| c.is_ascii_lowercase() || c == '\'' || c == '-')
        {
            return None;
        }
        let found: Vec<Vec<Phone>> = self
            .cmu
            .lookup(text)?
            .iter()
            .map(|ids| {
                // Some entries end with a comment ("# foreign french"), which the crate encodes too.
                let known = ids
                    .iter()
                    .map_while(|id| phoneset::cmu(phonetik::phoneme::decode(*id)));
                known.collect::<Vec<Phone>>()
            })
            .filter(|phones| !phones.is_empty())
            .collect();
        (!found.is_empty()).then_some(found)
    }

    /// A word of either dictionary.
    fn known(&self, text: &str) -> Option<Vec<Vec<Phone>>> {
        self.user.get(text).cloned().or_else(|| self.in_cmu(text))
    }

    /// The name of a letter of the alphabet.
    fn letter_name(&self, text: &str) -> Option<Vec<Vec<Phone>>> {
        let mut found = match text {
            // CMUdict's first entry is the article.
            "a" => parse_phones("ey").map(|p| vec![p]),
            "z" => parse_phones(LETTER_Z).map(|p| vec![p]),
            _ => Some(Vec::new()),
        }?;
        if text != "a" {
            found.extend(self.in_cmu(text)?);
        }
        Some(finish(found))
    }

    /// Regular inflections of known words: plural and possessive, past, -ing, -er, -ly.
    fn inflected(&self, text: &str) -> Option<Vec<Vec<Phone>>> {
        for (ending, stems) in [
            ("'s", &[""][..]),
            ("s'", &["", "s"]),
            ("es", &["e", ""]),
            ("s", &[""]),
            ("ed", &["e", "", "\u{8}"]),
            ("ing", &["", "e", "\u{8}"]),
            ("er", &["e", "", "\u{8}"]),
            ("ly", &[""]),
            ("ness", &[""]),
            ("less", &[""]),
        ] {
            let Some(stem) = text.strip_suffix(ending).filter(|s| s.len() >= 2) else {
                continue;
            };
            for add in stems {
                // \u{8} takes a doubled letter back: stopped, stop.
                let whole = match (*add, stem.as_bytes()) {
                    ("\u{8}", [.., a, b]) if a == b => stem[..stem.len() - 1].to_owned(),
                    ("\u{8}", _) => continue,
                    (add, _) => format!("{stem}{add}"),
                };
                if let Some(found) = self.known(&whole) {
                    return Some(found.into_iter().map(|p| with_ending(p, ending)).collect());
                }
            }
        }
        None
    }
}

/// Adds a regular ending to a pronunciation.
fn with_ending(mut phones: Vec<Phone>, ending: &str) -> Vec<Phone> {
    let last = phones.last().map_or("", |p| p.name());
    let voiceless = matches!(last, "p" | "t" | "k" | "f" | "th" | "s" | "sh" | "ch");
    let tail = match ending {
        "'s" | "s'" | "es" | "s" => match last {
            "s" | "z" | "sh" | "zh" | "ch" | "jh" => "ix z",
            _ if voiceless => "s",
            _ => "z",
        },
        "ed" => match last {
            "t" | "d" => "ix d",
            _ if voiceless => "t",
            _ => "d",
        },
        "ing" => "ix ng",
        "er" => "axr",
        "ly" => "l iy",
        "ness" => "n ax s",
        _ => "l ax s",
    };
    phones.extend(tail.split(' ').filter_map(Phone::from_name));
    phones
}

/// Adds syllabic consonants as alternatives (bottle: `t ax l`, `t el`), drops doubles, bounds the number.
fn finish(found: Vec<Vec<Phone>>) -> Vec<Vec<Phone>> {
    let syllabic: Vec<Vec<Phone>> = found.iter().map(|p| syllabic(p)).collect();
    let mut out: Vec<Vec<Phone>> = Vec::new();
    for phones in found.into_iter().chain(syllabic) {
        if !phones.is_empty() && !out.contains(&phones) && out.len() < MOST_ALTERNATIVES {
            out.push(phones);
        }
    }
    out
}

/// `ax` + l, m or n after a consonant and not before a vowel, as the syllabic consonants of table 1.
fn syllabic(phones: &[Phone]) -> Vec<Phone> {
    let mut out: Vec<Phone> = Vec::with_capacity(phones.len());
    let mut i = 0;
    while i < phones.len() {
        let next = phones.get(i + 1).map_or("", |p| p.name());
        let joined = match (phones[i].name(), next) {
            ("ax", "l") => "el",
            ("ax", "n") => "en",
            ("ax", "m") => "em",
            _ => "",
        };
        let after_consonant = out.last().is_some_and(|p| !is_vowel(*p));
        let before_vowel = phones.get(i + 2).is_some_and(|p| is_vowel(*p));
        match Phone::from_name(joined) {
            Some(phone) if after_consonant && !before_vowel => {
                out.push(phone);
                i += 2;
            }
            _ => {
                out.push(phones[i]);
                i += 1;
            }
        }
    }
    out
}

fn is_vowel(phone: Phone) -> bool {
    matches!(
        phone.name(),
        "ao" | "aa"
            | "ah"
            | "er"
            | "oy"
            | "aw"
            | "uw"
            | "uh"
            | "ow"
            | "ae"
            | "eh"
            | "ey"
            | "ay"
            | "ih"
            | "iy"
            | "ax"
            | "axr"
            | "ix"
            | "em"
            | "el"
            | "en"
    )
}

fn parse_phones(text: &str) -> Option<Vec<Phone>> {
    text.split_whitespace()
        .map(phoneset::phone)
        .collect::<Option<Vec<_>>>()
        .filter(|p| !p.is_empty())
}

/// A dictionary in CMUdict's text format: `word  W ER1 D`, `word(2) ...` for alternatives, `;;;` and `#`
/// for comments. Phones may also be named as in table 1.
pub fn read_dictionary(text: &str) -> Result<HashMap<String, Vec<Vec<Phone>>>> {
    let mut words: HashMap<String, Vec<Vec<Phone>>> = HashMap::new();
    for (number, line) in text.lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default().trim();
        if line.is_empty() || line.starts_with(";;;") {
            continue;
        }
        let (entry, phones) = line
            .split_once(char::is_whitespace)
            .ok_or_else(|| Error::Data(format!("line {}: {line:?} has no phones", number + 1)))?;
        let word = match entry.split_once('(') {
            Some((word, rest)) if !word.is_empty() && rest.ends_with(')') => word,
            _ => entry,
        };
        let phones: Vec<Phone> = phones
            .split_whitespace()
            .map(|p| {
                phoneset::phone(p)
                    .filter(|p| *p != Phone::SIL && *p != Phone::SP)
                    .ok_or_else(|| {
                        Error::Data(format!(
                            "line {}: {p:?} is no phone of CMU's or X&L's set",
                            number + 1
                        ))
                    })
            })
            .collect::<Result<_>>()?;
        let entries = words.entry(word.to_lowercase()).or_default();
        if entries.len() < MOST_ALTERNATIVES {
            entries.push(phones);
        }
    }
    Ok(words)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::corpus::labels::transcript;
    use crate::error::chain;

    fn say(pronouncer: &Pronouncer, text: &str) -> (Vec<String>, Origin) {
        let words = transcript::words(text);
        let (found, source) = pronouncer.word(&words[0]).unwrap();
        let join = |p: &Vec<Phone>| p.iter().map(|p| p.name()).collect::<Vec<_>>().join(" ");
        (found.iter().map(join).collect(), source)
    }

    #[test]
    fn the_dictionary_and_its_alternatives() {
        let p = Pronouncer::new(None).unwrap();
        assert_eq!(say(&p, "soon"), (vec!["s uw n".into()], Origin::Dictionary));
        let (the, _) = say(&p, "The");
        assert!(
            the.contains(&"dh ax".into()) && the.contains(&"dh iy".into()),
            "{the:?}"
        );
        let (seven, _) = say(&p, "seven");
        assert_eq!(seven, ["s eh v ax n", "s eh v en"]);
        assert_eq!(say(&p, "a").0[0], "ax");
    }

    #[test]
    fn grid_letters_are_letter_names() {
        let p = Pronouncer::new(None).unwrap();
        let name = |letter: &str| {
            let word = SpokenWord {
                text: letter.into(),
                time: None,
                letter_name: true,
            };
            let (found, source) = p.word(&word).unwrap();
            assert_eq!(source, Origin::Dictionary, "{letter}");
            let join = |p: &Vec<Phone>| p.iter().map(|p| p.name()).collect::<Vec<_>>().join(" ");
            found.iter().map(join).collect::<Vec<_>>()
        };
        assert_eq!(name("a"), ["ey"]);
        assert_eq!(name("q"), ["k y uw"]);
        assert_eq!(name("z"), ["z eh d", "z iy"]);
        for letter in 'a'..='z' {
            name(&letter.to_string());
        }
    }

    #[test]
    fn regular_inflections_of_known_words() {
        let p = Pronouncer::new(None).unwrap();
        assert_eq!(say(&p, "soon's"), (vec!["s uw n z".into()], Origin::Inflected));
        assert_eq!(
            with_ending(parse_phones("s t aa p").unwrap(), "ed")
                .last()
                .unwrap()
                .name(),
            "t"
        );
        assert_eq!(with_ending(parse_phones("n iy d").unwrap(), "ed").len(), 5);
        assert_eq!(with_ending(parse_phones("b ah s").unwrap(), "es").len(), 5);
    }

    #[test]
    fn unknown_words_are_still_spoken() {
        let p = Pronouncer::new(None).unwrap();
        for text in ["zzyzxq", "lipstreamish", "été", "ż", "x'y"] {
            let (found, source) = say(&p, text);
            assert_eq!(source, Origin::Letters, "{text}");
            assert!(!found.is_empty() && !found[0].is_empty(), "{text}");
        }
        assert_eq!(say(&p, "xqz").0[0], "eh k s k y uw z eh d");
        let error = p.word(&transcript::words("да")[0]).unwrap_err();
        assert!(error.to_string().contains("add it to a dictionary"));
    }

    /// Edits between two pronunciations: insertions, deletions and substitutions.
    fn edits(a: &[Phone], b: &[Phone]) -> usize {
        let mut row: Vec<usize> = (0..=b.len()).collect();
        for (i, x) in a.iter().enumerate() {
            let mut diagonal = row[0];
            row[0] = i + 1;
            for (j, y) in b.iter().enumerate() {
                let substituted = diagonal + usize::from(x != y);
                diagonal = row[j + 1];
                row[j + 1] = substituted.min(row[j] + 1).min(diagonal + 1);
            }
        }
        row[b.len()]
    }

    /// Phone error rate against the dictionary on words that the rules were not learnt from; the bound is what
    /// docs/corpora.md states.
    #[test]
    fn letters_to_sounds_on_words_kept_out() {
        let p = Pronouncer::new(None).unwrap();
        let mut words: Vec<String> = p.cmu.get_keys().iter().map(|k| k.to_lowercase()).collect();
        words.retain(|k| k.bytes().all(|b| b.is_ascii_lowercase()) && k.len() > 2 && letters::held_out(k));
        words.sort();
        assert!(words.len() >= 2000, "{}", words.len());
        let (mut wrong, mut total, mut whole) = (0, 0, 0);
        for word in &words {
            let spelled = p.spelled(word);
            let nearest = p.in_cmu(word).unwrap_or_else(|| panic!("{word}"));
            let nearest = nearest.iter().min_by_key(|r| edits(&spelled, r)).unwrap();
            wrong += edits(&spelled, nearest);
            total += nearest.len();
            whole += usize::from(spelled == *nearest);
        }
        let rate = wrong as f64 / total as f64;
        println!(
            "{} words, phone error rate {:.1} %, whole words right {:.1} %",
            words.len(),
            100.0 * rate,
            100.0 * whole as f64 / words.len() as f64
        );
        assert!(rate < 0.13, "phone error rate {rate:.3}");
    }

    #[test]
    fn the_users_dictionary_comes_first() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mine.dict");
        std::fs::write(
            &path,
            ";;; mine\nSOON  S UH1 N\nsoon(2) s uw n # other\nlipstream L IH1 P S T R IY2 M\n",
        )
        .unwrap();
        let p = Pronouncer::new(Some(&path)).unwrap();
        assert_eq!(
            say(&p, "soon"),
            (vec!["s uh n".into(), "s uw n".into()], Origin::User)
        );
        assert_eq!(say(&p, "lipstream").1, Origin::User);
        assert_eq!(
            say(&p, "lipstreams"),
            (vec!["l ih p s t r iy m z".into()], Origin::Inflected)
        );
        for bad in ["word\n", "word AH0 QQ\n", "word sil\n"] {
            let error = chain(&read_dictionary(bad).unwrap_err());
            assert!(error.contains("line 1") && !error.contains('\n'), "{error}");
        }
        assert!(Pronouncer::new(Some(&folder.path().join("none"))).is_err());
    }
}
