//! From letters to sounds, for words that no dictionary has.
//!
//! Every letter of a word speaks 0, 1 or 2 phones. Which letter of CMUdict's words speaks which of their phones
//! is found by hard EM over P(phones | letter); then the phones of each letter in each context of neighbouring
//! letters are counted. An unknown letter takes the most frequent phones of the widest context that was seen.
//! The rules are learnt when the first unknown word comes (about a second), from all words but one in fifty:
//! those are kept for the test ([`held_out`]), which measures the phone error rate.
use std::collections::HashMap;

use rayon::prelude::*;

use crate::hash::fnv1a;
use lipstream::phones::Phone;

/// Letters to the left and to the right of the letter in question, widest context first.
const CONTEXTS: [(usize, usize); 9] = [
    (4, 4),
    (3, 4),
    (3, 3),
    (2, 3),
    (2, 2),
    (1, 2),
    (1, 1),
    (0, 1),
    (0, 0),
];

/// A wide context counts from so many letters on; the narrowest counts always.
const LEAST_COUNT: u32 = 2;

/// Rounds of hard EM for the alignment.
const ROUNDS: usize = 5;

/// Stands before and after a word.
const EDGE: u8 = b'_';

/// Phones of one letter: none, one or two.
type Chunk = [Option<Phone>; 2];

/// What one letter speaks in every context seen.
pub struct Rules {
    /// For each of [`CONTEXTS`]: (hash of the context, most frequent chunk, letters counted), by hash.
    levels: Vec<Vec<(u64, Chunk, u32)>>,
}

/// True for the words that are kept out of learning, about one in fifty.
pub fn held_out(word: &str) -> bool {
    hash(word.bytes()).is_multiple_of(50)
}

/// A hash whose low bits are mixed once more; only equality and spread matter.
fn hash(bytes: impl Iterator<Item = u8>) -> u64 {
    let h = fnv1a(bytes);
    (h ^ (h >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9)
}

/// A word in the letters a-z: accents fall away, other scripts and signs too.
pub fn plain(word: &str) -> String {
    let mut out = String::new();
    for c in word.to_lowercase().chars() {
        match c {
            'a'..='z' => out.push(c),
            'à' | 'á' | 'â' | 'ã' | 'å' | 'ā' | 'ą' | 'ă' => out.push('a'),
            'ä' | 'æ' => out.push_str("ae"),
            'ç' | 'ć' | 'č' => out.push('c'),
            'ď' | 'ð' | 'đ' => out.push('d'),
            'è' | 'é' | 'ê' | 'ë' | 'ē' | 'ę' | 'ě' => out.push('e'),
            'ğ' => out.push('g'),
            'ì' | 'í' | 'î' | 'ï' | 'ī' | 'ı' => out.push('i'),
            'ł' | 'ľ' => out.push('l'),
            'ñ' | 'ń' | 'ň' => out.push('n'),
            'ò' | 'ó' | 'ô' | 'õ' | 'ø' | 'ō' => out.push('o'),
            'ö' | 'œ' => out.push_str("oe"),
            'ř' => out.push('r'),
            'ś' | 'ş' | 'ș' => out.push('s'),
            'š' => out.push_str("sh"),
            'ß' => out.push_str("ss"),
            'ť' | 'ţ' | 'ț' => out.push('t'),
            'þ' => out.push_str("th"),
            'ù' | 'ú' | 'û' | 'ū' | 'ů' | 'ű' => out.push('u'),
            'ü' => out.push_str("ue"),
            'ý' | 'ÿ' => out.push('y'),
            'ź' | 'ż' | 'ž' => out.push('z'),
            _ => {}
        }
    }
    out
}

/// P(chunk | letter) by relative frequency, in natural logs; unseen chunks get a floor.
struct Emission(HashMap<(u8, Chunk), f64>);

const FLOOR: f64 = -14.0;

impl Emission {
    fn new(counts: &HashMap<(u8, Chunk), f64>) -> Self {
        let mut totals = [0.0f64; 256];
        for ((letter, _), n) in counts {
            totals[usize::from(*letter)] += n;
        }
        let log = |(key, n): (&(u8, Chunk), &f64)| (*key, (n / totals[usize::from(key.0)]).ln().max(FLOOR));
        Self(counts.iter().map(log).collect())
    }

    fn get(&self, letter: u8, chunk: Chunk) -> f64 {
        *self.0.get(&(letter, chunk)).unwrap_or(&FLOOR)
    }
}

fn chunk(phones: &[Phone]) -> Chunk {
    [phones.first().copied(), phones.get(1).copied()]
}

/// The best way to deal a word's phones out to its letters, at most two each; None when there are too many.
fn align(letters: &[u8], phones: &[Phone], emission: &Emission) -> Option<Vec<Chunk>> {
    let width = phones.len() + 1;
    let mut best = vec![f64::NEG_INFINITY; (letters.len() + 1) * width];
    let mut taken = vec![0u8; best.len()];
    best[0] = 0.0;
    for (i, letter) in letters.iter().enumerate() {
        for j in 0..width {
            let so_far = best[i * width + j];
            if so_far == f64::NEG_INFINITY {
                continue;
            }
            for n in 0..=2usize.min(phones.len() - j) {
                let score = so_far + emission.get(*letter, chunk(&phones[j..j + n]));
                let to = (i + 1) * width + j + n;
                if score > best[to] {
                    best[to] = score;
                    taken[to] = n as u8;
                }
            }
        }
    }
    let mut j = phones.len();
    if best[letters.len() * width + j] == f64::NEG_INFINITY {
        return None;
    }
    let mut chunks = vec![[None; 2]; letters.len()];
    for i in (0..letters.len()).rev() {
        let n = usize::from(taken[(i + 1) * width + j]);
        j -= n;
        chunks[i] = chunk(&phones[j..j + n]);
    }
    Some(chunks)
}

/// First counts: letter i of L speaks the phones around i·P/L, nothing with some weight, two rarely.
fn first_counts(words: &[(String, Vec<Phone>)]) -> HashMap<(u8, Chunk), f64> {
    let mut counts: HashMap<(u8, Chunk), f64> = HashMap::new();
    for (word, phones) in words {
        for (i, letter) in word.bytes().enumerate() {
            let centre = i * phones.len() / word.len();
            *counts.entry((letter, [None; 2])).or_default() += 0.5;
            for at in centre.saturating_sub(1)..(centre + 2).min(phones.len()) {
                let weight = if at == centre { 1.0 } else { 0.5 };
                *counts.entry((letter, chunk(&phones[at..at + 1]))).or_default() += weight;
                if at + 2 <= phones.len() {
                    *counts.entry((letter, chunk(&phones[at..at + 2]))).or_default() += 0.02;
                }
            }
        }
    }
    counts
}

/// Hash of the context (l, r) of letter `at` in `padded`, which has four edges before and after the word.
fn context(padded: &[u8], at: usize, (l, r): (usize, usize)) -> u64 {
    hash(padded[at - l..=at + r].iter().copied())
}

fn padded(word: &str) -> Vec<u8> {
    [EDGE; 4]
        .into_iter()
        .chain(word.bytes())
        .chain([EDGE; 4])
        .collect()
}

impl Rules {
    /// Learns from words (a-z only) and one pronunciation each.
    pub fn learn(words: &[(String, Vec<Phone>)]) -> Self {
        let mut emission = Emission::new(&first_counts(words));
        let mut aligned: Vec<Option<Vec<Chunk>>> = Vec::new();
        for _ in 0..ROUNDS {
            aligned = words
                .par_iter()
                .map(|(word, phones)| align(word.as_bytes(), phones, &emission))
                .collect();
            let mut counts: HashMap<(u8, Chunk), f64> = HashMap::new();
            for ((word, _), chunks) in words.iter().zip(&aligned) {
                for (letter, chunk) in word.bytes().zip(chunks.iter().flatten()) {
                    *counts.entry((letter, *chunk)).or_default() += 1.0;
                }
            }
            emission = Emission::new(&counts);
        }
        let levels = CONTEXTS
            .par_iter()
            .map(|size| {
                let mut seen: Vec<(u64, Chunk)> = Vec::new();
                for ((word, _), chunks) in words.iter().zip(&aligned) {
                    let padded = padded(word);
                    let keyed = chunks.iter().flatten().enumerate();
                    seen.extend(keyed.map(|(i, chunk)| (context(&padded, i + 4, *size), *chunk)));
                }
                seen.sort_unstable();
                seen.chunk_by(|a, b| a.0 == b.0)
                    .map(|same| {
                        let top = same.chunk_by(|a, b| a.1 == b.1).max_by_key(|c| c.len());
                        let chunk = top.map_or([None; 2], |c| c[0].1);
                        (same[0].0, chunk, same.len() as u32)
                    })
                    .collect()
            })
            .collect();
        Self { levels }
    }

    /// Pronunciation of a word of the letters a-z.
    pub fn pronounce(&self, word: &str) -> Vec<Phone> {
        let padded = padded(word);
        let mut out: Vec<Phone> = Vec::new();
        for at in 4..padded.len() - 4 {
            let known = CONTEXTS.iter().zip(&self.levels).find_map(|(size, level)| {
                let key = context(&padded, at, *size);
                let found = level.binary_search_by_key(&key, |e| e.0).ok()?;
                (level[found].2 >= LEAST_COUNT || *size == (0, 0)).then_some(level[found].1)
            });
            out.extend(known.into_iter().flatten().flatten());
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn phones(text: &str) -> Vec<Phone> {
        text.split(' ').map(|p| Phone::from_name(p).unwrap()).collect()
    }

    #[test]
    fn letters_are_aligned_with_what_they_speak() {
        let words: Vec<_> = [
            ("tax", "t ae k s"),
            ("cat", "k ae t"),
            ("tack", "t ae k"),
            ("at", "ae t"),
            ("ax", "ae k s"),
            ("fax", "f ae k s"),
            ("fat", "f ae t"),
        ]
        .map(|(w, p)| (w.to_owned(), phones(p)))
        .to_vec();
        let rules = Rules::learn(&words);
        assert_eq!(rules.pronounce("cax"), phones("k ae k s"));
        assert_eq!(rules.pronounce("taf"), phones("t ae f"));
    }

    #[test]
    fn more_phones_than_letters_can_speak() {
        let words = vec![("w".to_owned(), phones("d ah b ax l"))];
        let rules = Rules::learn(&words);
        assert!(rules.pronounce("w").is_empty());
    }

    #[test]
    fn accents_fall_away() {
        assert_eq!(plain("Éclair-ß3"), "eclairss");
        assert_eq!(plain("да"), "");
    }
}
