//! Channels into one.
//!
//! The average of all channels is what a mouth is driven by, unless they take each other out: a microphone wired the wrong way round gives a second channel that is
//! the first one's opposite, and the average of both is silence.
use super::{Result, damaged};

/// Share of the channels' energy that the average must keep: a twentieth, −13 dB. Two channels that have nothing to do with each other keep half.
const KEPT: f64 = 0.05;
/// Mean square of the quietest piece that is judged: −60 dB of full scale, below speech.
const AUDIBLE: f64 = 1e-6;
/// Values beyond this many times full scale are no overshoot, but samples in other units: integers written as floats, say.
const OTHER_UNITS: f64 = 8.0;
/// Share of samples beyond full scale from which a sound is refused: a loud recording clips now and then, not in every twentieth sample.
const MOST_CLIPPED: f64 = 0.05;

/// What becomes of the channels of one sound.
#[derive(Default)]
pub(super) struct Mixer {
    /// The channel that is heard alone, once the average has been found wanting.
    alone: Option<usize>,
    samples: u64,
    clipped: u64,
}

impl Mixer {
    /// Appends one sample for every `channels` of `interleaved`.
    pub(super) fn push(&mut self, interleaved: &[f64], channels: usize, out: &mut Vec<f64>) -> Result<()> {
        if let Some(sample) = interleaved.iter().find(|s| s.abs() > OTHER_UNITS) {
            return damaged(format!(
                "it has samples of {sample:.0} where full scale is ±1: scale them down before they are written as floats"
            ));
        }
        self.samples += interleaved.len() as u64;
        self.clipped += interleaved.iter().filter(|s| s.abs() > 1.0).count() as u64;
        let start = out.len();
        out.extend(
            interleaved
                .chunks_exact(channels)
                .map(|frame| frame.iter().sum::<f64>() / channels as f64),
        );
        if channels == 1 {
            return Ok(());
        }
        if self.alone.is_none() {
            let mixed = out[start..].iter().map(|s| s * s).sum::<f64>();
            let frames = (out.len() - start).max(1) as f64;
            let energies: Vec<f64> = (0..channels)
                .map(|c| interleaved.iter().skip(c).step_by(channels).map(|s| s * s).sum())
                .collect();
            let loudest = (0..channels).max_by(|&a, &b| energies[a].total_cmp(&energies[b]));
            // A channel that is silent takes nothing out: only what the loudest one keeps in the average of all counts.
            self.alone = loudest.filter(|&c| {
                energies[c] > AUDIBLE * frames && KEPT * energies[c] > mixed * (channels * channels) as f64
            });
        }
        if let Some(alone) = self.alone {
            out.truncate(start);
            out.extend(interleaved.chunks_exact(channels).map(|frame| frame[alone]));
        }
        Ok(())
    }

    /// All of it has come.
    pub(super) fn finish(&self) -> Result<()> {
        if self.clipped as f64 > MOST_CLIPPED * self.samples as f64 {
            return damaged(format!(
                "{:.0} % of its samples are beyond full scale: scale them down to ±1 before they are written",
                100.0 * self.clipped as f64 / self.samples as f64
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mixed(pieces: &[&[f64]], channels: usize) -> Vec<f64> {
        let (mut mixer, mut out) = (Mixer::default(), Vec::new());
        for piece in pieces {
            mixer.push(piece, channels, &mut out).unwrap();
        }
        mixer.finish().unwrap();
        out
    }

    #[test]
    fn channels_that_take_each_other_out_are_heard_one_by_one() {
        // The louder one, and it stays so when the other falls silent.
        assert_eq!(
            mixed(&[&[0.0, 0.0], &[-0.4, 0.5, 0.4, -0.5], &[0.0, 0.25]], 2),
            [0.0, 0.5, -0.5, 0.25]
        );
        // One channel silent, and channels that have nothing to do with each other, are averaged.
        assert_eq!(mixed(&[&[0.5, 0.0, -0.5, 0.0]], 2), [0.25, -0.25]);
        assert_eq!(mixed(&[&[0.5, 0.0, 0.0, -0.5]], 2), [0.25, -0.25]);
        // Six of which five are silent.
        assert_eq!(mixed(&[&[0.0, 0.0, 0.6, 0.0, 0.0, 0.0]], 6), [0.6 / 6.0]);
        // Too quiet to judge by.
        assert_eq!(mixed(&[&[1e-4, -1e-4]], 2), [0.0]);
    }

    #[test]
    fn samples_beyond_full_scale_are_counted() {
        let (mut mixer, mut out) = (Mixer::default(), Vec::new());
        mixer.push(&[0.5; 99], 1, &mut out).unwrap();
        mixer.push(&[1.5; 2], 1, &mut out).unwrap();
        mixer.finish().unwrap();
        mixer.push(&[-1.5; 9], 1, &mut out).unwrap();
        assert!(
            mixer
                .finish()
                .unwrap_err()
                .to_string()
                .contains("10 % of its samples")
        );
        let error = mixer.push(&[-32768.0], 1, &mut out).unwrap_err().to_string();
        assert!(
            error.contains("samples of -32768 where full scale is ±1"),
            "{error}"
        );
    }
}
