//! Forced alignment: when each word and phone of a known text is said.
//!
//! The audio HMM alone follows the text's network (every pronunciation of every word, an optional pause between words) by
//! Viterbi. Sound is analysed every 5 ms instead of every 10, as two interleaved streams of the ordinary front end, so that
//! the densities are those of any model while five states take 25 ms and borders fall on a finer grid. What is left of
//! each kind of border's mean error on the training speakers is taken off ([`Shifts`]).
use lipstream_core::{FRAME_SAMPLES, HOP_SAMPLES, N_OBSERVATION, N_STATIC, SAMPLE_RATE_HZ};
use ndarray::Array2;

use crate::error::{Error, Result, bail};
use crate::features::{PhoneLabel, Word};
use lipstream::hmm::evaluator::Evaluator;
use lipstream::hmm::evaluator::Likelihoods;
use lipstream::hmm::forward_backward::viterbi;
use lipstream::hmm::graph::Graph;
use lipstream::hmm::joint::N_EMITTING;
use lipstream::hmm::network::PhoneNetwork;
use lipstream::hmm::topology::Topology;
use lipstream::phones::Phone;
use lipstream::reference::{self, Normalisation};

pub mod audio_hmm;
pub mod dialog;
pub mod fit;
pub mod judge;
pub mod recognise;
pub mod score;
mod shifts;
pub mod train;
pub mod write;

pub use audio_hmm::{AudioHmm, Bigram};
pub use recognise::Recogniser;
pub use shifts::Shifts;

/// Samples between two frames of an alignment: 5 ms.
pub const HOP: usize = HOP_SAMPLES / 2;

/// What is said when.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Alignment {
    /// Length of the sound in seconds.
    pub duration: f64,
    /// Every phone, pauses too, from 0 to the end without gaps.
    pub phones: Vec<Spoken>,
    /// The words of the text, each of at least one phone.
    pub words: Vec<SpokenWord>,
    /// Natural log likelihood of the sound along the best path, per frame.
    pub log_likelihood: f64,
}

/// A phone with its times in seconds.
#[derive(Clone, Debug, PartialEq)]
pub struct Spoken {
    /// What is said: a phone or a pause.
    pub phone: Phone,
    /// Where it begins, in seconds from the start of the sound.
    pub start: f64,
    /// Where it ends, in seconds from the start of the sound.
    pub end: f64,
    /// Index into the text's words; `None` for a pause.
    pub word: Option<usize>,
    /// Mean natural log likelihood of its frames.
    pub score: f64,
}

/// A word with its times in seconds.
#[derive(Clone, Debug, PartialEq)]
pub struct SpokenWord {
    /// The word as the text has it.
    pub text: String,
    /// Where its first phone begins, in seconds from the start of the sound.
    pub start: f64,
    /// Where its last phone ends, in seconds from the start of the sound.
    pub end: f64,
}

impl Alignment {
    /// Phones and pauses as labels; those of no length are left out.
    pub fn labels(&self) -> Vec<PhoneLabel> {
        let label = |p: &Spoken| PhoneLabel {
            phone: p.phone.name().to_owned(),
            start: p.start as f32,
            end: p.end as f32,
        };
        let labels = self.phones.iter().map(label);
        labels.filter(|l| l.end > l.start).collect()
    }

    /// Text of word `number`, as numbered in [`Spoken::word`].
    fn text(&self, number: usize) -> Option<&str> {
        Some(self.words.get(number)?.text.as_str())
    }
}

/// Observations every 5 ms, `[frames, 39]`: the front end over the sound, and over the sound half a hop later.
pub fn observations(samples: &[i16], start_mean: [f32; N_STATIC]) -> Array2<f32> {
    let normalisation = Normalisation::Causal { start_mean };
    let even = reference::observations(samples, normalisation);
    let odd = reference::observations(samples.get(HOP..).unwrap_or(&[]), normalisation);
    let frames = even.nrows() + odd.nrows();
    let mut out = Array2::zeros((frames, N_OBSERVATION));
    for t in 0..frames {
        let from = if t % 2 == 0 { &even } else { &odd };
        out.row_mut(t).assign(&from.row(t / 2));
    }
    out
}

/// Seconds at the middle of frame t's window.
pub fn frame_time(t: usize) -> f64 {
    (t * HOP + FRAME_SAMPLES / 2) as f64 / f64::from(SAMPLE_RATE_HZ)
}

/// Seconds between frame t − 1 and frame t.
fn border_time(t: usize) -> f64 {
    frame_time(t) - HOP as f64 / 2.0 / f64::from(SAMPLE_RATE_HZ)
}

/// A model made ready to align.
pub struct Aligner {
    hmm: AudioHmm,
    evaluator: Evaluator,
    /// Whether words may be parted by silences as between sentences.
    long_pauses: bool,
}

impl Aligner {
    /// Prepares the densities of `hmm` for evaluation.
    pub fn new(hmm: AudioHmm) -> Self {
        Self {
            evaluator: Evaluator::new(&hmm.audio),
            hmm,
            long_pauses: false,
        }
    }

    /// For texts of several sentences: their words may be parted by silences as well as by short pauses.
    pub fn with_long_pauses(self) -> Self {
        Self {
            long_pauses: true,
            ..self
        }
    }

    /// The network of a text; none where the model lacks silence or a phone of every way of saying a word.
    fn transcript(&self, words: &[Word]) -> Option<PhoneNetwork> {
        let network = PhoneNetwork::transcript(words, &|p| self.index(p))?;
        Some(match self.index(Phone::SIL).filter(|_| self.long_pauses) {
            Some(silence) => network.with_long_pauses(silence),
            None => network,
        })
    }

    /// Where a phone stands among the model's. A full vowel or consonant stands for a reduced or syllabic one that the model has never heard: to a
    /// border it is all the same.
    fn index(&self, phone: Phone) -> Option<usize> {
        let place = |phone: Phone| self.hmm.phones.iter().position(|p| *p == phone);
        let full = judge::folded(phone);
        place(phone).or_else(|| place(full).filter(|_| full != Phone::SIL))
    }

    /// Aligns words with 16 kHz mono samples.
    pub fn words(&self, samples: &[i16], words: &[Word]) -> Result<Alignment> {
        if words.is_empty() {
            bail!(Choice, "no words to align: give a transcript");
        }
        let lacking = |phone: &String| Phone::from_name(phone).and_then(|p| self.index(p)).is_none();
        if let Some(word) = words
            .iter()
            .find(|w| w.pronunciations.iter().all(|p| p.iter().any(lacking)))
        {
            bail!(
                Data,
                "the model has never heard a phone of {:?} ({}): train it on more speech",
                word.text,
                word.pronunciations[0].join(" ")
            );
        }
        let network = self.transcript(words).ok_or_else(|| {
            Error::Data("the model has no phone for silence, or the text has no words".into())
        })?;
        let mut alignment = self.network(samples, &network)?;
        for (number, word) in words.iter().enumerate() {
            let said = |p: &&mut Spoken| p.word == Some(number);
            let (mut start, mut end) = (None, 0.0);
            for phone in alignment.phones.iter_mut().filter(said) {
                start = start.or(Some(phone.start));
                end = phone.end;
                phone.word = Some(alignment.words.len());
            }
            // A silence written into a transcript is no word.
            if let Some(start) = start {
                alignment.words.push(SpokenWord {
                    text: word.text.clone(),
                    start,
                    end,
                });
            }
        }
        Ok(alignment)
    }

    /// Which of some words that follow each other are said, and the middle of each in seconds; any of the `unsure.0` first and the `unsure.1` last
    /// may not be.
    ///
    /// # Errors
    ///
    /// That no way of saying them fits the sound.
    pub fn some_words(
        &self,
        samples: &[i16],
        words: &[Word],
        unsure: (usize, usize),
    ) -> Result<Vec<(usize, f64)>> {
        let network = self
            .transcript(words)
            .ok_or_else(|| Error::Data("the text holds a phone that the model has never heard".into()))?;
        let alignment = self.network(samples, &network.with_open_ends(unsure.0, unsure.1))?;
        let said = |n: usize| {
            let mut of = alignment.phones.iter().filter(|p| p.word == Some(n));
            let first = of.next()?;
            Some((n, 0.5 * (first.start + of.next_back().unwrap_or(first).end)))
        };
        Ok((0..words.len()).filter_map(said).collect())
    }

    /// Aligns phones whose order is known (their times are not looked at).
    pub fn phones(&self, samples: &[i16], phones: &[PhoneLabel]) -> Result<Alignment> {
        let mut said: Vec<usize> = Vec::new();
        for label in phones {
            let index = Phone::from_name(&label.phone).and_then(|p| self.index(p));
            said.push(index.ok_or_else(|| {
                Error::Data(format!("the model has never heard the phone {}", label.phone))
            })?);
        }
        if said.is_empty() {
            bail!(Choice, "no phones to align");
        }
        self.network(samples, &PhoneNetwork::chain(&said))
    }

    fn network(&self, samples: &[i16], network: &PhoneNetwork) -> Result<Alignment> {
        let duration = samples.len() as f64 / f64::from(SAMPLE_RATE_HZ);
        let observations = observations(samples, self.hmm.start_mean);
        let frames = observations.nrows();
        let fewest = network.shortest(N_EMITTING);
        if fewest > frames {
            bail!(
                Data,
                "{duration:.2} s are too short for this text, which takes {:.2} s at least: is it this sound's?",
                border_time(fewest)
            );
        }
        let graph = Graph::build(network, Topology::PH_HMM, &self.hmm.phones);
        let probability = graph.probabilities(&self.hmm.transition);
        let log = Likelihoods::new(
            graph.states.iter().map(|s| s.audio),
            &self.evaluator,
            observations.view(),
        );
        let heard = |t: usize, s: usize| f64::from(log.log(t, s));
        let emission = |t: usize, s: usize| self.hmm.acoustic_scale * heard(t, s);
        let (path, _) = viterbi(&graph, &probability, frames, &emission)
            .ok_or_else(|| Error::Data("no way of saying this text fits the sound".into()))?;
        let (phones, total) = phones_on(&path, &graph, &self.hmm, &network.words, duration, &heard);
        Ok(Alignment {
            duration,
            phones,
            words: Vec::new(),
            log_likelihood: total / frames as f64,
        })
    }
}

/// The phones along a path, from 0 to `duration` seconds, with their borders shifted; and the log likelihood of all frames. `words` has the word
/// of each of the network's nodes, `heard` the log likelihood of a joint state at a frame.
fn phones_on(
    path: &[usize],
    graph: &Graph,
    hmm: &AudioHmm,
    words: &[Option<usize>],
    duration: f64,
    heard: &dyn Fn(usize, usize) -> f64,
) -> (Vec<Spoken>, f64) {
    let mut phones: Vec<Spoken> = Vec::new();
    let (mut begun, mut total) = (Vec::new(), 0.0);
    for (t, &s) in path.iter().enumerate() {
        let state = graph.states[s];
        // A phone that is said twice in a row begins again at its first state.
        let begins = t == 0 || {
            let before = graph.states[path[t - 1]];
            before.node != state.node || before.audio > state.audio
        };
        if begins {
            phones.push(Spoken {
                phone: hmm.phones[state.phone],
                start: if t == 0 { 0.0 } else { border_time(t) },
                end: duration,
                word: words[state.node],
                score: 0.0,
            });
            begun.push(t);
        }
        let log = heard(t, s);
        total += log;
        if let Some(last) = phones.last_mut() {
            last.score += log;
        }
    }
    hmm.shifts.apply(&mut phones);
    for i in 0..phones.len() {
        let next = begun.get(i + 1).copied().unwrap_or(path.len());
        phones[i].score /= (next - begun[i]) as f64;
        if let Some(start) = phones.get(i + 1).map(|p| p.start) {
            phones[i].end = start;
        }
    }
    (phones, total)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A dictionary asks for unstressed vowels and syllabic consonants, which a model trained on full ones has never heard.
    #[test]
    fn full_phones_stand_for_reduced_ones_that_were_never_heard() {
        let aligner = Aligner::new(AudioHmm::shipped().unwrap());
        let place = |name: &str| aligner.index(Phone::from_name(name).unwrap());
        let knows = |name: &str| aligner.hmm.phones.iter().any(|p| p.name() == name);
        for (reduced, full) in [("axr", "er"), ("el", "l"), ("em", "m")] {
            assert!(knows(full) && !knows(reduced), "{reduced}");
            assert_eq!(place(reduced), place(full));
        }
        assert_eq!(knows("sp"), place("sp").is_some(), "a silence is no short pause");
        let samples = lipstream_media::sound::decode(lipstream::shipped::SOUND)
            .unwrap()
            .samples;
        let said = ["sil", "hh", "axr", "el", "ow", "sil"].map(|phone| PhoneLabel {
            phone: phone.to_owned(),
            start: 0.0,
            end: 0.0,
        });
        assert_eq!(aligner.phones(&samples, &said).unwrap().phones.len(), 6);
    }
}
