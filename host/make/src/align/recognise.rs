//! Phones without a text: what a sound says, heard by the audio HMM alone on the loop over all phones.
//!
//! Viterbi over the loop, with 5 ms frames as in forced alignment ([`super::observations`]):
//!
//! ```text
//! score = Σ_t κ·ln b(o_t | q_t) + Σ_t ln a(q_t | q_{t−1}) + Σ_phones (λ·ln P(phone | phone before) + π)
//! ```
//!
//! κ is the acoustic scale, λ the language weight, π what every phone brings ([`RecognitionSettings`]).
use std::path::Path;

use ndarray::s;

use super::{Alignment, AudioHmm, Spoken, observations, phones_on};
use crate::error::{Error, Result, bail};
use lipstream::hmm::evaluator::{Evaluator, Likelihoods};
use lipstream::hmm::forward_backward::viterbi;
use lipstream::hmm::graph::Graph;
use lipstream::hmm::network::PhoneNetwork;
use lipstream::hmm::topology::Topology;
use lipstream::phones::Phone;
use lipstream::time;

/// Frames of 5 ms that are followed in one go, and those on either side that are heard with them: memory does not grow with the sound.
const WINDOW: usize = 6000;
const MARGIN: usize = 200;

/// How much the parts of a path count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecognitionSettings {
    /// Exponent of the audio likelihood, κ.
    pub acoustic_scale: f64,
    /// Exponent of the bigram, λ.
    pub language_weight: f32,
    /// Natural log of what every phone brings, π; negative where it costs.
    pub insertion: f32,
}

impl Default for RecognitionSettings {
    /// Chosen on GRID's validation clips and TIMIT's training speakers (docs/alignment.md).
    fn default() -> Self {
        Self {
            acoustic_scale: 0.2,
            language_weight: 2.0,
            insertion: 4.0,
        }
    }
}

/// An audio HMM made ready to recognise phones.
pub struct Recogniser {
    hmm: AudioHmm,
    settings: RecognitionSettings,
    evaluator: Evaluator,
    graph: Graph,
    /// Of the graph's arcs.
    probability: Vec<f64>,
    /// No node of the loop is of a word.
    words: Vec<Option<usize>>,
}

impl Recogniser {
    /// Unrolls the loop over the phones of `hmm`.
    pub fn new(hmm: AudioHmm, settings: RecognitionSettings) -> Self {
        let cost = |log: &f32| settings.language_weight * log + settings.insertion;
        let next = hmm.bigram.next.map(cost);
        let initial: Vec<f32> = hmm.bigram.initial.iter().map(cost).collect();
        let network = PhoneNetwork::phone_loop(&initial, &next);
        let graph = Graph::build(&network, Topology::PH_HMM, &hmm.phones);
        Self {
            evaluator: Evaluator::new(&hmm.audio),
            probability: graph.probabilities(&hmm.transition),
            words: network.words,
            graph,
            settings,
            hmm,
        }
    }

    /// By the audio half of the shipped model.
    pub fn shipped() -> Result<Self> {
        Ok(Self::new(AudioHmm::shipped()?, RecognitionSettings::default()))
    }

    /// By any model that [`AudioHmm::read`] reads.
    pub fn read(path: &Path) -> Result<Self> {
        Ok(Self::new(AudioHmm::read(path)?, RecognitionSettings::default()))
    }

    /// The audio HMM that listens.
    pub fn hmm(&self) -> &AudioHmm {
        &self.hmm
    }

    /// The phones of 16 kHz mono samples with their times, without gaps; there are no words. Pauses next to each other are one: `sil` where the
    /// sound begins and ends, `sp` inside, as in labels.
    ///
    /// # Errors
    ///
    /// That the sound is too short to hold a frame.
    pub fn recognise(&self, samples: &[i16]) -> Result<Alignment> {
        let duration = time::seconds(samples.len());
        let observations = observations(samples, self.hmm.start_mean);
        let frames = observations.nrows();
        if frames == 0 {
            bail!(Data, "{duration:.3} s of sound are too short to hear a phone");
        }
        let (mut path, mut heard) = (Vec::with_capacity(frames), Vec::with_capacity(frames));
        for from in (0..frames).step_by(WINDOW) {
            let to = (from + WINDOW).min(frames);
            let (first, last) = (from.saturating_sub(MARGIN), (to + MARGIN).min(frames));
            let log = Likelihoods::new(
                self.graph.states.iter().map(|s| s.audio),
                &self.evaluator,
                observations.slice(s![first..last, ..]),
            );
            let emission = |t: usize, s: usize| self.settings.acoustic_scale * f64::from(log.log(t, s));
            let (states, _) = viterbi(&self.graph, &self.probability, last - first, &emission)
                .ok_or_else(|| Error::Numbers("the sound's features are not finite".into()))?;
            for t in from - first..to - first {
                path.push(states[t]);
                heard.push(f64::from(log.log(t, states[t])));
            }
        }
        let heard = |t: usize, _| heard[t];
        let (phones, total) = phones_on(&path, &self.graph, &self.hmm, &self.words, duration, &heard);
        Ok(Alignment {
            duration,
            phones: joined(phones),
            words: Vec::new(),
            log_likelihood: total / frames as f64,
        })
    }
}

/// Neighbouring pauses made one, `sil` at the ends and `sp` inside.
fn joined(phones: Vec<Spoken>) -> Vec<Spoken> {
    let mut out: Vec<Spoken> = Vec::with_capacity(phones.len());
    for mut phone in phones {
        if phone.phone.is_pause() {
            phone.phone = Phone::SP;
        }
        match out.last_mut() {
            Some(last) if last.phone == Phone::SP && phone.phone == Phone::SP => {
                let (a, b) = (last.end - last.start, phone.end - phone.start);
                last.score = (a * last.score + b * phone.score) / (a + b);
                last.end = phone.end;
            }
            _ => out.push(phone),
        }
    }
    let last = out.len().saturating_sub(1);
    for end in [0, last] {
        if let Some(pause) = out.get_mut(end).filter(|p| p.phone.is_pause()) {
            pause.phone = Phone::SIL;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_join_and_are_named_by_their_place() {
        let spoken = |name: &str, start: f64, end: f64| Spoken {
            phone: Phone::from_name(name).unwrap(),
            start,
            end,
            word: None,
            score: start,
        };
        let phones = vec![
            spoken("sp", 0.0, 0.1),
            spoken("sil", 0.1, 0.3),
            spoken("b", 0.3, 0.4),
            spoken("sil", 0.4, 0.5),
            spoken("b", 0.5, 0.6),
            spoken("sp", 0.6, 0.7),
        ];
        let joined = joined(phones);
        let told: Vec<_> = joined.iter().map(|p| (p.phone.name(), p.start, p.end)).collect();
        assert_eq!(
            told,
            [
                ("sil", 0.0, 0.3),
                ("b", 0.3, 0.4),
                ("sp", 0.4, 0.5),
                ("b", 0.5, 0.6),
                ("sil", 0.6, 0.7)
            ]
        );
        assert!((joined[0].score - 0.2 / 3.0).abs() < 1e-9);
    }

    /// The speech that is shipped, flite's "hello": what is heard covers it, begins and ends in silence, and says vowels where it is loud.
    #[test]
    fn shipped_speech_is_heard_as_phones() {
        let sound = lipstream_media::sound::decode(lipstream::shipped::SOUND).unwrap();
        let recogniser = Recogniser::shipped().unwrap();
        let heard = recogniser.recognise(&sound.samples).unwrap();
        let pairs = heard.phones.windows(2);
        assert!(
            pairs
                .clone()
                .all(|p| p[0].end == p[1].start && p[0].start < p[0].end)
        );
        assert_eq!(heard.phones[0].start, 0.0);
        assert_eq!(heard.phones.last().unwrap().end, sound.seconds());
        let spoken = heard.phones.iter().filter(|p| !p.phone.is_pause()).count();
        let a_second = spoken as f64 / sound.seconds();
        assert!((4.0..20.0).contains(&a_second), "{a_second} phones a second");
        // Silence is no speech, and of nothing nothing can be heard.
        let quiet = recogniser.recognise(&vec![0; 16_000]).unwrap();
        assert!(
            quiet.phones.iter().all(|p| p.phone.is_pause()),
            "{:?}",
            quiet.phones
        );
        assert!(recogniser.recognise(&[0; 100]).is_err());
    }

    /// What is followed window by window is what is heard in one piece, but where windows meet.
    #[test]
    fn windows_meet_without_a_trace() {
        let sound = lipstream_media::sound::decode(lipstream::shipped::SOUND).unwrap();
        let recogniser = Recogniser::shipped().unwrap();
        let long: Vec<i16> = sound.samples.iter().cycle().take(33 * 16_000).copied().collect();
        let heard = recogniser.recognise(&long).unwrap();
        // 30 s in, the windows meet; around it no phone is shorter than its five states of 5 ms.
        let near = heard.phones.iter().filter(|p| (29.0..31.0).contains(&p.start));
        assert!(near.clone().count() > 5);
        assert!(
            near.clone().all(|p| p.end - p.start > 0.02),
            "{:?}",
            near.collect::<Vec<_>>()
        );
    }
}
