//! Training clips as another room would give them: noise, babble, another level, a jump of the level, a stream that begins in
//! mid-clip, sounds that are no speech, a long pause behind it. And as somebody else would say them: with a vocal tract of another length, through another microphone, to a stream that has
//! heard this voice for long. The front end hears each disturbed sound anew, its running mean included.
use lipstream_core::{FRAME_SAMPLES, HOP_SAMPLES, N_STATIC};
use ndarray::Array2;
use rand::{Rng, RngExt};

use super::clatter::Clatter;
use crate::noise;
use lipstream::random::{normal, normal_f64};
use lipstream::reference::{Analyser, SpeechMean, normalise, without_offset};

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
/// How much higher or lower another voice's frequencies are, as a factor: ln 1.25.
const VOICE: f64 = 0.22;
/// Greatest weight of the sample before, added to a sample: a microphone that is bright or dull, ±6 dB between low and high.
const TILT: f64 = 0.35;
/// Deviation of what a voice's mean is mistaken by, in deviations of the statics.
const MISTAKEN: f64 = 0.15;
/// Frames that are left of a clip that begins in its middle, at least.
const LEAST_FRAMES: usize = 160;

/// Length of a pause behind a clip in which nobody speaks, frames.
const PAUSES: std::ops::Range<usize> = 50..250;
/// How loud a room is in such a pause beside the end of the clip, as a factor.
const ROOMS: std::ops::Range<f64> = 0.0..1.5;
/// Samples at the end of a clip that tell how loud its room is.
const ENDING: usize = 1600;

/// Shares of hearings that are drawn only where they are asked for, 0 to 1 each.
#[derive(Clone, Copy, Debug, Default)]
pub struct Shares {
    /// As somebody else would say it.
    pub voices: f32,
    /// With something beside it that is no speech.
    pub sounds: f32,
    /// With a pause behind it in which nobody speaks.
    pub pauses: f32,
}

/// What happens to one clip; by default nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Disturbance {
    first: usize,
    noise: Option<(noise::Kind, f64)>,
    level_db: f64,
    /// Share of the sound after which the level changes, and by how much, dB.
    jump: Option<(f64, f64)>,
    /// Somebody else; None: the voice as it is.
    voice: Option<Voice>,
    /// Something that is no speech.
    clatter: Option<Clatter>,
    /// Frames behind the clip, and how loud the room is in them, as a factor.
    pause: Option<(usize, f64)>,
}

/// Somebody else says it.
#[derive(Clone, Copy, Debug)]
struct Voice {
    /// How much higher all frequencies are.
    factor: f64,
    /// Weight of the sample before.
    tilt: f64,
    /// The running mean has been this voice's for long, but for so many deviations.
    known: Option<[f64; N_STATIC]>,
}

impl Voice {
    fn draw(rng: &mut impl Rng) -> Self {
        let (warps, tilts, is_known) = (
            rng.random::<f64>() < 0.7,
            rng.random::<f64>() < 0.5,
            rng.random::<f64>() < 0.5,
        );
        let (warp, tilt) = (rng.random_range(-VOICE..VOICE), rng.random_range(-TILT..TILT));
        let mistaken = std::array::from_fn(|_| MISTAKEN * f64::from(normal(rng)));
        Self {
            factor: if warps { warp.exp() } else { 1.0 },
            tilt: if tilts { tilt } else { 0.0 },
            known: is_known.then_some(mistaken),
        }
    }
}

impl Disturbance {
    /// A random one for a clip of `frames` frames: noise in four of five, another level in half, a jump in one of five,
    /// a later beginning in half of those that are long enough; the rest by its `shares`.
    pub fn draw(frames: usize, shares: Shares, rng: &mut impl Rng) -> Self {
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
        // Drawn only where it is asked for: what is drawn otherwise stays as it was.
        let is_drawn = |share: f32, rng: &mut _| share > 0.0 && RngExt::random::<f32>(rng) < share;
        let is_other = is_drawn(shares.voices, rng);
        let voice = is_other.then(|| Voice::draw(rng));
        let clatter = is_drawn(shares.sounds, rng).then(|| Clatter::draw(rng));
        let pause = is_drawn(shares.pauses, rng).then(|| (rng.random_range(PAUSES), rng.random_range(ROOMS)));
        Self {
            voice,
            clatter,
            pause,
            first: if is_cold { first } else { 0 },
            noise: is_noisy.then_some((kind, ratio)),
            level_db: if other_level { level } else { 0.0 },
            jump: jumps.then_some((at, by)),
        }
    }

    /// The clip's sound disturbed, and what the front end makes of it: more frames than the clip has, where there is a pause behind it. `voices` babble.
    pub fn hear(
        &self,
        samples: &[i16],
        voices: &[&[i16]],
        start_mean: &[f32; N_STATIC],
        scale: &[f32],
        rng: &mut rand_pcg::Pcg64,
    ) -> Variant {
        let samples = &self.with_pause(samples, rng)[..];
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
        if let Some(voice) = &self.voice {
            tilted(&mut sound, voice.tilt);
        }
        if let Some(clatter) = &self.clatter {
            clatter.lay(&mut sound, rng);
        }
        let from = (self.first * HOP_SAMPLES).min(sound.len().saturating_sub(FRAME_SAMPLES));
        let factor = self.voice.map_or(1.0, |voice| voice.factor);
        let raw = Analyser::of_voice(factor).statics(&without_offset(&sound[from..]));
        let mut mean = *start_mean;
        if let Some(mistaken) = self.voice.and_then(|voice| voice.known)
            && let Some(own) = speech_mean(&raw)
        {
            mean = std::array::from_fn(|d| own[d] + (mistaken[d] / f64::from(scale[d])) as f32);
        }
        let normalised = normalise::causal(raw.view(), &mean);
        Variant {
            first: from / HOP_SAMPLES,
            x: Array2::from_shape_fn(normalised.dim(), |(t, d)| normalised[[t, d]] as f32 * scale[d]),
        }
    }
}

impl Disturbance {
    /// The clip, and a room in which nobody speaks behind it.
    fn with_pause(&self, samples: &[i16], rng: &mut rand_pcg::Pcg64) -> Vec<i16> {
        let mut sound = samples.to_vec();
        if let Some((frames, loud)) = self.pause {
            let ending = &samples[samples.len().saturating_sub(ENDING)..];
            let squares: f64 = ending.iter().map(|s| f64::from(*s).powi(2)).sum();
            let room = loud * (squares / ending.len().max(1) as f64).sqrt();
            sound.extend((0..frames * HOP_SAMPLES).map(|_| (room * normal_f64(rng)).round() as i16)); // `as` saturates
        }
        sound
    }
}

/// Mean of the raw statics over speech; None where nothing is heard to be speech.
fn speech_mean(raw: &Array2<f64>) -> Option<[f32; N_STATIC]> {
    let mut mean = SpeechMean::default();
    mean.add(raw.view());
    mean.mean()
}

/// Adds the sample before, so many times as strong, and keeps the level of an even spectrum.
fn tilted(sound: &mut [i16], weight: f64) {
    let gain = 1.0 / (1.0 + weight * weight).sqrt();
    let mut before = 0.0;
    for s in sound {
        let here = f64::from(*s);
        *s = (gain * (here + weight * before)).round() as i16; // `as` saturates
        before = here;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lipstream::reference;
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
        let none = Disturbance::default();
        let (mean, scale) = ([1.0; N_STATIC], [0.5; N_STATIC]);
        let heard = none.hear(&samples, &[], &mean, &scale, &mut Pcg64::seed_from_u64(1));
        let want = normalise::causal(reference::live_statics(&samples).view(), &mean);
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
            ..Disturbance::default()
        };
        let mean = [0.0; N_STATIC];
        let heard = late.hear(
            &samples,
            &[],
            &mean,
            &[1.0; N_STATIC],
            &mut Pcg64::seed_from_u64(1),
        );
        let raw = reference::live_statics(&samples[70 * HOP_SAMPLES..]);
        assert_eq!((heard.first, heard.x.nrows()), (70, raw.nrows()));
        assert!((f64::from(heard.x[[0, 3]]) - raw[[0, 3]]).abs() < 1e-4);
    }

    #[test]
    fn draws_differ_and_stay_inside_the_clip() {
        let mut rng = Pcg64::seed_from_u64(3);
        let drawn: Vec<Disturbance> = (0..200)
            .map(|_| Disturbance::draw(298, Shares::default(), &mut rng))
            .collect();
        assert!(drawn.iter().all(|d| d.first <= 298 - LEAST_FRAMES));
        assert!(drawn.iter().filter(|d| d.noise.is_some()).count() > 130);
        assert!(drawn.iter().filter(|d| d.first > 0).count() > 70);
        assert!(drawn.iter().any(|d| d.jump.is_some() && d.level_db < -10.0));
        assert!((0..50).all(|_| Disturbance::draw(40, Shares::default(), &mut rng).first == 0));
    }

    #[test]
    fn a_pause_is_as_loud_as_the_room_and_has_frames_of_its_own() {
        let mut samples = tone(48_000);
        let mut rng = Pcg64::seed_from_u64(5);
        samples.extend((0..1600).map(|_| (20.0 * normal_f64(&mut rng)) as i16));
        let drawn: Vec<Disturbance> = (0..100)
            .map(|_| {
                let pauses = Shares {
                    pauses: 0.5,
                    ..Shares::default()
                };
                Disturbance::draw(310, pauses, &mut rng)
            })
            .collect();
        assert!((30..70).contains(&drawn.iter().filter(|d| d.pause.is_some()).count()));
        let quiet = Disturbance {
            pause: Some((200, 0.5)),
            ..Disturbance::default()
        };
        let behind = &quiet.with_pause(&samples, &mut rng)[samples.len()..];
        let power: f64 = behind.iter().map(|s| f64::from(*s).powi(2)).sum::<f64>() / behind.len() as f64;
        assert!((8.0..12.0).contains(&power.sqrt()), "{power}");
        let (mean, scale) = ([0.0; N_STATIC], [1.0; N_STATIC]);
        let heard = quiet.hear(&samples, &[], &mean, &scale, &mut rng);
        let without = Disturbance { pause: None, ..quiet }.hear(&samples, &[], &mean, &scale, &mut rng);
        assert_eq!(heard.x.nrows(), without.x.nrows() + 200);
    }

    #[test]
    fn a_voice_that_is_known_has_no_mean_left() {
        let samples = tone(48_000);
        let known = Disturbance {
            voice: Some(Voice {
                factor: 1.1,
                tilt: 0.2,
                known: Some([0.0; N_STATIC]),
            }),
            ..Disturbance::default()
        };
        let (mean, scale) = ([50.0; N_STATIC], [1.0; N_STATIC]);
        let heard = known.hear(&samples, &[], &mean, &scale, &mut Pcg64::seed_from_u64(1));
        let mean_of = |x: &Array2<f32>| x.mean_axis(ndarray::Axis(0)).unwrap();
        let strange = Disturbance { voice: None, ..known };
        let unknown = strange.hear(&samples, &[], &mean, &scale, &mut Pcg64::seed_from_u64(1));
        let (known, unknown) = (mean_of(&heard.x), mean_of(&unknown.x));
        // A stream that begins with a mean of 50 is still far off after three seconds.
        assert!(known.iter().take(12).all(|m| m.abs() < 5.0), "{known}");
        assert!(unknown.iter().take(12).all(|m| *m < -15.0), "{unknown}");
    }

    #[test]
    fn other_voices_differ_and_none_are_drawn_where_none_are_wanted() {
        let mut rng = Pcg64::seed_from_u64(3);
        let shares = |voices| Shares {
            voices,
            ..Shares::default()
        };
        let mut drawn = |share| -> Vec<Option<Voice>> {
            (0..300)
                .map(|_| Disturbance::draw(298, shares(share), &mut rng).voice)
                .collect()
        };
        assert!(drawn(0.0).iter().all(Option::is_none));
        let voices: Vec<Voice> = drawn(0.5).into_iter().flatten().collect();
        assert!((100..200).contains(&voices.len()));
        assert!(voices.iter().any(|v| v.factor > 1.15) && voices.iter().any(|v| v.factor < 0.87));
        assert!(voices.iter().all(|v| (0.79..1.26).contains(&v.factor)));
        assert!(voices.iter().any(|v| v.known.is_some()) && voices.iter().any(|v| v.known.is_none()));
    }
}
