//! Sounds that are no speech, laid over a clip: clicks, breath, hum.
//!
//! Clips of a corpus begin and end in a studio's silence, and synthetic voices in digital zeros: whoever learns from them alone takes every sound for speech, and opens a
//! mouth at a door.
use rand::{Rng, RngExt};
use rand_pcg::Pcg64;

use lipstream::random::normal_f64;
use lipstream_core::SAMPLE_RATE_HZ;

/// How loud the loudest of it is beside the loudest of the clip, dB.
const LEVELS_DB: std::ops::Range<f64> = -30.0..0.0;
/// Clicks a second, and how long one rings, in seconds.
const CLICKS_HZ: std::ops::Range<f64> = 0.5..3.0;
const RINGS_S: std::ops::Range<f64> = 0.0002..0.01;
/// Breaths a second.
const BREATHS_HZ: std::ops::Range<f64> = 0.25..1.0;

/// What sounds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Clicks,
    Breath,
    Hum,
}

/// What sounds, and how loud.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clatter {
    kind: Kind,
    level_db: f64,
}

impl Clatter {
    /// Clicks half of the times, breath or hum the others.
    pub(super) fn draw(rng: &mut impl Rng) -> Self {
        let kind = match rng.random_range(0..4) {
            0 => Kind::Breath,
            1 => Kind::Hum,
            _ => Kind::Clicks,
        };
        Self {
            kind,
            level_db: rng.random_range(LEVELS_DB),
        }
    }

    /// Lays it over `sound`, from beginning to end.
    pub(super) fn lay(&self, sound: &mut [i16], rng: &mut Pcg64) {
        let loudest = |values: &mut dyn Iterator<Item = f64>| values.map(f64::abs).fold(0.0, f64::max);
        let peak = loudest(&mut sound.iter().map(|s| f64::from(*s)));
        let beside = match self.kind {
            Kind::Clicks => clicks(sound.len(), rng),
            Kind::Breath => breath(sound.len(), rng),
            Kind::Hum => hum(sound.len(), rng),
        };
        let gain = 10f64.powf(self.level_db / 20.0) * peak / loudest(&mut beside.iter().copied()).max(1e-9);
        for (s, more) in sound.iter_mut().zip(beside) {
            *s = (f64::from(*s) + gain * more).round() as i16; // `as` saturates
        }
    }
}

fn seconds(n: usize) -> f64 {
    n as f64 / f64::from(SAMPLE_RATE_HZ)
}

/// Things that fall, doors, keys: each rings at a frequency of its own and dies away.
fn clicks(length: usize, rng: &mut Pcg64) -> Vec<f64> {
    let mut sound = vec![0.0; length];
    let count = (seconds(length) * rng.random_range(CLICKS_HZ)).ceil() as usize;
    for _ in 0..count {
        let (at, size) = (rng.random_range(0..length.max(1)), rng.random_range(0.3..1.0));
        // A contact or a knock on the microphone rings not at all.
        let (ring, is_dull) = (rng.random_range(RINGS_S), rng.random::<bool>());
        let hz = if is_dull {
            0.0
        } else {
            rng.random_range(0.0..4000.0)
        };
        for (n, value) in sound[at.min(length)..].iter_mut().take(4000).enumerate() {
            let time = seconds(n);
            *value += size * (-time / ring).exp() * (std::f64::consts::TAU * hz * time).cos();
        }
    }
    sound
}

/// Dull noise that swells and fades.
fn breath(length: usize, rng: &mut Pcg64) -> Vec<f64> {
    let (hz, phase, dull) = (
        rng.random_range(BREATHS_HZ),
        rng.random_range(0.0..1.0),
        rng.random_range(0.1..0.6),
    );
    let mut low = 0.0;
    (0..length)
        .map(|n| {
            low += dull * (normal_f64(rng) - low);
            low * (std::f64::consts::PI * (hz * seconds(n) + phase)).sin().abs()
        })
        .collect()
}

/// The mains of either continent, with overtones.
fn hum(length: usize, rng: &mut Pcg64) -> Vec<f64> {
    let hz = if rng.random::<bool>() { 50.0 } else { 60.0 };
    let overtones: [f64; 5] = std::array::from_fn(|_| rng.random_range(0.0..1.0));
    (0..length)
        .map(|n| {
            let turns = std::f64::consts::TAU * hz * seconds(n);
            (1..)
                .zip(overtones)
                .map(|(k, size)| size * (f64::from(k) * turns).sin())
                .sum()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn it_is_as_loud_as_it_is_drawn() {
        let mut rng = Pcg64::seed_from_u64(1);
        for kind in [Kind::Clicks, Kind::Breath, Kind::Hum] {
            let mut sound = vec![0i16; 48_000];
            sound[40_000] = 10_000;
            let before = sound.clone();
            let clatter = Clatter {
                kind,
                level_db: -20.0,
            };
            clatter.lay(&mut sound, &mut rng);
            let added = || {
                sound
                    .iter()
                    .zip(&before)
                    .map(|(a, b)| (i32::from(*a) - i32::from(*b)).abs())
            };
            assert_eq!(added().max(), Some(1000), "{kind:?}");
            // Clicks leave most of the time to the clip, the others little of it.
            let heard = added().filter(|more| *more > 20).count();
            match kind {
                Kind::Clicks => assert!((10..24_000).contains(&heard), "{heard}"),
                Kind::Breath | Kind::Hum => assert!(heard > 30_000, "{kind:?} {heard}"),
            }
        }
    }

    #[test]
    fn nothing_is_laid_over_nothing() {
        let mut rng = Pcg64::seed_from_u64(2);
        let drawn: Vec<Clatter> = (0..100).map(|_| Clatter::draw(&mut rng)).collect();
        for clatter in &drawn {
            let mut sound = vec![0i16; 1000];
            clatter.lay(&mut sound, &mut rng);
            assert!(sound.iter().all(|s| *s == 0));
            clatter.lay(&mut [], &mut rng);
        }
        for kind in [Kind::Clicks, Kind::Breath, Kind::Hum] {
            assert!(drawn.iter().any(|clatter| clatter.kind == kind), "{kind:?}");
        }
    }
}
