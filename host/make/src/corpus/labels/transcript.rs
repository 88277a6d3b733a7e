//! Plain text to the words that are spoken: punctuation falls away, numbers are written out, GRID's file
//! names are read as the sentences that they code.
use unicode_normalization::UnicodeNormalization as _;

use super::SpokenWord;

/// Words of running text: letters and apostrophes, lower case. What stands in `<...>`, `[...]` or `{...}` is no
/// speech. Hyphens and other signs part words.
pub fn words(text: &str) -> Vec<SpokenWord> {
    let mut out = Vec::new();
    let mut token = String::new();
    let mut closing = None;
    // Some systems write é as e with an accent behind it; dictionaries and everybody else have one sign.
    let text: Vec<char> = text.nfc().chain([' ']).collect();
    for (at, &c) in text.iter().enumerate() {
        if let Some(end) = closing {
            if c == end {
                closing = None;
            }
            continue;
        }
        match c {
            '\u{2019}' | '\u{2018}' | '`' => token.push('\''),
            _ if is_letter(c) || c == '\'' => token.extend(c.to_lowercase()),
            // Separators inside numbers: 1,200 and 3.5.
            ',' | '.' if token.ends_with(|d: char| d.is_ascii_digit()) => token.push(c),
            _ => {
                finish(&token, &mut out);
                token.clear();
                closing = match c {
                    '<' => Some('>'),
                    '[' => Some(']'),
                    '{' => Some('}'),
                    _ => None,
                };
                // One that is never closed is a sign like others: "I <3 you".
                closing = closing.filter(|end| text[at..].contains(end));
                if let Some((_, word)) = SIGNS.iter().find(|(sign, _)| *sign == c) {
                    finish(word, &mut out);
                }
                if let Some((_, said)) = FRACTIONS.iter().find(|(sign, _)| *sign == c) {
                    let before = text[..at].iter().rfind(|c| !c.is_whitespace());
                    if before.is_some_and(char::is_ascii_digit) {
                        finish("and", &mut out);
                    }
                    said.iter().for_each(|word| finish(word, &mut out));
                }
            }
        }
    }
    out
}

/// Whether a word can hold it. A fraction in one sign is numeric to Unicode, but words of its own.
fn is_letter(c: char) -> bool {
    c.is_alphanumeric() && !FRACTIONS.iter().any(|(sign, _)| *sign == c)
}

/// Signs that are said.
const SIGNS: [(char, &str); 7] = [
    ('&', "and"),
    ('%', "percent"),
    ('=', "equals"),
    ('+', "plus"),
    ('@', "at"),
    ('\u{d7}', "times"),
    ('\u{b0}', "degrees"),
];

/// Fractions in one sign. Behind a number they are said with "and": "two and a half".
const FRACTIONS: [(char, &[&str]); 5] = [
    ('\u{bd}', &["a", "half"]),
    ('\u{bc}', &["a", "quarter"]),
    ('\u{be}', &["three", "quarters"]),
    ('\u{2153}', &["a", "third"]),
    ('\u{2154}', &["two", "thirds"]),
];

fn finish(token: &str, out: &mut Vec<SpokenWord>) {
    let mut push = |text: &str| {
        out.push(SpokenWord {
            text: text.to_owned(),
            time: None,
            letter_name: false,
        });
    };
    let token = token.trim_matches(['\'', ',', '.']);
    if !token.contains(|c: char| c.is_ascii_digit()) {
        // A quote in mid-word would only hide the word from the dictionary; "don't" keeps its own.
        if token.contains(char::is_alphabetic) {
            push(token);
        }
        return;
    }
    let whole = match token.split_once('.') {
        Some((whole, behind)) => format!("{}.{behind}", without_thousands(whole)),
        None => without_thousands(token),
    };
    if let Some(said) = ordinal(token) {
        said.iter().for_each(|word| push(word));
        return;
    }
    // Behind the point of a decimal number figures are said one by one.
    if let Some((whole, behind)) = whole.split_once('.')
        && [whole, behind]
            .iter()
            .all(|part| !part.is_empty() && part.bytes().all(|b| b.is_ascii_digit()))
    {
        number(whole).iter().for_each(|word| push(word));
        push("point");
        behind
            .bytes()
            .for_each(|digit| push(ONES[usize::from(digit - b'0')]));
        return;
    }
    for (i, part) in whole.split(['.', ',']).enumerate() {
        if i > 0 && !whole.contains(',') {
            push("point");
        }
        for run in runs(part) {
            if run.starts_with(|c: char| c.is_ascii_digit()) {
                number(run).iter().for_each(|w| push(w));
            } else {
                push(run);
            }
        }
    }
}

/// "1,200" without its comma; "1,2" as it is.
fn without_thousands(token: &str) -> String {
    let mut groups = token.split(',');
    let first = groups.next().unwrap_or_default();
    let grouped = (1..=3).contains(&first.len())
        && groups.all(|g| g.len() == 3 && g.bytes().all(|b| b.is_ascii_digit()));
    if grouped {
        token.replace(',', "")
    } else {
        token.to_owned()
    }
}

/// Runs of digits and of other characters: "b52" is "b", "52".
fn runs(token: &str) -> impl Iterator<Item = &str> {
    let mut rest = token;
    std::iter::from_fn(move || {
        let digit = rest.chars().next()?.is_ascii_digit();
        let end = rest
            .find(|c: char| c.is_ascii_digit() != digit)
            .unwrap_or(rest.len());
        let (run, tail) = rest.split_at(end);
        rest = tail;
        Some(run)
    })
}

const ONES: [&str; 20] = [
    "zero",
    "one",
    "two",
    "three",
    "four",
    "five",
    "six",
    "seven",
    "eight",
    "nine",
    "ten",
    "eleven",
    "twelve",
    "thirteen",
    "fourteen",
    "fifteen",
    "sixteen",
    "seventeen",
    "eighteen",
    "nineteen",
];
const TENS: [&str; 10] = [
    "", "", "twenty", "thirty", "forty", "fifty", "sixty", "seventy", "eighty", "ninety",
];

/// A run of digits in words: up to 999,999 as a number, longer ones and those that begin with 0 digit by digit.
fn number(digits: &str) -> Vec<&'static str> {
    let value = match digits.parse::<u32>() {
        Ok(value) if value < 1_000_000 && !(digits.len() > 1 && digits.starts_with('0')) => value as usize,
        _ => return digits.bytes().map(|d| ONES[usize::from(d - b'0')]).collect(),
    };
    let mut out = Vec::new();
    if value >= 1000 {
        below_thousand(value / 1000, &mut out);
        out.push("thousand");
    }
    if !value.is_multiple_of(1000) || value == 0 {
        below_thousand(value % 1000, &mut out);
    }
    out
}

fn below_thousand(value: usize, out: &mut Vec<&'static str>) {
    let mut rest = value;
    if rest >= 100 {
        out.extend([ONES[rest / 100], "hundred"]);
        rest %= 100;
        if rest == 0 {
            return;
        }
    }
    if rest >= 20 {
        out.push(TENS[rest / 10]);
        rest %= 10;
        if rest == 0 {
            return;
        }
    }
    out.push(ONES[rest]);
}

/// "3rd" and "21st" in words; None of what is no ordinal.
fn ordinal(token: &str) -> Option<Vec<&'static str>> {
    let digits = ["st", "nd", "rd", "th"]
        .iter()
        .find_map(|end| token.strip_suffix(end))?;
    let digits = &without_thousands(digits);
    if digits.is_empty() || !digits.bytes().all(|b| b.is_ascii_digit()) {
        return None;
    }
    let mut said = number(digits);
    let last = said.last_mut()?;
    *last = ORDINALS.iter().find(|(cardinal, _)| cardinal == last)?.1;
    Some(said)
}

/// The last word of a number, and of the ordinal that it becomes.
const ORDINALS: [(&str, &str); 30] = [
    ("zero", "zeroth"),
    ("one", "first"),
    ("two", "second"),
    ("three", "third"),
    ("four", "fourth"),
    ("five", "fifth"),
    ("six", "sixth"),
    ("seven", "seventh"),
    ("eight", "eighth"),
    ("nine", "ninth"),
    ("ten", "tenth"),
    ("eleven", "eleventh"),
    ("twelve", "twelfth"),
    ("thirteen", "thirteenth"),
    ("fourteen", "fourteenth"),
    ("fifteen", "fifteenth"),
    ("sixteen", "sixteenth"),
    ("seventeen", "seventeenth"),
    ("eighteen", "eighteenth"),
    ("nineteen", "nineteenth"),
    ("twenty", "twentieth"),
    ("thirty", "thirtieth"),
    ("forty", "fortieth"),
    ("fifty", "fiftieth"),
    ("sixty", "sixtieth"),
    ("seventy", "seventieth"),
    ("eighty", "eightieth"),
    ("ninety", "ninetieth"),
    ("hundred", "hundredth"),
    ("thousand", "thousandth"),
];

/// TIMIT's transcripts begin with the first and last sample: `0 38504 Would a tomboy ...`.
pub fn without_timit_head(text: &str) -> &str {
    let trimmed = text.trim_start();
    let Some(rest) = trimmed.strip_prefix("0 ") else {
        return text;
    };
    let end = rest.find(' ').unwrap_or(rest.len());
    match rest[..end].parse::<u32>() {
        Ok(samples) if samples >= 1000 && rest.len() > end => &rest[end..],
        _ => text,
    }
}

/// The sentence that a GRID file name codes (`sbwe5n`: set blue with e five now), if it codes one.
pub fn of_grid_name(stem: &str) -> Option<Vec<SpokenWord>> {
    let code: [u8; 6] = stem.as_bytes().try_into().ok()?;
    let pick = |table: &[(u8, &'static str)], key: u8| table.iter().find(|(k, _)| *k == key).map(|(_, w)| *w);
    let letter = std::str::from_utf8(&code[3..4])
        .ok()
        .filter(|l| code[3].is_ascii_lowercase() && *l != "w")?;
    let words = [
        pick(
            &[(b'b', "bin"), (b'l', "lay"), (b'p', "place"), (b's', "set")],
            code[0],
        )?,
        pick(
            &[(b'b', "blue"), (b'g', "green"), (b'r', "red"), (b'w', "white")],
            code[1],
        )?,
        pick(
            &[(b'a', "at"), (b'b', "by"), (b'i', "in"), (b'w', "with")],
            code[2],
        )?,
        letter,
        match code[4] {
            b'z' => "zero",
            digit @ b'0'..=b'9' => ONES[usize::from(digit - b'0')],
            _ => return None,
        },
        pick(
            &[(b'a', "again"), (b'n', "now"), (b'p', "please"), (b's', "soon")],
            code[5],
        )?,
    ];
    let word = |(i, text): (usize, &&str)| SpokenWord {
        text: (*text).to_owned(),
        time: None,
        letter_name: i == 3,
    };
    Some(words.iter().enumerate().map(word).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spoken(text: &str) -> String {
        let words: Vec<_> = words(text).into_iter().map(|w| w.text).collect();
        words.join(" ")
    }

    #[test]
    fn punctuation_falls_away() {
        assert_eq!(
            spoken("Don\u{2019}t ask me, \u{201C}please\u{201D} -- now!"),
            "don't ask me please now"
        );
        assert_eq!(
            spoken("well-known 'quoted' <noise> word [laughs loudly] end"),
            "well known quoted word end"
        );
        assert_eq!(spoken(" \t\n ... '' "), "");
        // What is never closed swallows nothing.
        assert_eq!(spoken("I <3 you and [all of them"), "i three you and all of them");
        assert_eq!(spoken("this {and <b>that"), "this and that");
        // Composed or not, a letter is a letter.
        assert_eq!(spoken("a nai\u{308}ve caf\u{e9}"), "a naïve café");
        assert_eq!(
            spoken("salt & pepper, 50 % of it"),
            "salt and pepper fifty percent of it"
        );
        assert_eq!(
            spoken("1 + 2 at 30\u{b0}, 3\u{d7}4; c++"),
            "one plus two at thirty degrees three times four c plus plus"
        );
        assert_eq!(
            spoken("\u{bd} cup, 2\u{bd} or 3 \u{be} spoons, not \u{2153}."),
            "a half cup two and a half or three and three quarters spoons not a third"
        );
    }

    #[test]
    fn numbers_are_written_out() {
        assert_eq!(spoken("0"), "zero");
        assert_eq!(spoken("42."), "forty two");
        assert_eq!(spoken("115 and 900"), "one hundred fifteen and nine hundred");
        assert_eq!(spoken("1,200"), "one thousand two hundred");
        assert_eq!(spoken("1,2"), "one two");
        assert_eq!(spoken("12000"), "twelve thousand");
        assert_eq!(spoken("3.5"), "three point five");
        assert_eq!(
            spoken("pi is 3.14, not 3.05."),
            "pi is three point one four not three point zero five"
        );
        assert_eq!(spoken("1,200.25"), "one thousand two hundred point two five");
        assert_eq!(
            spoken("the 3rd, 21st and 12TH"),
            "the third twenty first and twelfth"
        );
        assert_eq!(
            spoken("1,000th 100th 30th 111th"),
            "one thousandth one hundredth thirtieth one hundred eleventh"
        );
        assert_eq!(spoken("b2nd"), "b two nd");
        assert_eq!(spoken("B52"), "b fifty two");
        assert_eq!(spoken("007"), "zero zero seven");
        assert_eq!(spoken("12345678").split(' ').count(), 8);
    }

    #[test]
    fn timit_and_grid_conventions() {
        assert_eq!(without_timit_head("0 38504 Would a tomboy"), " Would a tomboy");
        assert_eq!(without_timit_head("0 1 2 go"), "0 1 2 go");
        assert_eq!(without_timit_head("plain words"), "plain words");
        let words = of_grid_name("sbwe5n").unwrap();
        let texts: Vec<_> = words.iter().map(|w| w.text.as_str()).collect();
        assert_eq!(texts, ["set", "blue", "with", "e", "five", "now"]);
        assert!(words[3].letter_name && !words[0].letter_name);
        assert!(of_grid_name("lwbszp").is_some());
        for other in ["sbww5n", "sbwe5", "sbwe5nn", "clip01", "sbwe5x", "sbweé"] {
            assert!(of_grid_name(other).is_none(), "{other}");
        }
    }
}
