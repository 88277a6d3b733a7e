//! Lip-readability: how many words a lip reader who learnt from true mouths reads off a system's mouth.
//!
//! The reader is linear discriminant analysis with the shrinkage of Ledoit and Wolf (J. Multivariate Analysis 88, 2004), fitted on the true mouths of the training clips: a word is its first
//! sixteen mouth parameters at twelve points from a little before its label to a little after it. It is told where a word lies and between which words
//! to choose: where all clips have the same number of words, as in GRID, those that stand in the same place of a sentence, else all words with examples enough.
use std::collections::{BTreeMap, HashMap};

use nalgebra::{DMatrix, DVector};
use ndarray::Array2;
use serde::Serialize;

use super::Truth;
use super::bootstrap::{Draws, Interval};
use crate::error::{Error, Result, ensure};
use crate::features::Word;

/// Mouth parameters that are looked at: the motion that can be seen.
const PARAMETERS: usize = 16;
/// Moments of a word.
const POINTS: usize = 12;
/// Seconds by which the first and the last moment lie outside the word's label: lips are early.
const MARGIN_S: f32 = 0.08;
/// Training examples that a word must have to be chosen from.
const LEAST_EXAMPLES: usize = 5;

/// A lip reader.
pub struct Reader {
    /// Whether words are told apart by their place in the sentence only.
    by_place: bool,
    deviation: Vec<f32>,
    /// Of each place, or of all words.
    groups: Vec<Group>,
}

/// Words between which the reader chooses, each with the vector and the number of its discriminant.
struct Group {
    words: Vec<String>,
    weights: DMatrix<f64>,
    offsets: DVector<f64>,
}

/// Words read rightly and words shown, group by group.
pub type Read = Vec<(u32, u32)>;

/// What a reader makes of some mouths.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Readable {
    /// Share of the words that are read rightly, averaged over the groups.
    pub accuracy: Interval,
    /// The same as a share of that on true mouths.
    pub of_true: Interval,
}

impl Reader {
    /// Learns from the true mouths of `truths`, whose words have times.
    ///
    /// # Errors
    ///
    /// [`Error::Data`] where nothing can be chosen between: no timed words, or fewer than two with examples enough.
    pub fn learn(truths: &[Truth]) -> Result<Self> {
        let timed = |truth: &&Truth| {
            !truth.clip.words.is_empty() && truth.clip.words.iter().all(|w| w.time.is_some())
        };
        let truths: Vec<&Truth> = truths.iter().filter(timed).collect();
        let mut lengths = truths.iter().map(|truth| truth.clip.words.len());
        let first = lengths.next();
        let mut reader = Self {
            by_place: first.is_some() && lengths.all(|n| Some(n) == first),
            deviation: deviations(&truths),
            groups: Vec::new(),
        };
        let mut examples: BTreeMap<usize, BTreeMap<String, Vec<DVector<f64>>>> = BTreeMap::new();
        for truth in &truths {
            for (place, word) in truth.clip.words.iter().enumerate() {
                let group = examples.entry(reader.group(place)).or_default();
                let shown = reader.shown(word, &truth.visual);
                group.entry(word.text.to_lowercase()).or_default().extend(shown);
            }
        }
        for mut words in examples.into_values() {
            words.retain(|_, shown| shown.len() >= LEAST_EXAMPLES);
            reader.groups.push(Group::fit(&words)?);
        }
        ensure!(
            reader.groups.iter().any(|group| group.words.len() > 1),
            Data,
            "no two words with times are said {LEAST_EXAMPLES} times in training clips: there is nothing to choose between"
        );
        Ok(reader)
    }

    fn group(&self, place: usize) -> usize {
        if self.by_place { place } else { 0 }
    }

    /// The word's moments, none where the mouth ends before it.
    fn shown(&self, word: &Word, mouth: &Array2<f32>) -> Option<DVector<f64>> {
        let (start, end) = word.time?;
        let last = mouth.nrows().checked_sub(1)? as f32;
        if start * 100.0 >= last {
            return None;
        }
        let (from, to) = ((start - MARGIN_S) * 100.0, (end + MARGIN_S) * 100.0);
        let numbers = (0..POINTS).flat_map(|n| {
            let at = (from + (to - from) * n as f32 / (POINTS - 1) as f32).clamp(0.0, last);
            let (before, part) = (at as usize, at.fract());
            let after = (before + 1).min(last as usize);
            let between = move |d: usize| mouth[[before, d]] * (1.0 - part) + mouth[[after, d]] * part;
            let deviation = &self.deviation;
            (0..deviation.len()).map(move |d| f64::from(between(d) / deviation[d]))
        });
        Some(DVector::from_iterator(POINTS * self.deviation.len(), numbers))
    }

    /// Reads `mouth`, which should say these words.
    pub fn read(&self, words: &[Word], mouth: &Array2<f32>) -> Read {
        let mut read = vec![(0, 0); self.groups.len()];
        for (place, word) in words.iter().enumerate() {
            let n = self.group(place);
            let Some(group) = self.groups.get(n).filter(|group| group.words.len() > 1) else {
                continue;
            };
            let text = word.text.to_lowercase();
            let (true, Some(shown)) = (group.words.contains(&text), self.shown(word, mouth)) else {
                continue;
            };
            read[n].0 += u32::from(group.choose(&shown) == text);
            read[n].1 += 1;
        }
        read
    }
}

fn deviations(truths: &[&Truth]) -> Vec<f32> {
    let size = truths.first().map_or(0, |t| t.visual.ncols().min(PARAMETERS));
    (0..size)
        .map(|d| {
            let all = truths.iter().flat_map(|t| t.visual.column(d));
            let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
            for &v in all {
                n += 1.0;
                sum += f64::from(v);
                squares += f64::from(v).powi(2);
            }
            let n = f64::max(n, 1.0);
            (squares / n - (sum / n).powi(2)).max(1e-12).sqrt() as f32
        })
        .collect()
}

impl Group {
    /// The discriminants of words with examples; none of fewer than two words.
    fn fit(examples: &BTreeMap<String, Vec<DVector<f64>>>) -> Result<Self> {
        let words: Vec<String> = examples.keys().cloned().collect();
        let size = examples.values().flatten().next().map_or(0, DVector::len);
        let means: Vec<DVector<f64>> = examples
            .values()
            .map(|shown| shown.iter().sum::<DVector<f64>>() / shown.len() as f64)
            .collect();
        let around = examples
            .values()
            .zip(&means)
            .flat_map(|(shown, mean)| shown.iter().map(move |x| x - mean));
        let around: Vec<DVector<f64>> = around.collect();
        let means = DMatrix::from_fn(size, words.len(), |i, k| means[k][i]);
        if words.len() < 2 {
            return Ok(Self {
                offsets: DVector::zeros(words.len()),
                weights: means,
                words,
            });
        }
        let covariance = shrunk(&around, size);
        let weights = covariance
            .cholesky()
            .ok_or_else(|| Error::Numbers("the spread of shown words is singular".into()))?
            .solve(&means);
        let n = around.len() as f64;
        let offsets = examples
            .values()
            .enumerate()
            .map(|(k, shown)| (shown.len() as f64 / n).ln() - 0.5 * weights.column(k).dot(&means.column(k)));
        Ok(Self {
            offsets: DVector::from_iterator(words.len(), offsets),
            weights,
            words,
        })
    }

    fn choose(&self, shown: &DVector<f64>) -> &str {
        let scores = self.weights.tr_mul(shown) + &self.offsets;
        &self.words[scores.imax()]
    }
}

/// Covariance of vectors without their means, drawn towards a multiple of the unit matrix as far as Ledoit and Wolf's estimate says.
fn shrunk(around: &[DVector<f64>], size: usize) -> DMatrix<f64> {
    let n = around.len() as f64;
    let rows = DMatrix::from_fn(around.len(), size, |i, j| around[i][j]);
    let covariance = rows.tr_mul(&rows) / n;
    let scale = (covariance.trace() / size as f64).max(1e-9);
    let target = DMatrix::identity(size, size) * scale;
    let off = (&covariance - &target).norm_squared();
    let fourth: f64 = around.iter().map(|x| x.norm_squared().powi(2)).sum();
    let noise = ((fourth / n - covariance.norm_squared()) / n).clamp(0.0, off);
    let share = if off > 0.0 { (noise / off).max(1e-6) } else { 1.0 };
    covariance * (1.0 - share) + target * share
}

/// Accuracy averaged over groups that have shown anything.
fn accuracy<'a>(clips: impl Iterator<Item = &'a Read>) -> f64 {
    let mut sums: HashMap<usize, (u32, u32)> = HashMap::new();
    for read in clips {
        for (n, &(right, all)) in read.iter().enumerate() {
            let sum = sums.entry(n).or_default();
            sum.0 += right;
            sum.1 += all;
        }
    }
    let mut shares: Vec<(usize, f64)> = sums
        .into_iter()
        .filter(|(_, (_, all))| *all > 0)
        .map(|(n, (right, all))| (n, f64::from(right) / f64::from(all)))
        .collect();
    // Sums of floats depend on their order.
    shares.sort_by_key(|(n, _)| *n);
    shares.iter().map(|(_, share)| share).sum::<f64>() / (shares.len() as f64).max(1.0)
}

/// How readable mouths are, clip by clip beside the true ones.
pub fn judge(said: &[Read], truths: &[Read], draws: &Draws) -> Readable {
    let pairs: Vec<(&Read, &Read)> = said.iter().zip(truths).collect();
    Readable {
        accuracy: draws.interval(&pairs, |clips| accuracy(clips.map(|(said, _)| *said))),
        of_true: draws.interval(&pairs, |clips| {
            let clips: Vec<&(&Read, &Read)> = clips.collect();
            let of_true = accuracy(clips.iter().map(|(_, truth)| *truth));
            accuracy(clips.iter().map(|(said, _)| *said)) / of_true.max(1e-9)
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::{Clip, PhonesFrom, Split};
    use rand::{RngExt as _, SeedableRng as _};
    use rand_pcg::Pcg64;

    const WORDS: [&str; 3] = ["bin", "lay", "set"];

    /// Two words a clip; each moves its own parameter, by `size`.
    fn clips(count: usize, size: f32, seed: u64) -> Vec<(Clip, Array2<f32>)> {
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut clip = |n: usize| {
            let said: Vec<usize> = (0..2).map(|_| rng.random_range(0..WORDS.len())).collect();
            let mut mouth = Array2::from_shape_fn((80, 4), |_| rng.random_range(-0.5..0.5f32));
            let words = said.iter().enumerate().map(|(place, &word)| {
                let (start, end) = (0.1 + 0.3 * place as f32, 0.3 + 0.3 * place as f32);
                for t in (start * 100.0) as usize..(end * 100.0) as usize {
                    mouth[[t, word]] += size;
                }
                Word {
                    text: WORDS[word].to_owned(),
                    pronunciations: vec![vec!["b".into()]],
                    time: Some((start, end)),
                }
            });
            let clip = Clip {
                id: format!("c{n}"),
                speaker: "s".into(),
                split: Split::Train,
                audio_frames: 80,
                video_frames: 20,
                video_hz: 25.0,
                words: words.collect(),
                phones: Vec::new(),
                phones_from: PhonesFrom::Labels,
            };
            (clip, mouth)
        };
        (0..count).map(&mut clip).collect()
    }

    fn truths(clips: &[(Clip, Array2<f32>)]) -> Vec<Truth<'_>> {
        clips
            .iter()
            .map(|(clip, mouth)| Truth {
                clip,
                audio: Array2::zeros((80, 39)),
                visual: mouth.clone(),
            })
            .collect()
    }

    fn read_all(reader: &Reader, clips: &[(Clip, Array2<f32>)]) -> Vec<Read> {
        clips
            .iter()
            .map(|(clip, mouth)| reader.read(&clip.words, mouth))
            .collect()
    }

    #[test]
    fn mouths_that_move_are_read_and_still_ones_are_guessed() {
        let learnt = clips(60, 1.0, 1);
        let reader = Reader::learn(&truths(&learnt)).unwrap();
        assert!(reader.by_place && reader.groups.len() == 2);
        let shown = clips(60, 1.0, 2);
        let own = read_all(&reader, &shown);
        let still: Vec<Read> = shown
            .iter()
            .map(|(clip, mouth)| reader.read(&clip.words, &Array2::zeros(mouth.dim())))
            .collect();
        let draws = Draws::new(shown.len(), 200, 1);
        let (own, still) = (judge(&own, &own, &draws), judge(&still, &own, &draws));
        assert!(own.accuracy.value > 0.97, "{own:?}");
        assert_eq!(own.of_true.value, 1.0);
        assert!((0.2..0.5).contains(&still.accuracy.value), "{still:?}");
        assert!(still.of_true.high < 0.6, "{still:?}");
    }

    #[test]
    fn sentences_of_any_length_choose_between_all_words() {
        let mut learnt = clips(60, 1.0, 3);
        learnt[0].0.words.truncate(1);
        let reader = Reader::learn(&truths(&learnt)).unwrap();
        assert!(!reader.by_place && reader.groups.len() == 1);
        let read = accuracy(read_all(&reader, &clips(40, 1.0, 4)).iter());
        assert!(read > 0.97, "{read}");
    }

    #[test]
    fn without_timed_words_there_is_nothing_to_read() {
        let mut learnt = clips(10, 1.0, 5);
        for (clip, _) in &mut learnt {
            clip.words.iter_mut().for_each(|word| word.time = None);
        }
        let error = Reader::learn(&truths(&learnt)).err().unwrap().to_string();
        assert!(error.contains("nothing to choose"), "{error}");
    }

    #[test]
    fn covariance_of_many_vectors_is_hardly_shrunk_and_of_few_ones_is() {
        let mut rng = Pcg64::seed_from_u64(6);
        let mut vectors = |n: usize| -> Vec<DVector<f64>> {
            let mut vector = || {
                let common: f64 = rng.random_range(-1.0..1.0);
                DVector::from_fn(4, |i, _| common * (i as f64 + 1.0) + rng.random_range(-0.5..0.5))
            };
            (0..n).map(|_| vector()).collect()
        };
        let (many, few) = (shrunk(&vectors(5000), 4), shrunk(&vectors(3), 4));
        // Uniform numbers in ±1 have a variance of 1/3.
        assert!((many[(1, 3)] - 8.0 / 3.0).abs() < 0.2, "{many}");
        assert!(few.cholesky().is_some());
    }
}
