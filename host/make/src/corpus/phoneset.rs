//! Other phone sets in terms of the 47 phones of X&L table 1: CMU's 39 with stress, TIMIT's 61, and the
//! names that labelling programs give to silence.
use lipstream::phones::Phone;

/// Labels that mean silence at the ends of an utterance or between sentences.
const SILENCE: [&str; 13] = [
    "",
    "sil",
    "silence",
    "h#",
    "#h",
    "#",
    "<s>",
    "</s>",
    "<sil>",
    "sent-start",
    "sent-end",
    "!enter",
    "!exit",
];

/// Labels that mean a pause between or inside words: TIMIT's `pau` and `epi`, Praat's and MAUS's names; and what is no phone at all: noise, breath and
/// words that an aligner did not know (Kaldi's and the Montreal Forced Aligner's `spn` and `nsn`, MAUS's `<nib>`).
const PAUSE: [&str; 13] = [
    "sp", "pau", "epi", "_", "<p:>", "<p>", "pause", "ssil", "spn", "nsn", "<unk>", "brth", "<nib>",
];

/// True if `label` means silence or a pause.
pub fn is_silence(label: &str) -> bool {
    let label = label.trim().to_lowercase();
    SILENCE.contains(&label.as_str()) || PAUSE.contains(&label.as_str())
}

/// The phone of table 1 behind a label in table 1's own names, CMU's (`AH0`, `ER1`) or TIMIT's (`ux`, `hv`).
///
/// TIMIT's closures (`bcl`, ...) and glottal stop (`q`) are no phones of their own: [`timit`] folds them.
pub fn phone(label: &str) -> Option<Phone> {
    let lower = label.trim().to_lowercase();
    if SILENCE.contains(&lower.as_str()) {
        return Some(Phone::SIL);
    }
    if PAUSE.contains(&lower.as_str()) {
        return Some(Phone::SP);
    }
    if lower.ends_with(|c: char| c.is_ascii_digit()) {
        return cmu(&lower);
    }
    Phone::from_name(&lower).or_else(|| {
        let name = match lower.as_str() {
            "ux" => "uw",
            "hv" => "hh",
            "dx" => "d",
            "nx" => "n",
            "ax-h" => "ax",
            "eng" => "ng",
            _ => return None,
        };
        Phone::from_name(name)
    })
}

/// English in the International Phonetic Alphabet, as the Montreal Forced Aligner's `english_mfa` and plain dictionaries write it, without marks of length,
/// stress, aspiration, palatalisation and rounding: the phone of table 1 by name.
const IPA: [(&str, &str); 76] = [
    ("a", "aa"),
    ("aj", "ay"),
    ("aɪ", "ay"),
    ("ai", "ay"),
    ("aw", "aw"),
    ("aʊ", "aw"),
    ("au", "aw"),
    ("b", "b"),
    ("c", "k"),
    ("ç", "hh"),
    ("d", "d"),
    ("d̪", "dh"),
    ("dʒ", "jh"),
    ("d͡ʒ", "jh"),
    ("ʤ", "jh"),
    ("ð", "dh"),
    ("e", "eh"),
    ("ej", "ey"),
    ("eɪ", "ey"),
    ("ei", "ey"),
    ("f", "f"),
    ("g", "g"),
    ("ɡ", "g"),
    ("h", "hh"),
    ("i", "iy"),
    ("j", "y"),
    ("k", "k"),
    ("l", "l"),
    ("l̩", "el"),
    ("m", "m"),
    ("m̩", "em"),
    ("n", "n"),
    ("n̩", "en"),
    ("o", "ow"),
    ("ow", "ow"),
    ("oʊ", "ow"),
    ("əʊ", "ow"),
    ("əw", "ow"),
    ("p", "p"),
    ("r", "r"),
    ("s", "s"),
    ("t", "t"),
    ("t̪", "th"),
    ("tʃ", "ch"),
    ("t͡ʃ", "ch"),
    ("ʧ", "ch"),
    ("u", "uw"),
    ("v", "v"),
    ("w", "w"),
    ("z", "z"),
    ("æ", "ae"),
    ("ɐ", "ah"),
    ("ɑ", "aa"),
    ("ɒ", "aa"),
    ("ɔ", "ao"),
    ("ɔj", "oy"),
    ("ɔɪ", "oy"),
    ("ə", "ax"),
    ("ɚ", "axr"),
    ("ɛ", "eh"),
    ("ɜ", "er"),
    ("ɝ", "er"),
    ("ɟ", "g"),
    ("ɪ", "ih"),
    ("ɫ", "l"),
    ("ɫ̩", "el"),
    ("ɲ", "n"),
    ("ɹ", "r"),
    ("ɾ", "d"),
    ("ɾ̃", "n"),
    ("ʃ", "sh"),
    ("ʊ", "uh"),
    ("ʌ", "ah"),
    ("ʒ", "zh"),
    ("θ", "th"),
    ("ŋ", "ng"),
];

/// Signs that belong to the rarer sounds of English-speaking aligners.
const RARER: [(&str, &str); 8] = [
    ("ʉ", "uw"),
    ("ʈ", "t"),
    ("ɖ", "d"),
    ("ʎ", "l"),
    ("ʋ", "w"),
    ("ʍ", "w"),
    ("ʔ", "q"),
    ("ɨ", "ix"),
];

/// The label of table 1's or TIMIT's that stands for one in the International Phonetic Alphabet.
pub fn ipa(label: &str) -> Option<&'static str> {
    let plain: String = label
        .trim()
        .to_lowercase()
        .chars()
        .filter(|c| !"ːˑˈˌ'ʰʲʷ̃̚".contains(*c) || *c == '\u{303}' && label.starts_with('ɾ'))
        .collect();
    IPA.iter()
        .chain(&RARER)
        .find(|(sign, _)| *sign == plain)
        .map(|(_, name)| *name)
}

/// Whether a label has signs that only the phonetic alphabet has, and is known.
pub fn is_ipa(label: &str) -> bool {
    !label.is_ascii() && ipa(label).is_some()
}

/// One CMU phone with its stress digit: unstressed AH, ER and IH are the reduced vowels ax, axr and ix;
/// every other phone keeps its name.
pub fn cmu(symbol: &str) -> Option<Phone> {
    let lower = symbol.to_lowercase();
    let (base, stress) = match lower.as_bytes().last()? {
        b'0'..=b'2' => lower.split_at(lower.len() - 1),
        _ => (lower.as_str(), ""),
    };
    let name = match (base, stress) {
        ("ah", "0") => "ax",
        ("er", "0") => "axr",
        ("ih", "0") => "ix",
        _ => base,
    };
    Phone::from_name(name).filter(|p| *p != Phone::SIL && *p != Phone::SP)
}

/// A stop's closure in TIMIT's names, and the phone that it is when no release follows.
fn closure(label: &str) -> Option<&'static str> {
    Some(match label {
        "bcl" => "b",
        "dcl" => "d",
        "gcl" => "g",
        "pcl" => "p",
        "tcl" => "t",
        "kcl" => "k",
        _ => return None,
    })
}

/// True if `release` is what `closed` is released into: its own stop, or the affricate of that place.
fn releases(closed: &str, release: &str) -> bool {
    closed == release || matches!((closed, release), ("d", "jh") | ("t", "ch"))
}

/// Whether a label can stand in a phone transcription of TIMIT's kind.
pub fn is_phone_label(label: &str) -> bool {
    let lower = label.trim().to_lowercase();
    phone(&lower).is_some() || closure(&lower).is_some() || lower == "q" || is_ipa(&lower)
}

/// TIMIT's transcription in table 1's phones. `labels` are (start, end, label) in any unit, in order.
///
/// A closure and its release become one phone from the closure's start to the release's end; a closure
/// without release is the stop itself. The glottal stop `q` joins the phone after it, or the one before at
/// a pause. Flaps count as what they stand for in place (`dx` d, `nx` n), `ux` as uw, `hv` as hh, `ax-h` as
/// ax, `eng` as ng. Neighbouring silences become one; at the two ends silence is `sil`.
///
/// The error is the label that no phone set here has.
pub fn timit<T: Copy>(labels: &[(T, T, String)]) -> Result<Vec<(T, T, Phone)>, String> {
    let mut out: Vec<(T, T, Phone)> = Vec::with_capacity(labels.len());
    // A glottal stop waiting for the phone that it joins: its start.
    let mut glottal: Option<(T, T)> = None;
    let mut i = 0;
    while i < labels.len() {
        let (mut start, mut end, label) = (labels[i].0, labels[i].1, labels[i].2.trim().to_lowercase());
        i += 1;
        if label == "q" {
            glottal = Some((glottal.map_or(start, |g| g.0), end));
            continue;
        }
        let name = match closure(&label) {
            Some(stop) => match labels.get(i).map(|l| l.2.trim().to_lowercase()) {
                Some(next) if releases(stop, &next) => {
                    end = labels[i].1;
                    i += 1;
                    next
                }
                _ => stop.to_owned(),
            },
            None => label,
        };
        let phone = phone(&name).ok_or(name)?;
        let silent = phone == Phone::SIL || phone == Phone::SP;
        if let Some(g) = glottal.take() {
            match out.last_mut() {
                Some(last) if silent => last.1 = g.1,
                _ => start = g.0,
            }
        }
        match out.last_mut() {
            Some(last) if silent && (last.2 == Phone::SIL || last.2 == Phone::SP) => {
                last.1 = end;
                last.2 = if phone == Phone::SIL { phone } else { last.2 };
            }
            _ => out.push((start, end, phone)),
        }
    }
    if let (Some(g), Some(last)) = (glottal, out.last_mut()) {
        last.1 = g.1;
    }
    for edge in [0, out.len().saturating_sub(1)] {
        if let Some(label) = out.get_mut(edge).filter(|l| l.2 == Phone::SP) {
            label.2 = Phone::SIL;
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fold(text: &str) -> String {
        let labels: Vec<_> = text
            .split_whitespace()
            .enumerate()
            .map(|(i, l)| (i, i + 1, l.to_owned()))
            .collect();
        match timit(&labels) {
            Ok(out) => {
                let parts: Vec<_> = out
                    .iter()
                    .map(|(s, e, p)| format!("{}:{s}-{e}", p.name()))
                    .collect();
                parts.join(" ")
            }
            Err(label) => format!("? {label}"),
        }
    }

    #[test]
    fn stress_chooses_the_reduced_vowels() {
        for (cmu_name, ours) in [
            ("AH0", "ax"),
            ("AH1", "ah"),
            ("ER0", "axr"),
            ("ER2", "er"),
            ("IH0", "ix"),
            ("IH1", "ih"),
            ("K", "k"),
            ("OY1", "oy"),
        ] {
            assert_eq!(cmu(cmu_name).map(Phone::name), Some(ours), "{cmu_name}");
        }
        assert_eq!(cmu("QQ1"), None);
        assert_eq!(cmu(""), None);
        assert_eq!(cmu("sil"), None);
    }

    #[test]
    fn closures_join_their_release() {
        assert_eq!(
            fold("h# bcl b iy tcl ch dcl jh kcl h#"),
            "sil:0-1 b:1-3 iy:3-4 ch:4-6 jh:6-8 k:8-9 sil:9-10"
        );
        // A closure before another stop's release stays a stop of its own.
        assert_eq!(fold("h# tcl b aa h#"), "sil:0-1 t:1-2 b:2-3 aa:3-4 sil:4-5");
    }

    #[test]
    fn glottal_stops_join_a_neighbour() {
        assert_eq!(fold("h# q aa m h#"), "sil:0-1 aa:1-3 m:3-4 sil:4-5");
        assert_eq!(fold("h# aa q pau m h#"), "sil:0-1 aa:1-3 sp:3-4 m:4-5 sil:5-6");
        assert_eq!(fold("aa q"), "aa:0-2");
    }

    #[test]
    fn silences_join_and_are_long_at_the_ends() {
        assert_eq!(
            fold("pau h# aa epi pau m pau"),
            "sil:0-2 aa:2-3 sp:3-5 m:5-6 sil:6-7"
        );
    }

    #[test]
    fn the_whole_timit_set_has_a_place() {
        let timit61 = "iy ih eh ey ae aa aw ay ah ao oy ow uh uw ux er ax ix axr ax-h jh ch b d g p t k dx s sh \
                       z zh f th v dh m n ng em nx en eng l r w y hh hv el bcl dcl gcl pcl tcl kcl q pau epi h#";
        assert_eq!(timit61.split_whitespace().count(), 61);
        for label in timit61.split_whitespace() {
            assert!(is_phone_label(label), "{label}");
            assert!(!fold(label).starts_with('?'), "{label}");
        }
        assert_eq!(fold("aa xx"), "? xx");
    }
}
