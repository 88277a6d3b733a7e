//! Viseme weights, and how open and how wide the mouth is, as weights of the sets of [`targets`](super::targets).
//!
//! Visemes say which shapes move, the measured opening says how far: a half-open vowel is half open.
use super::targets::{BlendSet, OPEN, OPENS, action_units, effect, sides, vowels};
use crate::opening::Opening;
use crate::phones::VISEMES;

/// What widens the mouth, and what makes it narrow, likewise.
const WIDENS: [(&str, f32); 2] = [("mouthStretch", 1.0), ("mouthSmile", 1.0)];
const NARROWS: [(&str, f32); 2] = [("mouthPucker", 1.0), ("mouthFunnel", 0.5)];
/// Corners as far apart and as near as in speech, in the units of these lists: those of the visemes that go furthest, rows 4 and 2 of the table of ARKit's shapes.
const WIDE: f32 = 0.35 + 0.2;
const NARROW: f32 = 0.7 + 0.5 * 0.35;
/// How far the measured width goes before what the visemes say: it is read with much less certainty than the gap (docs/live.md).
const TRUST_IN_WIDTH: f32 = 0.25;
/// Multiplies shapes.
fn scale(weights: &mut [f32], of: &[(&str, f32)], factor: f32) {
    for k in of.iter().flat_map(|(name, _)| sides(name)) {
        weights[k] *= factor;
    }
}

/// Adds to a shape.
fn add(weights: &mut [f32], name: &str, amount: f32) {
    for k in sides(name) {
        weights[k] += amount;
    }
}

/// Where a set whose weights add up to 1 has its rest, its vowels and the widest of them.
#[derive(Clone, Copy, Debug)]
struct Sounds {
    rest: usize,
    vowels: (usize, usize),
    widest: usize,
}

/// How a set's weights follow the measured opening.
#[derive(Clone, Copy, Debug)]
enum Follows {
    /// Weights are shares of one whole: what is not open is rest.
    Shares(Sounds),
    /// Weights are movements.
    Movements,
}

impl Follows {
    fn of(set: BlendSet) -> Self {
        let shares = |first, last, widest| {
            Self::Shares(Sounds {
                rest: 0,
                vowels: (first, last),
                widest,
            })
        };
        match set {
            // aa to U; the widest is aa.
            BlendSet::Oculus | BlendSet::Vrm => shares(10, 14, 10),
            // Ids 1 to 11; the widest is that of "aa".
            BlendSet::Azure => shares(1, 11, 2),
            // i to O; the widest is a.
            BlendSet::Polly => shares(10, 17, 13),
            BlendSet::Arkit | BlendSet::Facs => Self::Movements,
        }
    }
}

/// Viseme weights, and how open the mouth is, into weights of a [`BlendSet`].
#[derive(Clone, Debug)]
pub struct Blender {
    set: BlendSet,
    follows: Follows,
    rows: [Vec<f32>; VISEMES.len()],
    /// How open the mouth is in each viseme by the table, 1 = as in the widest vowel.
    openness: [f32; VISEMES.len()],
}

impl BlendSet {
    /// What turns viseme weights into weights of this set.
    pub fn blender(self) -> Blender {
        let openness = BlendSet::Arkit.rows().map(|row| effect(&row, &OPENS) / OPEN);
        // Two sets are read off another one's weights when those are final.
        let rows = match self {
            BlendSet::Vrm => BlendSet::Oculus.rows(),
            BlendSet::Facs => BlendSet::Arkit.rows(),
            own => own.rows(),
        };
        Blender {
            set: self,
            follows: Follows::of(self),
            rows,
            openness,
        }
    }
}

impl Blender {
    /// Weight of each shape of the set, 0 to 1, for viseme weights `[13]`, none where a model has no visemes, and how open the mouth is, where
    /// that is known. With neither all weights are 0.
    pub fn blend(&self, visemes: impl IntoIterator<Item = f32>, opening: Option<Opening>) -> Vec<f32> {
        let mut sums = vec![0.0f32; self.rows[0].len()];
        let (mut all, mut open) = (0.0, 0.0);
        for ((weight, row), openness) in visemes.into_iter().zip(&self.rows).zip(self.openness) {
            all += weight;
            open += weight * openness;
            for (sum, share) in sums.iter_mut().zip(row) {
                *sum += weight * share;
            }
        }
        match (opening, self.follows) {
            (None, _) => {}
            (Some(opening), Follows::Movements) => arkit_as_open(&mut sums, opening),
            (Some(opening), Follows::Shares(sounds)) => {
                if all == 0.0 {
                    sums[sounds.rest] = 1.0;
                }
                shares_as_open(&mut sums, sounds, open, opening.gap);
            }
        }
        let mut weights = match self.set {
            BlendSet::Vrm => vowels(&sums),
            BlendSet::Facs => action_units(&sums),
            _ => sums,
        };
        weights
            .iter_mut()
            .for_each(|weight| *weight = weight.clamp(0.0, 1.0));
        weights
    }

    /// How far the mouth is open, 0 closed to 1 as wide as in speech: as measured, or as the visemes of the table are where nothing can be measured.
    pub fn openness(&self, visemes: impl IntoIterator<Item = f32>, opening: Option<Opening>) -> f32 {
        match opening {
            Some(opening) => opening.gap,
            None => {
                let open = visemes.into_iter().zip(self.openness).map(|(w, open)| w * open);
                open.sum::<f32>().clamp(0.0, 1.0)
            }
        }
    }
}

/// Makes shapes open, widen and narrow the mouth as far as was measured. Where they do too much all that do it do less; where they do too
/// little the jaw opens further, corners are drawn out or lips puckered.
fn arkit_as_open(weights: &mut [f32], opening: Opening) {
    let (is, wanted) = (effect(weights, &OPENS), OPEN * opening.gap);
    match is > wanted {
        true => scale(weights, &OPENS, wanted / is),
        false => add(weights, "jawOpen", wanted - is),
    }
    let (wide, narrow) = (
        effect(weights, &WIDENS) / WIDE,
        effect(weights, &NARROWS) / NARROW,
    );
    let mut missing = TRUST_IN_WIDTH * (opening.width - (wide - narrow));
    let (against, does_against, name, unit) = match missing > 0.0 {
        true => (narrow, &NARROWS, "mouthStretch", WIDE),
        false => (wide, &WIDENS, "mouthPucker", NARROW),
    };
    missing = missing.abs();
    let less = missing.min(against);
    if against > 0.0 {
        scale(weights, does_against, 1.0 - less / against);
    }
    add(weights, name, (missing - less) * unit);
}

/// Shares out among rest and vowels what was measured: a vowel less open than the table says is partly rest, whatever is more open is partly the widest vowel.
fn shares_as_open(weights: &mut [f32], sounds: Sounds, open: f32, gap: f32) {
    let (first, last) = sounds.vowels;
    if open > gap {
        let mut closed = 0.0;
        for vowel in &mut weights[first..=last] {
            closed += *vowel * (1.0 - gap / open);
            *vowel *= gap / open;
        }
        weights[sounds.rest] += closed;
    } else if open < 1.0 {
        let share = (gap - open) / (1.0 - open);
        for weight in weights.iter_mut() {
            *weight *= 1.0 - share;
        }
        weights[sounds.widest] += share;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cues::{ARKIT, FACS, POLLY};

    fn viseme(v: usize) -> impl Iterator<Item = f32> {
        (0..VISEMES.len()).map(move |k| if k == v { 1.0 } else { 0.0 })
    }

    #[test]
    fn shapes_open_as_far_as_was_measured() {
        let blender = BlendSet::Arkit.blender();
        for v in 0..VISEMES.len() {
            for gap in [0.0, 0.25, 0.5, 1.0] {
                for width in [-1.0, -0.3, 0.0, 0.6, 1.0] {
                    let before = blender.blend(viseme(v), None);
                    let after = blender.blend(viseme(v), Some(Opening { gap, width }));
                    assert!((effect(&after, &OPENS) - OPEN * gap).abs() < 1e-5, "{v} {gap}");
                    let wide = |w: &[f32]| effect(w, &WIDENS) / WIDE - effect(w, &NARROWS) / NARROW;
                    let (was, is) = (wide(&before), wide(&after));
                    assert!(
                        (is - was - TRUST_IN_WIDTH * (width - was)).abs() < 1e-5,
                        "{v} {width}: {was} {is}"
                    );
                    // Not both at once where one is enough, and nothing else moves.
                    let k = ARKIT.iter().position(|name| *name == "mouthPressLeft").unwrap();
                    assert_eq!(before[k], after[k]);
                }
            }
        }
        // A viseme's own opening leaves it as it is in the table.
        let own = Opening {
            gap: effect(&blender.blend(viseme(3), None), &OPENS) / OPEN,
            width: 0.3 / WIDE,
        };
        for (a, b) in blender
            .blend(viseme(3), None)
            .iter()
            .zip(blender.blend(viseme(3), Some(own)))
        {
            assert!((a - b).abs() < 1e-5);
        }
    }

    #[test]
    fn shares_still_add_up_and_follow_the_gap() {
        for set in [BlendSet::Oculus, BlendSet::Azure, BlendSet::Polly] {
            let blender = set.blender();
            for v in 0..VISEMES.len() {
                for gap in [0.0, 0.25, 0.5, 1.0] {
                    let weights = blender.blend(viseme(v), Some(Opening { gap, width: 0.0 }));
                    assert!(
                        (weights.iter().sum::<f32>() - 1.0).abs() < 1e-5,
                        "{v} {gap}: {weights:?}"
                    );
                }
            }
        }
        let blender = BlendSet::Oculus.blender();
        let half = blender.blend(viseme(1), Some(Opening { gap: 0.5, width: 0.0 }));
        assert!((half[0] - 0.5).abs() < 1e-6 && (half[10] - 0.35).abs() < 1e-6);
        // A mouth that should be closed but is open shows it.
        let open = blender.blend(viseme(9), Some(Opening { gap: 1.0, width: 0.0 }));
        assert_eq!((open[1], open[10]), (0.0, 1.0));
        // Without visemes the gap alone moves it; with nothing known nothing does.
        let alone = blender.blend(
            [],
            Some(Opening {
                gap: 0.25,
                width: 0.0,
            }),
        );
        assert_eq!((alone[0], alone[10]), (0.75, 0.25));
        assert_eq!(blender.blend([], None), [0.0; 15]);
        let jaw = BlendSet::Arkit
            .blender()
            .blend([], Some(Opening { gap: 1.0, width: 0.0 }));
        assert_eq!(jaw[17], OPEN);
    }

    #[test]
    fn vowels_and_action_units_are_read_off_the_final_weights() {
        let wide = Some(Opening { gap: 1.0, width: 0.0 });
        // lr1 is shared by aa and oh; whatever is wider than they are is aa.
        let vrm = BlendSet::Vrm.blender().blend(viseme(1), wide);
        let oculus = BlendSet::Oculus.blender().blend(viseme(1), wide);
        assert_eq!(vrm, [oculus[10], oculus[12], oculus[14], oculus[11], oculus[13]]);
        let unit = |name: &str| FACS.iter().position(|unit| unit.starts_with(name)).unwrap();
        for gap in [0.0, 0.5, 1.0] {
            let opening = Some(Opening { gap, width: 0.0 });
            for v in 0..VISEMES.len() {
                let facs = BlendSet::Facs.blender().blend(viseme(v), opening);
                assert!((facs[unit("AU25")] - gap).abs() < 1e-5, "{v} {gap}: {facs:?}");
            }
        }
        let lips = BlendSet::Facs.blender().blend(viseme(9), None);
        assert_eq!(
            (lips[unit("AU24")], lips[unit("AU28")], lips[unit("AU26")]),
            (0.4, 0.3, 0.0)
        );
        // t, d, n are Azure's 19 and Polly's t, whatever is heard of each.
        assert_eq!(BlendSet::Azure.blender().blend(viseme(7), None)[19], 1.0);
        let t = POLLY.iter().position(|name| *name == "t").unwrap();
        assert_eq!(BlendSet::Polly.blender().blend(viseme(7), None)[t], 1.0);
    }

    #[test]
    fn openness_is_measured_or_the_tables() {
        let blender = BlendSet::Oculus.blender();
        let opening = Some(Opening { gap: 0.3, width: 0.0 });
        assert_eq!(blender.openness(viseme(1), opening), 0.3);
        assert_eq!(blender.openness(viseme(1), None), 1.0);
        assert_eq!(blender.openness(viseme(9), None), 0.0);
        assert_eq!(blender.openness([], None), 0.0);
    }
}
