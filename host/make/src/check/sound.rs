//! How loud, how clean and how much the speech of a take is.
use lipstream_core::{HOP_SAMPLES, SAMPLE_RATE_HZ};
use serde::Serialize;

use crate::corpus::take::{self, PAUSE};

/// Decibels of a square wave of full scale, which is the 0 dBFS of this report.
const FULL_SCALE_DB: f32 = 90.309;
/// Samples from here on are as large as they can be; what is cut off is so for at least `CLIPPED_RUN` samples in a row.
const CLIPPED: i16 = 32_400;
const CLIPPED_RUN: usize = 3;
/// Hops at either edge of a pause that may still hold speech.
const PAUSE_EDGE: usize = 4;
/// Hum is looked for at these frequencies, in windows so long (samples; 0.4 s), in the quietest tenth of them.
const MAINS_HZ: [f32; 2] = [50.0, 60.0];
const HUM_WINDOW: usize = 6400;

/// What is heard of a take. Levels are in decibels below a square wave of full scale (dBFS).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SoundReport {
    /// Length, seconds.
    pub seconds: f64,
    /// Of it with speech.
    pub speech_seconds: f64,
    /// Mean level of the hops with speech.
    pub speech_dbfs: f32,
    /// Mean level in pauses; where there is none, the level that a twentieth of the hops stays below.
    pub noise_dbfs: f32,
    /// Speech above noise, decibels.
    pub speech_to_noise_db: f32,
    /// Share of the samples of speech that are cut off at full scale.
    pub clipped: f32,
    /// Level of the mean of all samples.
    pub offset_dbfs: f32,
    /// Level of the mains' hum (50 or 60 Hz), measured where it is quietest; None in less than half a second.
    pub hum_dbfs: Option<f32>,
}

/// Which hops of 10 ms are speech, and which are surely not.
pub(crate) struct Activity {
    /// `[hops]`.
    pub(crate) speech: Vec<bool>,
    /// `[hops]`: inside a pause, away from its edges.
    pub(crate) pause: Vec<bool>,
}

impl Activity {
    pub(crate) fn of(levels: &[f32]) -> Self {
        let speech = take::speech(levels);
        let mut pause = vec![false; speech.len()];
        let mut from = 0;
        for run in speech.chunk_by(|a, b| a == b) {
            if !run[0] && run.len() >= PAUSE {
                pause[from + PAUSE_EDGE..from + run.len() - PAUSE_EDGE].fill(true);
            }
            from += run.len();
        }
        Self { speech, pause }
    }

    /// Whether a moment (s) lies in a pause.
    pub(crate) fn is_pause(&self, seconds: f64) -> bool {
        let hop = (seconds * f64::from(SAMPLE_RATE_HZ) / HOP_SAMPLES as f64) as usize;
        self.pause.get(hop).copied().unwrap_or(false)
    }
}

/// Measures 16 kHz mono samples whose speech is known.
pub(crate) fn measure(samples: &[i16], levels: &[f32], activity: &Activity) -> SoundReport {
    let hop_s = HOP_SAMPLES as f64 / f64::from(SAMPLE_RATE_HZ);
    let mean_of = |chosen: &[bool]| {
        let some = levels.iter().zip(chosen).filter(|(_, chosen)| **chosen);
        mean_db(some.map(|(level, _)| *level))
    };
    let speech = mean_of(&activity.speech).unwrap_or(0.0);
    let noise = mean_of(&activity.pause).unwrap_or_else(|| {
        let mut sorted = levels.to_vec();
        sorted.sort_by(f32::total_cmp);
        sorted.get(sorted.len() / 20).copied().unwrap_or(0.0)
    });
    let spoken = activity.speech.iter().filter(|s| **s).count();
    let mean = samples.iter().map(|s| f64::from(*s)).sum::<f64>() / samples.len().max(1) as f64;
    SoundReport {
        seconds: samples.len() as f64 / f64::from(SAMPLE_RATE_HZ),
        speech_seconds: spoken as f64 * hop_s,
        speech_dbfs: speech - FULL_SCALE_DB,
        noise_dbfs: noise - FULL_SCALE_DB,
        speech_to_noise_db: speech - noise,
        clipped: clipped(samples) as f32 / (spoken * HOP_SAMPLES).max(1) as f32,
        offset_dbfs: 10.0 * ((mean * mean) as f32 + 1e-3).log10() - FULL_SCALE_DB,
        hum_dbfs: hum(samples).map(|level| level - FULL_SCALE_DB),
    }
}

/// The level of the mean power.
fn mean_db(levels: impl Iterator<Item = f32>) -> Option<f32> {
    let (mut power, mut count) = (0.0f64, 0.0f64);
    for level in levels {
        power += 10f64.powf(f64::from(level) / 10.0);
        count += 1.0;
    }
    (count > 0.0).then(|| (10.0 * (power / count).log10()) as f32)
}

/// Samples in runs at full scale.
fn clipped(samples: &[i16]) -> usize {
    let full = |s: &i16| s.unsigned_abs() >= CLIPPED.unsigned_abs();
    let runs = samples.chunk_by(|a, b| full(a) == full(b));
    runs.filter(|run| full(&run[0]) && run.len() >= CLIPPED_RUN)
        .map(<[i16]>::len)
        .sum()
}

/// Decibels of the stronger of the mains' frequencies: the quietest tenth over windows, because low voices reach down there.
fn hum(samples: &[i16]) -> Option<f32> {
    let strength = |hz: f32| {
        let mut levels: Vec<f32> = samples
            .chunks_exact(HUM_WINDOW)
            .map(|window| 10.0 * (tone_power(window, hz) + 1e-3).log10())
            .collect();
        levels.sort_by(f32::total_cmp);
        levels.get(levels.len() / 10).copied()
    };
    MAINS_HZ.into_iter().filter_map(strength).max_by(f32::total_cmp)
}

/// Power of a sine of this frequency in a window, by its Fourier sum under Hann's window.
fn tone_power(window: &[i16], hz: f32) -> f32 {
    let step = std::f64::consts::TAU * f64::from(hz) / f64::from(SAMPLE_RATE_HZ);
    let across = std::f64::consts::TAU / window.len() as f64;
    let (mut re, mut im) = (0.0f64, 0.0f64);
    for (n, sample) in window.iter().enumerate() {
        let (sin, cos) = (step * n as f64).sin_cos();
        let weighted = f64::from(*sample) * (1.0 - (across * n as f64).cos());
        re += weighted * cos;
        im += weighted * sin;
    }
    // The weights' mean is 1; a sine of amplitude a gives a·n/2, and its power is a²/2.
    let amplitude = 2.0 * re.hypot(im) / window.len() as f64;
    (0.5 * amplitude * amplitude) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Noise with bursts of tone in it: half a second of each in turn.
    fn take(tone: f32, noise: f32, hum: f32, seconds: usize) -> Vec<i16> {
        let mut state = 1u32;
        (0..seconds * 16_000)
            .map(|n| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let hiss = noise * ((state >> 16) as f32 / 32_768.0 - 1.0);
                let t = n as f32 / 16_000.0;
                let speaks = (t * 2.0) as usize % 2 == 1;
                let voice = if speaks {
                    tone * (t * 200.0 * std::f32::consts::TAU).sin()
                } else {
                    0.0
                };
                let mains = hum * (t * 50.0 * std::f32::consts::TAU).sin();
                (voice + hiss + mains) as i16 // `as` saturates
            })
            .collect()
    }

    fn measured(samples: &[i16]) -> SoundReport {
        let levels = take::levels(samples);
        measure(samples, &levels, &Activity::of(&levels))
    }

    #[test]
    fn levels_are_those_that_were_made() {
        let report = measured(&take(8000.0, 30.0, 0.0, 6));
        // A sine of amplitude 8000 has 75.05 dB, noise in ±30 has 24.8.
        assert!((report.speech_dbfs + 15.3).abs() < 0.3, "{report:?}");
        assert!((report.speech_to_noise_db - 50.3).abs() < 0.5, "{report:?}");
        assert!((report.speech_seconds - 3.0).abs() < 0.1 && report.seconds == 6.0);
        assert_eq!(report.clipped, 0.0);
        assert!(report.offset_dbfs < -75.0, "{report:?}");
        assert!(report.hum_dbfs.unwrap() < -80.0, "{report:?}");
    }

    #[test]
    fn clipping_hum_and_offset_are_found() {
        let loud = measured(&take(60_000.0, 30.0, 0.0, 4));
        assert!(loud.clipped > 0.4, "{loud:?}");
        let hum = measured(&take(8000.0, 30.0, 300.0, 4)).hum_dbfs.unwrap();
        // Amplitude 300: 46.5 dB.
        assert!((hum + 43.8).abs() < 1.0, "{hum}");
        let shifted: Vec<i16> = take(8000.0, 30.0, 0.0, 4).iter().map(|s| s + 1000).collect();
        assert!((measured(&shifted).offset_dbfs + 30.3).abs() < 0.2);
    }

    #[test]
    fn silence_and_nothing_are_no_panic() {
        assert_eq!(measured(&[]).speech_seconds, 0.0);
        assert_eq!(measured(&[0; 4000]).speech_seconds, 0.0);
        assert_eq!(measured(&[0; 4000]).hum_dbfs, None);
    }
}
