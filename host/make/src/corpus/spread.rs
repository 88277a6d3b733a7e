//! The words of a whole take spread over its pieces: a text without times, and pieces that were cut at pauses.
//!
//! First roughly: the phones that are recognised in all pieces are matched with the text's by dynamic programming, which wrong and missing words
//! disturb nearby only. Then around every cut: the two pieces together are aligned with the words that should be in them and some more
//! on either side, of which any may be left out, and a word belongs to the piece that holds its middle.
use std::ops::Range;

use lipstream_core::SAMPLE_RATE_HZ;
use rayon::prelude::*;

use super::heard::Ears;
use crate::align::judge::folded;
use crate::error::Result;
use crate::features::Word;
use lipstream::phones::Phone;

/// Words on either side of a cut's neighbours that may belong to them too.
const UNSURE: usize = 6;
/// Phones by which the rough match may be off the even course: two minutes of speech.
const BAND: usize = 1500;
/// What a phone costs that has no partner, and two that only look alike, where two different ones cost 1.
const ALONE: f32 = 0.7;
const ALIKE: f32 = 0.5;

/// For each piece (samples of `sound`) the words that are said in it.
pub(super) fn spread(
    ears: &Ears,
    sound: &[i16],
    pieces: &[Range<usize>],
    words: &[Word],
) -> Result<Vec<Range<usize>>> {
    let heard = pieces
        .par_iter()
        .map(|piece| Ok(ears.recogniser.recognise(&sound[piece.clone()])?.phones))
        .collect::<Result<Vec<_>>>()?;
    let heard: Vec<(usize, Phone)> = heard
        .iter()
        .enumerate()
        .flat_map(|(n, phones)| phones.iter().map(move |p| (n, folded(p.phone))))
        .filter(|(_, phone)| *phone != Phone::SIL)
        .collect();
    let mut begins = roughly(&heard, &text(words), pieces.len(), words.len());
    let cuts: Vec<Option<Cut>> = (0..pieces.len().saturating_sub(1).max(1))
        .into_par_iter()
        .map(|n| around(ears, sound, pieces, words, &begins, n))
        .collect();
    for (n, cut) in cuts.iter().enumerate() {
        let Some(cut) = cut else { continue };
        if n == 0 {
            begins[0] = cut.first;
        }
        if n + 1 < pieces.len() {
            begins[n + 1] = cut.at;
        }
        if n + 2 >= pieces.len() {
            begins[pieces.len()] = cut.end;
        }
    }
    for n in 1..begins.len() {
        begins[n] = begins[n].max(begins[n - 1]);
    }
    Ok(begins.windows(2).map(|pair| pair[0]..pair[1]).collect())
}

/// The phones of the text with the words that they belong to.
fn text(words: &[Word]) -> Vec<(usize, Phone)> {
    let of = |(n, word): (usize, &Word)| {
        let said = word.pronunciations.first().into_iter().flatten();
        let phones = said.filter_map(|name| Phone::from_name(name));
        phones.map(|p| (n, folded(p))).collect::<Vec<_>>()
    };
    words.iter().enumerate().flat_map(of).collect()
}

/// The first word of every piece, and the number of words behind them: the match of two sequences of phones with the least cost.
fn roughly(heard: &[(usize, Phone)], text: &[(usize, Phone)], pieces: usize, words: usize) -> Vec<usize> {
    let (n, m) = (text.len(), heard.len());
    let centre = |i: usize| i * m / n.max(1);
    let columns = |i: usize| centre(i).saturating_sub(BAND)..(centre(i) + BAND).min(m) + 1;
    let mut before: Vec<f32> = vec![f32::INFINITY; m + 1];
    let mut steps: Vec<Vec<u8>> = Vec::with_capacity(n + 1);
    for i in 0..=n {
        let mut row = vec![f32::INFINITY; m + 1];
        let mut step = Vec::new();
        for j in columns(i) {
            let mut best = if i + j == 0 {
                (0.0, STOP)
            } else {
                (f32::INFINITY, STOP)
            };
            let mut offer = |cost: f32, step: u8| {
                if cost < best.0 {
                    best = (cost, step);
                }
            };
            if i > 0 && j > 0 {
                offer(before[j - 1] + different(text[i - 1].1, heard[j - 1].1), BOTH);
            }
            if i > 0 {
                offer(before[j] + ALONE, TEXT);
            }
            if j > 0 {
                offer(row[j - 1] + ALONE, HEARD);
            }
            row[j] = best.0;
            step.push(best.1);
        }
        steps.push(step);
        before = row;
    }
    // From the end back: in which piece each word's phones were heard.
    let mut places: Vec<Vec<usize>> = vec![Vec::new(); words];
    let (mut i, mut j) = (n, m);
    while i + j > 0 {
        match steps[i].get(j - columns(i).start).copied().unwrap_or(STOP) {
            BOTH => {
                (i, j) = (i - 1, j - 1);
                if text[i].1 == heard[j].1 {
                    places[text[i].0].push(heard[j].0);
                }
            }
            TEXT => i -= 1,
            HEARD => j -= 1,
            _ => break,
        }
    }
    // A word is where the middle one of its phones that were heard is; one without any, where the word before is.
    let mut begins = vec![words; pieces + 1];
    let mut piece = 0;
    for (word, places) in places.iter_mut().enumerate() {
        places.sort_unstable();
        if let Some(place) = places.get(places.len() / 2) {
            piece = piece.max(*place);
        }
        for begin in &mut begins[..=piece] {
            *begin = (*begin).min(word);
        }
    }
    begins
}

/// Where a cell of the rough match comes from.
const STOP: u8 = 0;
const BOTH: u8 = 1;
const TEXT: u8 = 2;
const HEARD: u8 = 3;

fn different(a: Phone, b: Phone) -> f32 {
    match (a == b, a.viseme() == b.viseme()) {
        (true, _) => 0.0,
        (_, true) => ALIKE,
        _ => 1.0,
    }
}

/// What is said around a cut: the first word of the two pieces, the first behind the cut, the first behind both.
struct Cut {
    first: usize,
    at: usize,
    end: usize,
}

/// Looks at pieces `n` and `n + 1` together; none where the words do not fit there at all.
fn around(
    ears: &Ears,
    sound: &[i16],
    pieces: &[Range<usize>],
    words: &[Word],
    begins: &[usize],
    n: usize,
) -> Option<Cut> {
    let last = (n + 1).min(pieces.len() - 1);
    let samples: Vec<i16> = pieces[n..=last]
        .iter()
        .flat_map(|p| &sound[p.clone()])
        .copied()
        .collect();
    let from = begins[n].saturating_sub(UNSURE);
    let to = (begins[last + 1] + UNSURE).min(words.len());
    let unsure = (begins[n] - from + UNSURE, to - begins[last + 1] + UNSURE);
    let found = ears.aligner.some_words(&samples, &words[from..to], unsure).ok()?;
    let cut = pieces[n].len() as f64 / f64::from(SAMPLE_RATE_HZ);
    let (first, _) = found.first()?;
    let (end, _) = found.last()?;
    let behind = found.iter().find(|(_, middle)| *middle >= cut);
    Some(Cut {
        first: from + first,
        at: from + behind.map_or(end + 1, |(word, _)| *word),
        end: from + end + 1,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn phones(names: &str) -> Vec<Phone> {
        let named = names
            .split_whitespace()
            .map(|name| folded(Phone::from_name(name).unwrap()));
        named.collect()
    }

    /// Phones of words, or of pieces: groups parted by bars.
    fn grouped(groups: &str) -> Vec<(usize, Phone)> {
        let groups = groups.split('|').enumerate();
        groups
            .flat_map(|(n, g)| phones(g).into_iter().map(move |p| (n, p)))
            .collect()
    }

    #[test]
    fn words_find_their_pieces_through_errors() {
        let text = grouped("b ih n | b l uw | ae t | f ao r | n aw | s eh t | r eh d");
        // A phone heard as another, one not heard, one too many.
        let heard = grouped("b ih m b l uw t | f ao n aw w | s eh t r eh d");
        assert_eq!(roughly(&heard, &text, 3, 7), [0, 3, 5, 7]);
        // The text lacks the second piece's words, and has words that nobody says.
        let lacking = grouped("b ih n | b l uw | ae t | g r iy n | s eh t | r eh d");
        let begins = roughly(&heard, &lacking, 3, 6);
        assert_eq!((begins[0], begins[2], begins[3]), (0, 4, 6));
        assert_eq!(roughly(&heard, &[], 3, 0), [0, 0, 0, 0]);
        assert_eq!(roughly(&[], &text, 1, 7), [0, 7]);
    }
}
