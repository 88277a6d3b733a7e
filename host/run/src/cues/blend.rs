//! Viseme weights, and how open and how wide the mouth is, as weights of the Oculus lip-sync set (15 visemes) and of ARKit's 52 blend shapes;
//! as CSV with one row every 10 ms.
//!
//! Visemes say which shapes move, the measured opening says how far: a half-open vowel is half open.
use std::io::{self, Write};

use super::check;
use crate::opening::{Opening, OpeningReader};
use crate::out::Numbers;
use crate::phones::VISEMES;
use crate::session::Frame;
use crate::time::frame_seconds;

/// The Oculus lip-sync visemes, in their order.
pub const OCULUS: [&str; 15] = [
    "sil", "PP", "FF", "TH", "DD", "kk", "CH", "SS", "nn", "RR", "aa", "E", "I", "O", "U",
];

/// Shares of each viseme, in the order of [`VISEMES`], among the Oculus visemes; each row adds up to 1. A class
/// of ours that is two of theirs is shared out by how often its phones are heard in English.
const TO_OCULUS: [&[(usize, f32)]; VISEMES.len()] = [
    &[(0, 1.0)],
    &[(10, 0.7), (13, 0.3)],
    &[(14, 0.6), (13, 0.4)],
    &[(11, 1.0)],
    &[(12, 1.0)],
    &[(8, 0.45), (9, 0.55)],
    &[(7, 1.0)],
    &[(4, 0.6), (8, 0.4)],
    &[(6, 1.0)],
    &[(1, 1.0)],
    &[(3, 1.0)],
    &[(2, 1.0)],
    &[(5, 0.7), (14, 0.3)],
];

/// ARKit's 52 blend shapes, in the order of Apple's documentation.
pub const ARKIT: [&str; 52] = [
    "eyeBlinkLeft",
    "eyeLookDownLeft",
    "eyeLookInLeft",
    "eyeLookOutLeft",
    "eyeLookUpLeft",
    "eyeSquintLeft",
    "eyeWideLeft",
    "eyeBlinkRight",
    "eyeLookDownRight",
    "eyeLookInRight",
    "eyeLookOutRight",
    "eyeLookUpRight",
    "eyeSquintRight",
    "eyeWideRight",
    "jawForward",
    "jawLeft",
    "jawRight",
    "jawOpen",
    "mouthClose",
    "mouthFunnel",
    "mouthPucker",
    "mouthLeft",
    "mouthRight",
    "mouthSmileLeft",
    "mouthSmileRight",
    "mouthFrownLeft",
    "mouthFrownRight",
    "mouthDimpleLeft",
    "mouthDimpleRight",
    "mouthStretchLeft",
    "mouthStretchRight",
    "mouthRollLower",
    "mouthRollUpper",
    "mouthShrugLower",
    "mouthShrugUpper",
    "mouthPressLeft",
    "mouthPressRight",
    "mouthLowerDownLeft",
    "mouthLowerDownRight",
    "mouthUpperUpLeft",
    "mouthUpperUpRight",
    "browDownLeft",
    "browDownRight",
    "browInnerUp",
    "browOuterUpLeft",
    "browOuterUpRight",
    "cheekPuff",
    "cheekSquintLeft",
    "cheekSquintRight",
    "noseSneerLeft",
    "noseSneerRight",
    "tongueOut",
];

/// What each viseme does to ARKit's shapes, in the order of [`VISEMES`]. A name without Left or Right moves both.
const TO_ARKIT: [&[(&str, f32)]; VISEMES.len()] = [
    &[],
    &[("jawOpen", 0.55), ("mouthFunnel", 0.15), ("mouthLowerDown", 0.25)],
    &[("jawOpen", 0.2), ("mouthPucker", 0.7), ("mouthFunnel", 0.35)],
    &[
        ("jawOpen", 0.4),
        ("mouthStretch", 0.3),
        ("mouthLowerDown", 0.35),
        ("mouthUpperUp", 0.15),
    ],
    &[
        ("jawOpen", 0.15),
        ("mouthStretch", 0.35),
        ("mouthSmile", 0.2),
        ("mouthLowerDown", 0.2),
    ],
    &[
        ("jawOpen", 0.2),
        ("mouthFunnel", 0.2),
        ("mouthLowerDown", 0.15),
        ("tongueOut", 0.05),
    ],
    &[
        ("jawOpen", 0.05),
        ("mouthStretch", 0.25),
        ("mouthLowerDown", 0.3),
        ("mouthUpperUp", 0.1),
    ],
    &[
        ("jawOpen", 0.12),
        ("mouthStretch", 0.15),
        ("mouthLowerDown", 0.25),
    ],
    &[
        ("jawOpen", 0.1),
        ("mouthFunnel", 0.5),
        ("mouthPucker", 0.15),
        ("mouthLowerDown", 0.2),
    ],
    &[
        ("mouthPress", 0.4),
        ("mouthRollLower", 0.3),
        ("mouthRollUpper", 0.2),
    ],
    &[("jawOpen", 0.15), ("tongueOut", 0.25), ("mouthLowerDown", 0.2)],
    &[("jawOpen", 0.05), ("mouthRollLower", 0.5), ("mouthUpperUp", 0.25)],
    &[("jawOpen", 0.2), ("mouthPucker", 0.15), ("mouthLowerDown", 0.15)],
];

/// What opens the lips in ARKit's set, and how far the lips are apart at a weight of 1, in parts of the jaw's.
const OPENS: [(&str, f32); 3] = [("jawOpen", 1.0), ("mouthLowerDown", 0.5), ("mouthUpperUp", 0.3)];
/// What widens the mouth, and what makes it narrow, likewise.
const WIDENS: [(&str, f32); 2] = [("mouthStretch", 1.0), ("mouthSmile", 1.0)];
const NARROWS: [(&str, f32); 2] = [("mouthPucker", 1.0), ("mouthFunnel", 0.5)];
/// Lips as far apart, corners as far and as near as in speech, in the units of these lists: those of the visemes that go furthest, rows 1, 4 and 2
/// of [`TO_ARKIT`].
const OPEN: f32 = 0.55 + 0.5 * 0.25;
const WIDE: f32 = 0.35 + 0.2;
const NARROW: f32 = 0.7 + 0.5 * 0.35;
/// How far the measured width goes before what the visemes say: it is read with much less certainty than the gap (docs/live.md).
const TRUST_IN_WIDTH: f32 = 0.25;
/// Oculus visemes that are vowels: their weight is how far the mouth is open.
const VOWELS: std::ops::Range<usize> = 10..15;

/// A set of shapes whose weights an animation program blends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlendSet {
    /// The 15 visemes of Oculus lip sync, [`OCULUS`].
    Oculus,
    /// The 52 blend shapes of ARKit, [`ARKIT`].
    Arkit,
}

impl BlendSet {
    /// Names of the shapes, in their order.
    pub fn names(self) -> &'static [&'static str] {
        match self {
            BlendSet::Oculus => &OCULUS,
            BlendSet::Arkit => &ARKIT,
        }
    }

    /// Writes a header, then one row a frame: seconds of its centre, and the weight of each shape, 0 to 1. `opening` reads the frames'
    /// parameters, where their mouth is known.
    ///
    /// # Errors
    ///
    /// What `to` says.
    pub fn write<'w>(
        self,
        mut to: impl Write + 'w,
        opening: Option<OpeningReader>,
    ) -> io::Result<Box<dyn Numbers + 'w>> {
        writeln!(to, "time,{}", self.names().join(","))?;
        Ok(Box::new(Csv {
            to,
            blender: self.blender(),
            opening,
        }))
    }

    /// What turns viseme weights into weights of this set.
    pub fn blender(self) -> Blender {
        let rows = self.rows();
        let openness = TO_ARKIT.map(|effects| {
            let amount = |shape: &str| {
                effects
                    .iter()
                    .find(|(name, _)| *name == shape)
                    .map_or(0.0, |e| e.1)
            };
            OPENS
                .iter()
                .map(|(shape, part)| part * amount(shape))
                .sum::<f32>()
                / OPEN
        });
        Blender {
            set: self,
            rows,
            openness,
        }
    }

    /// Weight of every shape, for a weight of 1 of each viseme.
    fn rows(self) -> [Vec<f32>; VISEMES.len()] {
        let shapes = self.names().len();
        match self {
            BlendSet::Oculus => TO_OCULUS.map(|shares| {
                let mut row = vec![0.0; shapes];
                for &(k, share) in shares {
                    row[k] = share;
                }
                row
            }),
            BlendSet::Arkit => TO_ARKIT.map(|effects| {
                let mut row = vec![0.0; shapes];
                for &(name, amount) in effects {
                    for k in sides(name) {
                        row[k] = amount;
                    }
                }
                row
            }),
        }
    }
}

/// Places in [`ARKIT`] of a name, on both sides where it has two.
fn sides(name: &str) -> impl Iterator<Item = usize> + '_ {
    let is = move |shape: &str| matches!(shape.strip_prefix(name), Some("" | "Left" | "Right"));
    (0..ARKIT.len()).filter(move |k| is(ARKIT[*k]))
}

/// How much of something the shapes of ARKit's set do together.
fn effect(weights: &[f32], of: &[(&str, f32)]) -> f32 {
    let one = |name| sides(name).map(|k| weights[k]).sum::<f32>() / sides(name).count() as f32;
    of.iter().map(|(name, part)| part * one(name)).sum()
}

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

/// Viseme weights, and how open the mouth is, into weights of a [`BlendSet`].
#[derive(Clone, Debug)]
pub struct Blender {
    set: BlendSet,
    rows: [Vec<f32>; VISEMES.len()],
    /// How open the mouth is in each viseme by the table, 1 = as in the widest vowel.
    openness: [f32; VISEMES.len()],
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
        match (opening, self.set) {
            (None, _) => {}
            (Some(opening), BlendSet::Arkit) => arkit_as_open(&mut sums, opening),
            (Some(opening), BlendSet::Oculus) => {
                if all == 0.0 {
                    sums[0] = 1.0;
                }
                oculus_as_open(&mut sums, open, opening.gap);
            }
        }
        for sum in &mut sums {
            *sum = sum.clamp(0.0, 1.0);
        }
        sums
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

/// Shares out among rest and vowels what was measured: a vowel less open than the table says is partly rest, whatever is more open is partly `aa`.
fn oculus_as_open(weights: &mut [f32], open: f32, gap: f32) {
    if open > gap {
        let mut closed = 0.0;
        for vowel in &mut weights[VOWELS] {
            closed += *vowel * (1.0 - gap / open);
            *vowel *= gap / open;
        }
        weights[0] += closed;
    } else if open < 1.0 {
        let share = (gap - open) / (1.0 - open);
        for weight in weights.iter_mut() {
            *weight *= 1.0 - share;
        }
        weights[VOWELS.start] += share;
    }
}

struct Csv<W> {
    to: W,
    blender: Blender,
    opening: Option<OpeningReader>,
}

impl<W: Write> Numbers for Csv<W> {
    fn frame(&mut self, frame: &Frame) -> io::Result<()> {
        check(frame.visemes, frame.index).map_err(io::Error::other)?;
        write!(self.to, "{:.4}", frame_seconds(frame.index))?;
        let opening = self.opening.as_ref().map(|reader| reader.read(frame.parameters));
        for weight in self.blender.blend(frame.visemes.iter().copied(), opening) {
            write!(self.to, ",{weight:.3}")?;
        }
        writeln!(self.to)
    }

    fn finish(mut self: Box<Self>) -> io::Result<()> {
        self.to.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_add_up_and_every_oculus_viseme_is_reached() {
        let mut reached = [0.0; OCULUS.len()];
        for shares in TO_OCULUS {
            let sum: f32 = shares.iter().map(|(_, s)| s).sum();
            assert!((sum - 1.0).abs() < 1e-6);
            for &(k, s) in shares {
                reached[k] += s;
            }
        }
        assert!(reached.iter().all(|r| *r > 0.0), "{reached:?}");
    }

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
    fn oculus_weights_still_add_up_and_follow_the_gap() {
        let blender = BlendSet::Oculus.blender();
        for v in 0..VISEMES.len() {
            for gap in [0.0, 0.25, 0.5, 1.0] {
                let weights = blender.blend(viseme(v), Some(Opening { gap, width: 0.0 }));
                assert!(
                    (weights.iter().sum::<f32>() - 1.0).abs() < 1e-5,
                    "{v} {gap}: {weights:?}"
                );
            }
        }
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

    /// `docs/visemes.md` says what the tables here and beside it say.
    #[test]
    fn the_documents_table_is_the_codes() {
        use crate::cues::SHAPE_OF_VISEME;
        use crate::phones::PHONES;
        let document = include_str!("../../../../docs/visemes.md");
        let number = |x: f32| x.to_string().trim_start_matches('0').to_owned();
        let rows = document.lines().filter_map(|line| line.strip_prefix("| "));
        let rows: Vec<Vec<&str>> = rows.map(|row| row.split('|').map(str::trim).collect()).collect();
        for (v, name) in VISEMES.iter().enumerate() {
            let row = rows.iter().find(|row| row[0] == *name);
            let row = row.unwrap_or_else(|| panic!("{name} has no row"));
            let mut said: Vec<&str> = row[1].split(' ').collect();
            let mut phones: Vec<&str> = PHONES
                .iter()
                .filter(|(_, viseme)| usize::from(viseme.0) == v)
                .map(|(phone, _)| *phone)
                .collect();
            said.sort_unstable();
            phones.sort_unstable();
            assert_eq!(said, phones, "{name}");
            let shape = SHAPE_OF_VISEME[v];
            assert_eq!(
                (row[3], row[4]),
                (&*shape.letter().to_string(), shape.preston_blair()),
                "{name}"
            );
            let shares: Vec<String> = TO_OCULUS[v]
                .iter()
                .map(|&(k, share)| match share == 1.0 {
                    true => OCULUS[k].to_owned(),
                    false => format!("{} {}", OCULUS[k], number(share)),
                })
                .collect();
            assert_eq!(row[5], shares.join(", "), "{name}");
            let effects: Vec<String> = TO_ARKIT[v]
                .iter()
                .map(|(shape, amount)| format!("{shape} {}", number(*amount)))
                .collect();
            assert_eq!(row[6], effects.join(", "), "{name}");
        }
    }

    #[test]
    fn every_effect_names_a_blend_shape() {
        let all = TO_ARKIT
            .iter()
            .flat_map(|e| e.iter())
            .chain(&OPENS)
            .chain(&WIDENS)
            .chain(&NARROWS);
        for (name, amount) in all {
            let found = sides(name).count();
            assert!(found == 1 || found == 2, "{name}");
            assert!((0.0..=1.0).contains(amount));
        }
    }
}
