//! Whether a text is what is said: its forced alignment against what is heard without any text.
//!
//! Words that are said explain their sound about as well as the best phones do; a wrong word, or a word spread over others that the text lacks,
//! explains it much worse.
use super::{Alignment, SpokenWord};

/// Nats a frame of 5 ms by which the phones that are heard may explain a word's sound better than the word does, and by which they may explain
/// all words' better. Chosen on GRID's training clips and on TIMIT's training speakers, whom the shipped model has not heard (docs/alignment.md).
const MOST_OF_A_WORD: f64 = 10.0;
const MOST_OF_ALL: f64 = 4.5;
/// A word shorter than this is judged together with its neighbours (s).
const LEAST_S: f64 = 0.3;

/// How much worse a text explains a sound than what is heard in it, in nats a frame of 5 ms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// The word that explains its sound worst.
    pub worst: f64,
    /// All words, over their frames.
    pub all: f64,
}

impl Fit {
    /// Judges the alignment of a text by what is recognised in the same sound; none without words.
    pub fn of(aligned: &Alignment, heard: &Alignment) -> Option<Self> {
        let behind = |from: f64, to: f64| mean(heard, from, to) - mean(aligned, from, to);
        let of_word = |word: &SpokenWord| {
            let more = 0.5 * (LEAST_S - (word.end - word.start)).max(0.0);
            behind(
                (word.start - more).max(0.0),
                (word.end + more).min(aligned.duration),
            )
        };
        let worst = aligned.words.iter().map(of_word).max_by(f64::total_cmp)?;
        let (mut sum, mut seconds) = (0.0, 0.0);
        for word in &aligned.words {
            sum += (word.end - word.start) * behind(word.start, word.end);
            seconds += word.end - word.start;
        }
        Some(Self {
            worst,
            all: sum / seconds.max(LEAST_S),
        })
    }

    /// Whether the text is what is said, as far as can be heard.
    pub fn says(self) -> bool {
        self.worst <= MOST_OF_A_WORD && self.all <= MOST_OF_ALL
    }
}

impl std::fmt::Display for Fit {
    /// The score, and what it may be at most.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{:.1} nats a frame worse than any sounds would, the worst word {:.1}; at most {MOST_OF_ALL} and {MOST_OF_A_WORD} where a text is said",
            self.all, self.worst
        )
    }
}

/// Mean log likelihood of a frame between two moments.
fn mean(of: &Alignment, from: f64, to: f64) -> f64 {
    let (mut sum, mut seconds) = (0.0, 0.0);
    for phone in &of.phones {
        let shared = (phone.end.min(to) - phone.start.max(from)).max(0.0);
        sum += shared * phone.score;
        seconds += shared;
    }
    if seconds > 0.0 { sum / seconds } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::Spoken;
    use lipstream::phones::Phone;

    fn alignment(scores: [f64; 4], words: &[(f64, f64)]) -> Alignment {
        let phone = |(n, score): (usize, f64)| Spoken {
            phone: Phone::SIL,
            start: 0.5 * n as f64,
            end: 0.5 * (n + 1) as f64,
            word: None,
            score,
        };
        let word = |&(start, end): &(f64, f64)| SpokenWord {
            text: "word".into(),
            start,
            end,
        };
        Alignment {
            duration: 2.0,
            phones: scores.into_iter().enumerate().map(phone).collect(),
            words: words.iter().map(word).collect(),
            log_likelihood: scores.iter().sum::<f64>() / 4.0,
        }
    }

    #[test]
    fn the_worst_word_and_all_of_them_are_judged() {
        let heard = alignment([-50.0; 4], &[]);
        let said = [(0.5, 1.0), (1.0, 1.5)];
        let right = Fit::of(&alignment([-50.0, -51.0, -50.0, -50.0], &said), &heard).unwrap();
        assert!(
            (right.worst - 1.0).abs() < 1e-9 && (right.all - 0.5).abs() < 1e-9,
            "{right:?}"
        );
        assert!(right.says());
        let one_wrong = Fit::of(&alignment([-50.0, -41.0, -62.0, -50.0], &said), &heard).unwrap();
        assert!(
            (one_wrong.worst - 12.0).abs() < 1e-9 && !one_wrong.says(),
            "{one_wrong:?}"
        );
        let all_wrong = Fit::of(&alignment([-50.0, -55.0, -56.0, -50.0], &said), &heard).unwrap();
        assert!(
            (all_wrong.all - 5.5).abs() < 1e-9 && !all_wrong.says(),
            "{all_wrong:?}"
        );
        // A short word is judged with what is around it.
        let short = Fit::of(&alignment([-50.0, -50.0, -90.0, -50.0], &[(1.0, 1.1)]), &heard).unwrap();
        assert!((short.worst - 40.0 * 0.2 / 0.3).abs() < 1e-6, "{short:?}");
        assert_eq!(Fit::of(&heard, &heard), None);
    }
}
