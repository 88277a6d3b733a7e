//! Noise added to clips: white, or the babble of other voices, at a signal-to-noise ratio over speech.
use lipstream_core::HOP_SAMPLES;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::Serialize;

use crate::hash::fnv1a;
use lipstream::random::normal_f64;
use lipstream::reference::normalise::SpeechGate;
use lipstream::reference::{energy, floor, frame_count};

/// What is heard beside the speaker.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Gaussian, flat.
    White,
    /// Several voices at once, equally loud.
    Babble,
}

impl Kind {
    /// The name that reports use, in lower case.
    pub fn name(self) -> &'static str {
        match self {
            Kind::White => "white",
            Kind::Babble => "babble",
        }
    }
}

/// Voices that talk at once.
pub const VOICES: usize = 6;

/// A generator of its own for each clip, kind and seed: the same noise whatever else is measured.
pub fn generator(seed: u64, id: &str, what: &str) -> Pcg64 {
    let hash = fnv1a(id.bytes().chain([0]).chain(what.bytes()));
    Pcg64::seed_from_u64(hash ^ seed)
}

/// Gaussian noise of variance one.
pub fn white(rng: &mut Pcg64, samples: usize) -> Vec<f64> {
    (0..samples).map(|_| normal_f64(rng)).collect()
}

/// [`VOICES`] clips of `others` drawn at random, each of power one, from a random place on, repeated as needed.
pub fn babble(rng: &mut Pcg64, others: &[&[i16]], samples: usize) -> Vec<f64> {
    let mut out = vec![0.0; samples];
    let heard: Vec<&&[i16]> = others.iter().filter(|o| o.iter().any(|s| *s != 0)).collect();
    if heard.is_empty() {
        return out;
    }
    for _ in 0..VOICES {
        let voice = heard[rng.random_range(0..heard.len())];
        let from = rng.random_range(0..voice.len());
        let gain = 1.0 / power(voice.iter().map(|&s| f64::from(s))).sqrt();
        for (to, &sample) in out.iter_mut().zip(voice.iter().cycle().skip(from)) {
            *to += gain * f64::from(sample);
        }
    }
    out
}

fn power(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for v in values {
        sum += v * v;
        n += 1.0;
    }
    sum / f64::max(n, 1.0)
}

/// Which samples belong to speech, by the front end's own gate; all of them if it never opens.
pub fn speech(samples: &[i16]) -> Vec<bool> {
    let mut gate = SpeechGate::default();
    let mut is_speech = vec![false; samples.len()];
    for t in 0..frame_count(samples.len()) {
        let frame: Vec<f64> = samples[t * HOP_SAMPLES..][..lipstream_core::FRAME_SAMPLES]
            .iter()
            .map(|&s| f64::from(s))
            .collect();
        if gate.next(energy::log_energy(&frame, floor::ENERGY)) {
            // The hop in the middle of the window.
            let from = t * HOP_SAMPLES + (lipstream_core::FRAME_SAMPLES - HOP_SAMPLES) / 2;
            is_speech[from..from + HOP_SAMPLES].fill(true);
        }
    }
    if !is_speech.contains(&true) {
        is_speech.fill(true);
    }
    is_speech
}

/// `samples` plus `noise` scaled so that over speech the samples are `snr_db` louder; i16 clips as a microphone does.
pub fn add(samples: &[i16], noise: &[f64], snr_db: f64) -> Vec<i16> {
    let is_speech = speech(samples);
    let over = |values: &mut dyn Iterator<Item = f64>| {
        power(values.zip(&is_speech).filter(|(_, s)| **s).map(|(v, _)| v))
    };
    let signal = over(&mut samples.iter().map(|&s| f64::from(s)));
    let beside = over(&mut noise.iter().copied());
    let gain = if beside > 0.0 {
        (signal / beside / 10f64.powf(snr_db / 10.0)).sqrt()
    } else {
        0.0
    };
    samples
        .iter()
        .zip(noise)
        .map(|(&s, n)| (f64::from(s) + gain * n).round() as i16) // `as` saturates
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bursts of a tone between silences, as loud as quiet speech.
    fn talk(samples: usize, hz: f64) -> Vec<i16> {
        (0..samples)
            .map(|n| {
                let t = n as f64 / 16000.0;
                let syllable = (std::f64::consts::TAU * 4.0 * t).sin().max(0.0);
                (3000.0 * syllable * (std::f64::consts::TAU * hz * t).sin()) as i16
            })
            .collect()
    }

    fn ratio_db(clean: &[i16], noisy: &[i16]) -> f64 {
        let is_speech = speech(clean);
        let (mut signal, mut noise) = (0.0, 0.0);
        for ((&c, &n), s) in clean.iter().zip(noisy).zip(is_speech) {
            if s {
                signal += f64::from(c).powi(2);
                noise += (f64::from(n) - f64::from(c)).powi(2);
            }
        }
        10.0 * (signal / noise).log10()
    }

    #[test]
    fn the_ratio_is_as_asked() {
        let clean = talk(48_000, 300.0);
        let others = [talk(30_000, 170.0), talk(20_000, 520.0)];
        let others: Vec<&[i16]> = others.iter().map(Vec::as_slice).collect();
        for snr in [20.0, 10.0, 5.0, 0.0] {
            let mut rng = generator(1, "clip", "test");
            for noise in [
                white(&mut rng, clean.len()),
                babble(&mut rng, &others, clean.len()),
            ] {
                let found = ratio_db(&clean, &add(&clean, &noise, snr));
                assert!((found - snr).abs() < 0.1, "{found} dB for {snr} dB");
            }
        }
    }

    #[test]
    fn speech_is_where_the_tone_is() {
        let mut clean = vec![0i16; 16_000];
        clean.extend(talk(32_000, 300.0));
        clean.extend([0; 16_000]);
        let found = speech(&clean);
        let share = |range: std::ops::Range<usize>| {
            found[range.clone()].iter().filter(|s| **s).count() as f64 / range.len() as f64
        };
        assert_eq!(share(0..15_000), 0.0);
        assert!(share(20_000..46_000) > 0.4);
        assert_eq!(share(56_000..64_000), 0.0);
        assert!(speech(&[0; 1000]).iter().all(|s| *s));
        assert!(speech(&[]).is_empty());
    }

    #[test]
    fn white_noise_is_white_and_seeded() {
        let noise = white(&mut generator(1, "a", "white"), 100_000);
        let variance = power(noise.iter().copied());
        assert!((variance - 1.0).abs() < 0.02, "{variance}");
        let beside = noise.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / 1e5;
        assert!(beside.abs() < 0.02, "{beside}");
        assert_eq!(noise, white(&mut generator(1, "a", "white"), 100_000));
        assert_ne!(noise, white(&mut generator(1, "b", "white"), 100_000));
        assert_ne!(noise, white(&mut generator(2, "a", "white"), 100_000));
    }

    #[test]
    fn babble_holds_several_voices_of_equal_power() {
        let (quiet, loud) = (talk(40_000, 300.0), talk(40_000, 900.0));
        let quiet: Vec<i16> = quiet.iter().map(|s| s / 20).collect();
        let noise = babble(&mut generator(3, "a", "babble"), &[&quiet, &loud], 60_000);
        // Both tones are there, neither drowned out by the other's level.
        let tone = |hz: f64| {
            let (mut re, mut im) = (0.0, 0.0);
            for (n, v) in noise.iter().enumerate() {
                let angle = std::f64::consts::TAU * hz * n as f64 / 16000.0;
                re += v * angle.cos();
                im += v * angle.sin();
            }
            (re * re + im * im).sqrt()
        };
        let ratio = tone(300.0) / tone(900.0);
        assert!((0.1..10.0).contains(&ratio), "{ratio}");
        assert_eq!(babble(&mut generator(3, "a", "babble"), &[], 10), vec![0.0; 10]);
        assert_eq!(add(&[100, -100], &[0.0, 0.0], 10.0), [100, -100]);
    }
}
