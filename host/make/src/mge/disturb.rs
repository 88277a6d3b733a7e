//! Training clips as another room would give them: noise, babble, another level, a jump of the level, a stream that begins in
//! mid-clip. The front end hears each disturbed sound anew, its running mean included.
use lipstream_core::{FRAME_SAMPLES, HOP_SAMPLES, N_STATIC};
use ndarray::Array2;
use rand::{Rng, RngExt};

use crate::noise;
use lipstream::reference::{self, normalise};

/// A clip heard once more.
#[derive(Clone, Debug, PartialEq)]
pub struct Variant {
    /// Frame of the clip that is the variant's first.
    pub first: usize,
    /// Normalised statics times their scale `[frames, 13]`.
    pub x: Array2<f32>,
}

/// Signal-to-noise ratios over speech, dB.
const RATIOS_DB: std::ops::Range<f64> = 0.0..30.0;
/// Change of the level of the whole sound, and greatest jump inside it, dB.
const LEVELS_DB: std::ops::Range<f64> = -20.0..6.0;
const JUMP_DB: f64 = 10.0;
/// Frames that are left of a clip that begins in its middle, at least.
const LEAST_FRAMES: usize = 160;

/// What happens to one clip.
#[derive(Clone, Copy, Debug)]
pub struct Disturbance {
    first: usize,
    noise: Option<(noise::Kind, f64)>,
    level_db: f64,
    /// Share of the sound after which the level changes, and by how much, dB.
    jump: Option<(f64, f64)>,
}

impl Disturbance {
    /// A random one for a clip of `frames` frames: noise in four of five, another level in half, a jump in one of five,
    /// a later beginning in half of those that are long enough.
    pub fn draw(frames: usize, rng: &mut impl Rng) -> Self {
        let mut chance = |share: f64| rng.random::<f64>() < share;
        let (is_noisy, is_white, other_level, jumps, is_cold) =
            (chance(0.8), chance(0.5), chance(0.5), chance(0.2), chance(0.5));
        let room = frames.saturating_sub(LEAST_FRAMES);
        let kind = if is_white {
            noise::Kind::White
        } else {
            noise::Kind::Babble
        };
        let ratio = rng.random_range(RATIOS_DB);
        let level = rng.random_range(LEVELS_DB);
        let (at, by) = (rng.random::<f64>(), rng.random_range(-JUMP_DB..JUMP_DB));
        let first = rng.random_range(0..=room);
        Self {
            first: if is_cold { first } else { 0 },
            noise: is_noisy.then_some((kind, ratio)),
            level_db: if other_level { level } else { 0.0 },
            jump: jumps.then_some((at, by)),
        }
    }

    /// The clip's sound disturbed, and what the front end makes of it. `voices` babble.
    pub fn hear(
        &self,
        samples: &[i16],
        voices: &[&[i16]],
        start_mean: &[f32; N_STATIC],
        scale: &[f32],
        rng: &mut rand_pcg::Pcg64,
    ) -> Variant {
        let mut sound = match self.noise {
            None => samples.to_vec(),
            Some((kind, ratio_db)) => {
                let beside = match kind {
                    noise::Kind::White => noise::white(rng, samples.len()),
                    noise::Kind::Babble => noise::babble(rng, voices, samples.len()),
                };
                noise::add(samples, &beside, ratio_db)
            }
        };
        let turn = self
            .jump
            .map_or(sound.len(), |(at, _)| (at * sound.len() as f64) as usize);
        let later_db = self.jump.map_or(0.0, |(_, by)| by);
        for (n, s) in sound.iter_mut().enumerate() {
            let db = self.level_db + if n < turn { 0.0 } else { later_db };
            *s = (f64::from(*s) * 10f64.powf(db / 20.0)).round() as i16; // `as` saturates
        }
        let from = (self.first * HOP_SAMPLES).min(sound.len().saturating_sub(FRAME_SAMPLES));
        let raw = reference::statics(&sound[from..]);
        let normalised = normalise::causal(raw.view(), start_mean);
        Variant {
            first: from / HOP_SAMPLES,
            x: Array2::from_shape_fn(normalised.dim(), |(t, d)| normalised[[t, d]] as f32 * scale[d]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    fn tone(samples: usize) -> Vec<i16> {
        (0..samples)
            .map(|n| {
                let swell = (n as f64 / 900.0).sin();
                (4000.0 * swell * (n as f64 * 0.2).sin()) as i16
            })
            .collect()
    }

    #[test]
    fn an_undisturbed_clip_is_heard_as_it_was() {
        let samples = tone(48_000);
        let none = Disturbance {
            first: 0,
            noise: None,
            level_db: 0.0,
            jump: None,
        };
        let (mean, scale) = ([1.0; N_STATIC], [0.5; N_STATIC]);
        let heard = none.hear(&samples, &[], &mean, &scale, &mut Pcg64::seed_from_u64(1));
        let want = normalise::causal(reference::statics(&samples).view(), &mean);
        assert_eq!(heard.first, 0);
        assert_eq!(heard.x.nrows(), want.nrows());
        assert!(
            heard
                .x
                .iter()
                .zip(&want)
                .all(|(a, b)| (f64::from(*a) - 0.5 * b).abs() < 1e-4)
        );
    }

    #[test]
    fn a_later_beginning_hears_the_same_frames_with_a_mean_of_its_own() {
        let samples = tone(48_000);
        let late = Disturbance {
            first: 70,
            noise: None,
            level_db: 0.0,
            jump: None,
        };
        let mean = [0.0; N_STATIC];
        let heard = late.hear(
            &samples,
            &[],
            &mean,
            &[1.0; N_STATIC],
            &mut Pcg64::seed_from_u64(1),
        );
        let raw = reference::statics(&samples);
        assert_eq!((heard.first, heard.x.nrows()), (70, raw.nrows() - 70));
        assert!((f64::from(heard.x[[0, 3]]) - raw[[70, 3]]).abs() < 1e-4);
    }

    #[test]
    fn draws_differ_and_stay_inside_the_clip() {
        let mut rng = Pcg64::seed_from_u64(3);
        let drawn: Vec<Disturbance> = (0..200).map(|_| Disturbance::draw(298, &mut rng)).collect();
        assert!(drawn.iter().all(|d| d.first <= 298 - LEAST_FRAMES));
        assert!(drawn.iter().filter(|d| d.noise.is_some()).count() > 130);
        assert!(drawn.iter().filter(|d| d.first > 0).count() > 70);
        assert!(drawn.iter().any(|d| d.jump.is_some() && d.level_db < -10.0));
        assert!((0..50).all(|_| Disturbance::draw(40, &mut rng).first == 0));
    }
}
